"""Disturbs contours: foreground objects, clouds, and what the skyline finder makes of them."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from sim.evaluate.scenario import Cloud, EvaluationScenario, Foreground, Occlusion
from sim.evaluate.truth import Generators, Truth
from sim.world.contour import skyline_contour
from sim.world.scenario import CameraOptics
from sim.world.surface import Surface

Array = NDArray[np.float64]

WIDTH_SPREAD = 0.6  # of the logarithm of widths
MAST_SHARE = 0.2  # of what stands in the foreground is a mast or a trunk, ...
MAST_WIDTH_DEG = 0.5  # ... so wide
RAGGED_DEG = 0.1  # how uneven leaves and rocks are
RAGGED_COLUMNS = 3.0
SAME_ROW_PX = 1e-2


@dataclass(frozen=True)
class Disturbed:
    """Contours of all frames: rows (n,) for each, NaN if missing, and whether they are the terrain's."""

    rows_px: tuple[Array, ...]
    genuine: tuple[NDArray[np.bool_], ...]


def disturb(
    truth: Truth, scenario: EvaluationScenario, columns_px: Array, contours: list[Array], rng: Generators
) -> Disturbed:
    """The exact contours (n,) of the frames with foreground, occlusion, clouds and contour noise."""
    rows = [contour.copy() for contour in contours]
    optics = scenario.camera
    if scenario.cloud is not None:
        hidden = _clouds(truth, scenario.cloud, optics, columns_px, rows, rng("cloud"))
        rows = [np.where(h, lower, row) for (h, lower), row in zip(hidden, rows, strict=True)]
    if scenario.foreground is not None:
        for row in rows:
            _foreground(row, scenario.foreground, optics, rng("foreground"))
    if scenario.occlusion is not None:
        _occlude(rows, scenario.occlusion, optics, rng("occlusion"))
    genuine = tuple(row == contour for row, contour in zip(rows, contours, strict=True))
    noise = rng("contour")
    return Disturbed(tuple(row + contour_noise(len(row), scenario, noise) for row in rows), genuine)


def contour_noise(columns: int, scenario: EvaluationScenario, rng: np.random.Generator) -> Array:
    """Errors (n,) in pixels of neighbouring columns: white, and correlated as exp(-(distance / length)^2)."""
    errors = scenario.errors
    white: Array = errors.contour_sigma_px * rng.standard_normal(columns)
    spread = errors.contour_correlation_px / 2.0
    smooth = ndimage.gaussian_filter1d(rng.standard_normal(columns), spread, mode="wrap")
    smooth *= errors.contour_correlated_sigma_px * np.sqrt(2.0 * spread * np.sqrt(np.pi))
    return np.asarray(white + smooth)


def _stretches(
    mean_number: float, width_deg: float, optics: CameraOptics, columns: int, rng: np.random.Generator
) -> Iterator[slice]:
    """Random intervals of columns."""
    px_per_deg = optics.fx_px * np.pi / 180.0
    for _ in range(rng.poisson(mean_number)):
        width = float(width_deg * np.exp(WIDTH_SPREAD * rng.standard_normal()))
        middle, half = rng.uniform(0.0, columns), 0.5 * width * px_per_deg
        yield slice(max(int(middle - half), 0), max(int(middle + half) + 1, 0))


def _foreground(row: Array, what: Foreground, optics: CameraOptics, rng: np.random.Generator) -> None:
    px_per_deg = optics.fy_px * np.pi / 180.0
    for where in _stretches(what.per_frame, what.width_deg, optics, len(row), rng):
        mast = rng.uniform() < MAST_SHARE
        noticed = rng.uniform() < what.noticed
        height_px = rng.exponential(what.height_deg) * px_per_deg
        count = len(row[where])
        if mast:
            middle = (where.start + where.start + count) // 2
            half = int(0.5 * MAST_WIDTH_DEG * px_per_deg)
            where = slice(max(middle - half, 0), middle + half + 1)
            shape = np.full(len(row[where]), max(4.0 * height_px, 20.0))
        else:
            across = np.linspace(-1.0, 1.0, count) if count > 1 else np.zeros(count)
            ragged = ndimage.gaussian_filter1d(rng.standard_normal(count), RAGGED_COLUMNS, mode="nearest")
            shape = height_px * np.sqrt(1.0 - across**2) + np.abs(ragged) * RAGGED_DEG * px_per_deg * 3.0
        row[where] = np.nan if noticed else row[where] - shape
    row[row < -0.5] = np.nan


def _occlude(rows: list[Array], what: Occlusion, optics: CameraOptics, rng: np.random.Generator) -> None:
    px_per_deg = optics.fy_px * np.pi / 180.0
    for i in rng.permutation(len(rows))[: what.frames]:
        count = len(rows[i])
        walk = np.cumsum(rng.standard_normal(count)) * 0.4
        slope = rng.normal(0.0, 0.15) * np.linspace(-0.5, 0.5, count) * count
        above = rng.exponential(what.height_deg) * px_per_deg
        near = np.nanmin(rows[i], initial=optics.height_px - 0.5) - above + slope + walk - walk.mean()
        near[near < -0.5] = np.nan
        rows[i][:] = np.nan if rng.uniform() < what.missing else near


def _clouds(
    truth: Truth,
    what: Cloud,
    optics: CameraOptics,
    columns_px: Array,
    rows: list[Array],
    rng: np.random.Generator,
) -> list[tuple[NDArray[np.bool_], Array]]:
    """For each frame the columns with clouds, and the skyline of the terrain left visible there."""
    eye_m = truth.observer.altitude_m
    share = rng.uniform(what.lowest_share, what.highest_share)
    base_m = eye_m + share * max(_highest_in_view_m(truth) - eye_m, 1.0)
    surface = truth.surface
    below = Surface(replace(surface.terrain, height_m=np.minimum(surface.height_m, np.float32(base_m))))
    out = []
    for frame, row in zip(truth.frames, rows, strict=True):
        hidden, seen = np.zeros(len(row), bool), row.copy()
        for where in _stretches(what.per_frame, what.width_deg, optics, len(row), rng):
            lower = skyline_contour(below, truth.observer, optics, frame.rotation, columns_px[where])
            covered = ~(
                np.abs(lower - row[where]) < SAME_ROW_PX
            )  # the rest of the stretch is below the cloud
            hidden[where] |= covered
            noticed = rng.uniform() < what.noticed
            seen[where] = np.where(covered, np.nan if noticed else lower, seen[where])
        out.append((hidden, seen))
    return out


def _highest_in_view_m(truth: Truth) -> float:
    """Altitude of the highest skyline point."""
    azimuths = np.arange(0.0, 360.0, 1.0)
    angle_deg, distance_m = truth.surface.horizon(truth.observer, azimuths)
    rise_m = distance_m * np.tan(np.radians(angle_deg)) + truth.surface.drop_per_m2 * distance_m**2
    return float(truth.observer.altitude_m + np.nanmax(rise_m, initial=0.0))


def true_contours(truth: Truth, optics: CameraOptics, columns_px: Array) -> list[Array]:
    """The exact skyline rows (n,) of every frame."""
    return [
        skyline_contour(truth.surface, truth.observer, optics, frame.rotation, columns_px)
        for frame in truth.frames
    ]
