"""Pictures of a calibration target in front of the simulated camera, at changing positions."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from sim.render.renderer import Sensor
from sim.world.scenario import CameraOptics

Array = NDArray[np.float64]

COLUMNS, ROWS, SQUARE_MM, MARKER_MM = 9, 7, 30.0, 22.0
DICTIONARY = cv2.aruco.DICT_4X4_250
PAPER_PX_MM = 2.0  # resolution of the drawing, about the camera's
DRAWN_FINER = 4
BACKGROUND = 110
PAPER_BLACK, PAPER_WHITE = 25.0, 225.0
FRAMES_A_POSE = 4
MAX_TILT_DEG = 40.0
DISTANCE_MM = (280.0, 620.0)
PLACES = (5, 4)  # columns, rows: positions of the target's centre, in turn
SEEN_SHARE = (0.06, 0.94)


@dataclass(frozen=True)
class Pose:
    """Pose of the target in the camera frame: its centre (3,), mm, and its axes right and down (3,)."""

    middle_mm: Array
    right: Array
    down: Array


class CalibrationTargetPictures:
    """Pictures of a target that a person moves: still for some frames, then in another position, all over the picture."""

    def __init__(self, optics: CameraOptics, rng: np.random.Generator) -> None:
        self._sensor = Sensor(optics)
        self._optics = optics
        self._rng = rng
        self._paper = _paper()
        self._frames = 0
        self._places: list[tuple[int, int]] = []
        self._clean = np.zeros((optics.height_px, optics.width_px, 3), np.float32)

    def frame(self) -> NDArray[np.uint8]:
        """The next picture (height, width, 3), BGR."""
        if self._frames % FRAMES_A_POSE == 0:
            self._clean = self._sensor.image(self._seen(self._next_pose()))
        self._frames += 1
        return self._sensor.expose(self._clean, self._rng)

    def _next_pose(self) -> Pose:
        """A new position in the picture, with a random tilt."""
        if not self._places:
            self._places = [(i, j) for i in range(PLACES[0]) for j in range(PLACES[1])]
            self._rng.shuffle(self._places)
        i, j = self._places.pop()
        low, high = SEEN_SHARE
        share = low + (high - low) * (np.array([i, j]) + self._rng.uniform(0.2, 0.8, 2)) / PLACES
        optics = self._optics
        u, v = share * [optics.width_px, optics.height_px]
        ray = np.array([(u - optics.cx_px) / optics.fx_px, (v - optics.cy_px) / optics.fy_px, 1.0])
        lean = np.radians(self._rng.uniform(0.0, MAX_TILT_DEG))
        towards, spin = self._rng.uniform(0.0, 2.0 * np.pi, 2)
        axis = np.array([np.cos(towards), np.sin(towards), 0.0])
        turn = _turned(axis, lean) @ _turned(np.array([0.0, 0.0, 1.0]), 0.3 * np.sin(spin))
        return Pose(ray * self._rng.uniform(*DISTANCE_MM), turn[:, 0], turn[:, 1])

    def _seen(self, pose: Pose) -> NDArray[np.uint8]:
        """The target as seen along the sensor's rays."""
        rays = self._sensor.rays.astype(np.float64)
        normal = np.cross(pose.right, pose.down)
        reach = (pose.middle_mm @ normal) / (rays @ normal)
        on_board = rays * reach[..., None] - pose.middle_mm
        size_mm = np.array([COLUMNS, ROWS]) * SQUARE_MM
        x_mm, y_mm = on_board @ pose.right + size_mm[0] / 2.0, on_board @ pose.down + size_mm[1] / 2.0
        map_x = np.where(reach > 0.0, x_mm * PAPER_PX_MM - 0.5, -1e4).astype(np.float32)
        map_y = (y_mm * PAPER_PX_MM - 0.5).astype(np.float32)
        gray = cv2.remap(
            self._paper,
            map_x,
            map_y,
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=BACKGROUND,
        )
        return np.repeat(np.asarray(gray, np.uint8)[..., None], 3, axis=2)


def _paper() -> NDArray[np.uint8]:
    """The printed target, from its upper left corner, in grey levels of a real print."""
    dictionary = cv2.aruco.getPredefinedDictionary(DICTIONARY)
    board = cv2.aruco.CharucoBoard((COLUMNS, ROWS), SQUARE_MM, MARKER_MM, dictionary)
    per_mm = PAPER_PX_MM * DRAWN_FINER
    large = board.generateImage((round(COLUMNS * SQUARE_MM * per_mm), round(ROWS * SQUARE_MM * per_mm)))
    size = (round(COLUMNS * SQUARE_MM * PAPER_PX_MM), round(ROWS * SQUARE_MM * PAPER_PX_MM))
    levels = PAPER_BLACK + (PAPER_WHITE - PAPER_BLACK) * np.asarray(large, np.float32) / 255.0
    return np.asarray(cv2.resize(levels, size, interpolation=cv2.INTER_AREA), np.uint8)


def _turned(axis: Array, angle: float) -> Array:
    """Rotation (3, 3) about a unit axis (Rodrigues)."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross)
