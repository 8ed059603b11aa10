"""Intrinsics and distortion from views of a calibration target, with checks that the result is credible."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from rig.calibrate.camera.target import TargetView
from rig.config.calibration_files import CalibrationError

Vector = NDArray[np.float64]

MIN_VIEWS = 10
GRID = (8, 6)  # columns, rows
MIN_COVERAGE = 0.75
RMS_LIMIT_PX = 0.7
FOCAL_SIGMA_LIMIT = 0.003
FIELD_OF_VIEW_DEG = (5.0, 150.0)
SQUARENESS_LIMIT = 0.03
CENTRE_LIMIT = 0.15  # of the picture's size
BAD_VIEW = 3.0  # in medians
MAX_BAD_VIEWS = 0.2
SIGNIFICANT = 3.0
_POSE = 6  # rotation and translation of the board in one view
NAMES = ("fx_px", "fy_px", "cx_px", "cy_px", "k1", "k2", "p1", "p2", "k3")


@dataclass(frozen=True)
class CameraFit:
    """The nine parameters by name, their sigmas, and the residuals (n, 2) in px at the corners (n, 2) of all views."""

    values: dict[str, float]
    sigmas: dict[str, float]
    rms_px: float
    views: int
    dropped: tuple[str, ...]
    coverage: float
    corners_px: Vector
    residuals_px: Vector


def coverage_grid(views: Sequence[TargetView], size_px: tuple[int, int]) -> NDArray[np.int64]:
    """Number of corners in each cell of the picture (rows, columns)."""
    counts = np.zeros((GRID[1], GRID[0]), np.int64)
    for view in views:
        cells = np.floor((view.image_px + 0.5) / np.array(size_px) * np.array(GRID)).astype(np.int64)
        np.add.at(counts, (np.clip(cells[:, 1], 0, GRID[1] - 1), np.clip(cells[:, 0], 0, GRID[0] - 1)), 1)
    return counts


def coverage(views: Sequence[TargetView], size_px: tuple[int, int]) -> float:
    """Share of the picture's cells in which a corner was seen."""
    return float(np.mean(coverage_grid(views, size_px) > 0))


def fit_camera(views: Sequence[TargetView], size_px: tuple[int, int]) -> CameraFit:
    """Fit. ``CalibrationError`` if the views are too few, leave parts of the picture uncovered, or fit no real lens."""
    _require_views(views, size_px)
    used = list(views)
    first = _calibrate(used, size_px, fixed_k3=False)
    bad = first.per_view_px > BAD_VIEW * np.median(first.per_view_px)
    dropped = tuple(view.name for view, is_bad in zip(used, bad, strict=True) if is_bad)
    if dropped and len(dropped) <= MAX_BAD_VIEWS * len(used):
        used = [view for view, is_bad in zip(used, bad, strict=True) if not is_bad]
        first = _calibrate(used, size_px, fixed_k3=False)
    else:
        dropped = ()
    # An unnecessary third coefficient would fit the noise of the corners.
    needed = abs(first.parameters[8]) > SIGNIFICANT * first.sigmas[8]
    solved = first if needed else _calibrate(used, size_px, fixed_k3=True)
    fit = CameraFit(
        dict(zip(NAMES, solved.parameters.tolist(), strict=True)),
        dict(zip(NAMES, solved.sigmas.tolist(), strict=True)),
        solved.rms_px,
        len(used),
        dropped,
        coverage(used, size_px),
        np.concatenate([view.image_px for view in used]),
        solved.residuals_px,
    )
    _require_plausible(fit, size_px)
    return fit


@dataclass(frozen=True)
class _Solved:
    parameters: Vector
    sigmas: Vector
    rms_px: float
    per_view_px: Vector
    residuals_px: Vector


def _calibrate(views: Sequence[TargetView], size_px: tuple[int, int], fixed_k3: bool) -> _Solved:
    flags = cv2.CALIB_FIX_K3 if fixed_k3 else 0
    all_corners_mm = [view.target_mm.astype(np.float32) for view in views]
    images = [view.image_px.astype(np.float32) for view in views]
    guess, none = np.eye(3), np.zeros(5)
    try:
        rms, matrix, distortion, turns, shifts, _, _, per_view = cv2.calibrateCameraExtended(
            all_corners_mm, images, size_px, guess, none, flags=flags
        )
    except cv2.error as error:
        raise CalibrationError(
            "camera: OpenCV finds no lens that gives these views; show the board whole, flat and tilted in all directions"
        ) from error
    residuals, derivatives = [], []
    for corners_mm, image, turn, shift in zip(all_corners_mm, images, turns, shifts, strict=True):
        projected, jacobian = cv2.projectPoints(corners_mm, turn, shift, matrix, distortion)
        residuals.append(np.asarray(image, float) - np.asarray(projected, float).reshape(-1, 2))
        derivatives.append(np.asarray(jacobian, float)[:, : _POSE + len(NAMES)])
    k = np.asarray(distortion, float).ravel()[:5]
    parameters = np.array([matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *k])
    return _Solved(
        parameters,
        _sigmas(derivatives, np.concatenate(residuals), len(NAMES) - fixed_k3),
        float(rms),
        np.asarray(per_view, float).ravel(),
        np.concatenate(residuals),
    )


