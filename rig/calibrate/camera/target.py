"""Calibration targets, a ChArUco board or a chessboard, and their detection in pictures."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from rig.config.calibration_files import CalibrationError

Vector = NDArray[np.float64]
Image = NDArray[np.uint8]

DICTIONARY = cv2.aruco.DICT_4X4_250
MIN_CORNERS = 12
PRINT_PX_MM = 12  # some 300 dots an inch
_USAGE = "give charuco:COLUMNSxROWS:SQUARE_MM:MARKER_MM or chessboard:COLUMNSxROWS:SQUARE_MM (inner corners)"


@dataclass(frozen=True)
class TargetView:
    """Corners of the target in one picture: number, position on the target (n, 3) in mm, position in the picture (n, 2)
    in px.
    """

    name: str
    ids: NDArray[np.int64]
    target_mm: Vector
    image_px: Vector


@dataclass(frozen=True)
class CalibrationTarget:
    """A target and its detector (None if it is not found)."""

    text: str
    find: Callable[[str, Image], TargetView | None]


def parse_target(text: str) -> CalibrationTarget:
    """A target from its description. ``ValueError``, one sentence, for an invalid one."""
    kind, *numbers = text.split(":")
    try:
        columns, rows = (int(part) for part in numbers[0].split("x"))
        sizes_mm = [float(part) for part in numbers[1:]]
    except (IndexError, ValueError):
        raise ValueError(f"{text!r} is no board; {_USAGE}") from None
    if min(columns, rows) < 3 or any(size <= 0.0 for size in sizes_mm):
        raise ValueError(f"{text!r} is too small a board; {_USAGE}")
    if kind == "charuco" and len(sizes_mm) == 2 and sizes_mm[1] < sizes_mm[0]:
        return CalibrationTarget(text, _charuco_finder(charuco_board(columns, rows, *sizes_mm)))
    if kind == "chessboard" and len(sizes_mm) == 1:
        return CalibrationTarget(text, _chessboard_finder(columns, rows, sizes_mm[0]))
    raise ValueError(f"{text!r} is no board; {_USAGE}")


def charuco_board(columns: int, rows: int, square_mm: float, marker_mm: float) -> cv2.aruco.CharucoBoard:
    """OpenCV's board with the first markers of its 4x4 dictionary."""
    dictionary = cv2.aruco.getPredefinedDictionary(DICTIONARY)
    return cv2.aruco.CharucoBoard((columns, rows), square_mm, marker_mm, dictionary)


def print_target(text: str, path: Path) -> None:
    """Draw a ChArUco board for printing at true size. ``CalibrationError`` if the file cannot be written."""
    kind, *numbers = text.split(":")
    if kind != "charuco":
        raise CalibrationError(
            f"{text}: only charuco boards are drawn; chessboards come from OpenCV's documentation"
        )
    columns, rows = (int(part) for part in numbers[0].split("x"))
    square_mm, marker_mm = float(numbers[1]), float(numbers[2])
    size_px = (round(columns * square_mm * PRINT_PX_MM), round(rows * square_mm * PRINT_PX_MM))
    picture = charuco_board(columns, rows, square_mm, marker_mm).generateImage(size_px)
    if not cv2.imwrite(str(path), np.asarray(picture)):
        raise CalibrationError(f"{path}: cannot be written; choose another --out, ending in .png")


def _charuco_finder(board: cv2.aruco.CharucoBoard) -> Callable[[str, Image], TargetView | None]:
    detector = cv2.aruco.CharucoDetector(board)
    all_mm = np.asarray(board.getChessboardCorners(), float)

    def find(name: str, image: Image) -> TargetView | None:
        corners, ids, _, _ = detector.detectBoard(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY))
        if ids is None or len(ids) < MIN_CORNERS:
            return None
        numbers = np.asarray(ids, np.int64).ravel()
        return TargetView(name, numbers, all_mm[numbers], np.asarray(corners, float).reshape(-1, 2))

    return find


def _chessboard_finder(
    columns: int, rows: int, square_mm: float
) -> Callable[[str, Image], TargetView | None]:
    grid = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2) * square_mm
    all_mm = np.column_stack([grid, np.zeros(len(grid))])

    def find(name: str, image: Image) -> TargetView | None:
        gray = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        found, corners = cv2.findChessboardCornersSB(gray, (columns, rows), flags=cv2.CALIB_CB_ACCURACY)
        if not found:
            return None
        return TargetView(name, np.arange(len(grid)), all_mm, np.asarray(corners, float).reshape(-1, 2))

    return find
