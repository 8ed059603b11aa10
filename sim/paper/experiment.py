"""Repeats Table I of Talluri and Aggarwal (1992): nine places, four directions, contours without and with noise.

The contours come from the simulator's triangulated surface, while the search uses its own bilinear one. As in the paper
the sensors and the DEM are exact and only the contour is noisy. So the DEM is declared exact; the sensors have the
sigmas below.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from localizer import Observation, load_dem
from localizer.experiments import Located, grid_only_estimate, prepare_terrain, search_observation
from localizer.experiments import Terrain as SearchedTerrain
from sim.errors import SimulationError
from sim.paper.observations import aimed_tilt_deg, frame_observation
from sim.world.contour import skyline_contour
from sim.world.mechanics import Attitude, camera_in_world
from sim.world.scenario import CameraOptics
from sim.world.surface import Surface
from sim.world.terrain import read_terrain

PAPER_GRID = (359, 457)
HALF_VIEW_DEG = 33.0
IMAGE_PX = 512
MAST_M = 2.0
NOISE_PX = 5.0
NOISE_FREE_SIGMA_PX = 0.05
ALTITUDE_SIGMA_M = 5.0
ATTITUDE_SIGMA_DEG = 0.005
"""The resolution of the paper's inclinometer."""
DIRECTIONS = {"N": 0.0, "E": 90.0, "S": 180.0, "W": 270.0}


@dataclass(frozen=True)
class PaperRun:
    """One line of the paper's Table I, (1) to (8) of its caption."""

    actual: tuple[float, float]
    candidates_after_one_direction: int
    candidates_after_all: int
    error_noise_free: float
    error_sigma5: float
    points_explored: int


TABLE_I = (
    PaperRun((150.2, 100.8), 342, 7, 0.824621, 1.442210, 2493757),
    PaperRun((150.0, 200.0), 126, 3, 1.000000, 1.414214, 2674226),
    PaperRun((150.3, 300.6), 227, 8, 0.500000, 2.941088, 2805477),
    PaperRun((200.1, 100.5), 473, 8, 0.509920, 1.964688, 2149225),
    PaperRun((200.2, 200.2), 889, 26, 1.131371, 1.811077, 2493757),
    PaperRun((200.2, 300.8), 334, 9, 1.131371, 2.163310, 3133603),
    PaperRun((300.0, 100.0), 334, 4, 1.000000, 1.414214, 2854696),
    PaperRun((300.5, 200.8), 273, 17, 0.943380, 1.920937, 1804693),
    PaperRun((300.2, 300.8), 254, 10, 0.824621, 1.442210, 2187501),
)


@dataclass(frozen=True)
class Row:
    """Results of one place: counts of the noise-free run as in Table I, and errors in grid points; None without a
    position.
    """

    actual: tuple[float, float]
    candidates_after_one_direction: int
    candidates_after_all: int
    points_explored: int
    status_noise_free: str
    status_sigma5: str
    error_noise_free: float | None
    error_sigma5: float | None
    grid_only_error_noise_free: float | None
    grid_only_error_sigma5: float | None
    claimed_noise_free: float | None = None
    """Stated standard deviation along the longer axis of the answer's ellipse, grid points."""
    claimed_sigma5: float | None = None


def paper_places(rows: int, cols: int, embedded: bool) -> list[tuple[float, float]]:
    """The nine places as (row, col): the paper's own grid positions, or the same layout on a grid of another size."""
    if embedded:
        return [run.actual for run in TABLE_I]
    return [
        (x * (rows - 1) / (PAPER_GRID[0] - 1), y * (cols - 1) / (PAPER_GRID[1] - 1))
        for x, y in (run.actual for run in TABLE_I)
    ]