def _sigmas(derivatives: Sequence[Vector], residuals_px: Vector, free: int) -> Vector:
    """Sigmas of the nine parameters, of which the first ``free`` were fitted; the poses are eliminated.

    OpenCV's own come from a pseudo-inverse. Of a board that was never tilted, where focal length and distance cannot be
    told apart, it leaves out just the uncertain direction: 0.2 px for a focal length that is 300 px off.
    """
    information = np.zeros((free, free))
    for jacobian in derivatives:
        pose, lens = jacobian[:, :_POSE], jacobian[:, _POSE : _POSE + free]
        information += lens.T @ lens - lens.T @ pose @ np.linalg.solve(pose.T @ pose, pose.T @ lens)
    freedom = max(residuals_px.size - free - _POSE * len(derivatives), 1)
    scale = 1.0 / np.sqrt(np.diag(information))  # of parameters whose units differ by orders of magnitude
    try:
        cofactors = np.diag(np.linalg.inv(information * np.outer(scale, scale))) * scale**2
    except np.linalg.LinAlgError:
        cofactors = np.full(free, np.inf)
    found = np.zeros(len(NAMES))
    found[:free] = np.sqrt(
        np.where(cofactors > 0.0, cofactors, np.inf) * float((residuals_px**2).sum()) / freedom
    )
    return found


def _require_views(views: Sequence[TargetView], size_px: tuple[int, int]) -> None:
    if len(views) < MIN_VIEWS:
        raise CalibrationError(
            f"camera: the board was found in {len(views)} pictures only; take {MIN_VIEWS} or more, "
            "sharp and with most of the board in them"
        )
    covered = coverage(views, size_px)
    if covered < MIN_COVERAGE:
        empty = coverage_grid(views, size_px) == 0
        rows, cols = np.nonzero(empty)
        side = "left" if cols.mean() < (GRID[0] - 1) / 2 else "right"
        height = "upper" if rows.mean() < (GRID[1] - 1) / 2 else "lower"
        raise CalibrationError(
            f"camera: the board covered {covered:.0%} of the picture, {MIN_COVERAGE:.0%} are needed; "
            f"show it towards the edges and corners too, most of all the {height} {side}"
        )


def _require_plausible(fit: CameraFit, size_px: tuple[int, int]) -> None:
    value, width, height = fit.values, *size_px
    if fit.rms_px > RMS_LIMIT_PX:
        raise CalibrationError(
            f"camera: {fit.rms_px:.2f} px rms are left, {RMS_LIMIT_PX} are allowed; is the board flat, its size as said "
            "with --board, and the picture sharp?"
        )
    across_deg = 2.0 * math.degrees(math.atan(width / 2.0 / value["fx_px"]))
    if not FIELD_OF_VIEW_DEG[0] <= across_deg <= FIELD_OF_VIEW_DEG[1]:
        raise CalibrationError(
            f"camera: a view of {across_deg:.0f} deg is no real lens; calibrate again with more views"
        )
    if abs(value["fx_px"] / value["fy_px"] - 1.0) > SQUARENESS_LIMIT:
        raise CalibrationError(
            f"camera: pixels of {value['fx_px'] / value['fy_px']:.2f} : 1 are not square; does the camera stretch its picture?"
        )
    for key, size in (("cx_px", width), ("cy_px", height)):
        if abs(value[key] - (size - 1) / 2.0) > CENTRE_LIMIT * size:
            raise CalibrationError(
                f"camera: {key} {value[key]:.0f} lies far from the middle of {size} px; tilt the board more, or is the "
                "picture cropped?"
            )
    if _is_non_monotonic(fit.values, size_px):
        raise CalibrationError(
            "camera: its distortion folds the picture over before the corners; show the board in the corners too"
        )
    share = fit.sigmas["fx_px"] / value["fx_px"]
    if share > FOCAL_SIGMA_LIMIT:
        raise CalibrationError(
            f"camera: the focal length is known to {share:.1%} only; tilt the board by 30 deg and more, in all directions"
        )


def _is_non_monotonic(values: dict[str, float], size_px: tuple[int, int]) -> bool:
    """Whether the distortion model is non-monotonic within the picture."""
    width, height = size_px
    corners_px = [(0.0, 0.0), (width - 1.0, 0.0), (0.0, height - 1.0), (width - 1.0, height - 1.0)]
    reach = max(
        math.hypot((u - values["cx_px"]) / values["fx_px"], (v - values["cy_px"]) / values["fy_px"])
        for u, v in corners_px
    )
    r = np.linspace(0.0, reach, 200)
    grows = 1.0 + 3.0 * values["k1"] * r**2 + 5.0 * values["k2"] * r**4 + 7.0 * values["k3"] * r**6
    return bool((grows <= 0.0).any())