def repeat_table_i(
    dem_paths: Sequence[Path],
    embedded: bool,
    seed: int,
    doubt: bool = False,
    report: Callable[[int, Row], None] = lambda _number, _row: None,
) -> list[Row]:
    """Run the experiment; ``report`` is called after each place. With ``doubt`` the DEM is treated as inexact, like
    that of a real place.

    Raises:
        SimulationError: one of the places lies in a void.
    """
    surface = Surface(read_terrain(dem_paths))
    searched = prepare_terrain(load_dem(dem_paths, error_m=None if doubt else 0.0))
    rows, cols = surface.height_m.shape
    result = []
    for number, place in enumerate(paper_places(rows, cols, embedded)):
        rng = np.random.default_rng([seed, number])
        clean = _contours(surface, place, 0.0, rng)
        noisy = _contours(surface, place, NOISE_PX, rng)
        exact, disturbed = search_observation(searched, clean), search_observation(searched, noisy)
        left = [len(cells) for cells in exact.stage1.survivors.values()]
        row = Row(
            actual=place,
            candidates_after_one_direction=left[1],
            candidates_after_all=left[-1],
            points_explored=exact.stage1.points_explored,
            status_noise_free=exact.decision.status,
            status_sigma5=disturbed.decision.status,
            error_noise_free=_error(exact, place),
            error_sigma5=_error(disturbed, place),
            grid_only_error_noise_free=_grid_only_error(searched, clean, exact, place),
            grid_only_error_sigma5=_grid_only_error(searched, noisy, disturbed, place),
            claimed_noise_free=_claimed(searched, exact),
            claimed_sigma5=_claimed(searched, disturbed),
        )
        result.append(row)
        report(number, row)
    return result


def mean(values: Sequence[float | None]) -> float | None:
    """Mean error; None unless every place was located."""
    found = [v for v in values if v is not None]
    return float(np.mean(found)) if found and len(found) == len(values) else None


def _contours(
    surface: Surface, place: tuple[float, float], noise_px: float, rng: np.random.Generator
) -> Observation:
    """Contours of the four directions, the camera tilted until the skyline lies about the middle of the image."""
    ground = surface.height(*place)
    if not np.isfinite(ground):
        raise SimulationError(
            f"the place at row {place[0]:.1f}, column {place[1]:.1f} is void; choose another DEM"
        )
    observer = surface.observer(*place, ground + MAST_M)
    focal = IMAGE_PX / 2.0 / np.tan(np.radians(HALF_VIEW_DEG))
    centre = (IMAGE_PX - 1) / 2.0
    optics = CameraOptics(
        width_px=IMAGE_PX,
        height_px=IMAGE_PX,
        fx_px=focal,
        fy_px=focal,
        cx_px=centre,
        cy_px=centre,
        distortion=(0.0, 0.0, 0.0, 0.0, 0.0),
    )
    columns = np.arange(IMAGE_PX, dtype=float)
    frames = []
    for label, azimuth in DIRECTIONS.items():
        tilt = aimed_tilt_deg(surface, observer, azimuth, HALF_VIEW_DEG)
        contour = skyline_contour(surface, observer, optics, camera_in_world(azimuth, tilt, 0.0), columns)
        inside = np.isfinite(contour)
        contour[inside] += noise_px * rng.standard_normal(int(inside.sum()))
        frames.append(
            frame_observation(
                label,
                optics,
                Attitude(azimuth, tilt, 0.0),
                (ATTITUDE_SIGMA_DEG,) * 3,
                columns,
                contour,
                max(noise_px, NOISE_FREE_SIGMA_PX),
            )
        )
    return Observation(
        frames=tuple(frames),
        mast_height_m=MAST_M,
        altitude_m=ground + MAST_M,
        altitude_sigma_m=ALTITUDE_SIGMA_M,
        azimuth_bias_sigma_deg=ATTITUDE_SIGMA_DEG,
        tilt_bias_sigma_deg=ATTITUDE_SIGMA_DEG,
    )


def _error(located: Located, place: tuple[float, float]) -> float | None:
    best = located.best
    return None if best is None else float(np.hypot(best.row - place[0], best.col - place[1]))


def _claimed(terrain: SearchedTerrain, located: Located) -> float | None:
    best = located.best
    if best is None:
        return None
    return float(np.sqrt(np.linalg.eigvalsh(best.covariance_enu_m2)[-1])) / terrain.cell_m


def _grid_only_error(
    terrain: SearchedTerrain, observation: Observation, located: Located, place: tuple[float, float]
) -> float | None:
    cells = located.stage1.last
    if len(cells) == 0:
        return None
    row, col = grid_only_estimate(terrain, observation, cells)
    return float(np.hypot(row - place[0], col - place[1]))
