"""Stage 1, the paper's section IV-A: which cells can be the CAMERA, by one height of the skyline in each direction.

The altitude constraint comes first: |Z(CAMERA) + mast height - H| < 3 sigma. Then the directions follow, the one with the
lowest skyline first. For each CAMERA left, the POINTs along its line of sight are visited at distances x. In the errata's
exact form, a POINT on the skyline of elevation alpha has the height

    Zest = H + x tan(alpha) + (1 - k) x^2 / (2 R).

A POINT above the upper edge of the error band excludes the CAMERA. The line of sight ends where no terrain ahead can reach the
band. A CAMERA stays if its highest POINT lies within the band.

The band (the paper, section VI) covers 3 sigma of the skyline's elevation, the error of the DEM, and the height differences
over half a cell around CAMERA and POINT. The bias of the heading is not part of the band. Its hypotheses are the bits of a
mask, and a CAMERA must satisfy all directions under the same hypothesis.
"""

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from localizer.dem.horizon import VOID_M, Heights, Terrain
from localizer.jit import kernel
from localizer.search.contours import BINS, STEP_DEG, MeasuredSkyline

Floats = NDArray[np.float64]
Cells = NDArray[np.int64]

HEADINGS = 64
"""Heading hypotheses at most: one bit of the mask for each."""
SIGMAS = 3.0
"""Half width of the error band in standard deviations. Tuned on the simulated cases of ``sim evaluate``: the true cell must
stay. Sensitivity: not measured yet (``sim sensitivity``)."""


@dataclass(frozen=True)
class Band:
    """The error band of one direction: tangents (headings,) of its lower and upper edge under each heading hypothesis."""

    label: str
    azimuth_deg: float
    low: Floats
    high: Floats


@dataclass(frozen=True)
class Stage1:
    """Cells (n, 2), row and column, left by each test, in the order of the tests, and the number of POINTs visited."""

    cells: int
    survivors: dict[str, Cells]
    points_explored: int

    @property
    def last(self) -> Cells:
        """Cells (n, 2), row and column, that passed all tests."""
        return list(self.survivors.values())[-1]


def heading_offsets_deg(azimuth_bias_sigma_deg: float) -> Floats:
    """Hypotheses for the heading's bias (measured minus true), whole multiples of STEP_DEG over three sigma."""
    reach = min(SIGMAS * azimuth_bias_sigma_deg, 180.0)
    step = STEP_DEG * max(1, int(np.ceil(2.0 * reach / (HEADINGS - 1) / STEP_DEG)))
    count = int(np.ceil(reach / step))
    offsets = step * np.arange(-count, count + 1)
    return np.asarray(offsets[np.abs(offsets) <= 180.0][:HEADINGS])


def bands(skyline: MeasuredSkyline, offsets_deg: Floats) -> list[Band]:
    """The band of each frame's central column, lowest skyline first; frames without a skyline there have none."""
    step = offsets_deg[1] - offsets_deg[0] if len(offsets_deg) > 1 else STEP_DEG
    reach = max(1, round(0.5 * step / STEP_DEG))
    out = []
    for label, centre_deg in skyline.centres_deg.items():
        middle = round(centre_deg / STEP_DEG)
        low, high = np.full(len(offsets_deg), np.inf), np.full(len(offsets_deg), -np.inf)
        for k, offset in enumerate(offsets_deg):
            at = (middle + round(offset / STEP_DEG) + np.arange(-reach, reach + 1)) % BINS
            at = at[np.isfinite(skyline.elevation_deg[at])]
            if len(at):
                wide = SIGMAS * skyline.sigma_deg[at]
                low[k] = np.tan(np.radians((skyline.elevation_deg[at] - wide).min()))
                high[k] = np.tan(np.radians((skyline.elevation_deg[at] + wide).max()))
        if np.isfinite(high).any():
            # Under these hypotheses the central column has no contour: they are not tested.
            low[~np.isfinite(low)], high[~np.isfinite(high)] = -np.inf, np.inf
            out.append(Band(label, middle * STEP_DEG, low, high))
    return sorted(out, key=lambda band: float(np.median(band.high[np.isfinite(band.high)])))


def search_stage1(
    terrain: Terrain,
    directions: list[Band],
    mast_height_m: float,
    altitude_m: float | None,
    altitude_sigma_m: float,
    dem_error_m: float,
    allowed: NDArray[np.bool_] | None = None,
) -> Stage1:
    """The cells of the DEM, or of its part ``allowed`` (rows, cols), from which the central columns can be seen as measured."""
    relief = terrain.half_cell_relief_m
    ground = terrain.height_m
    cells = int(np.count_nonzero(ground > VOID_M))
    possible = ground > VOID_M
    if allowed is not None:
        possible &= allowed
    if altitude_m is not None:
        reach = SIGMAS * float(np.hypot(altitude_sigma_m, dem_error_m)) + relief
        possible &= np.abs(ground + mast_height_m - altitude_m) <= reach
    rows, cols = np.nonzero(possible)
    survivors = {"altitude": np.column_stack([rows, cols])}
    explored = 0
    mask = np.full(len(rows), np.uint64(0xFFFFFFFFFFFFFFFF))
    for band in directions:
        here = survivors[next(reversed(survivors))]
        row, col = here[:, 0].astype(float), here[:, 1].astype(float)
        eye = ground[here[:, 0], here[:, 1]].astype(float) + mast_height_m
        slack = relief[here[:, 0], here[:, 1]].astype(float)
        if altitude_m is not None:
            nearest = np.clip(altitude_m, eye - slack, eye + slack)
            slack = np.minimum(slack, SIGMAS * altitude_sigma_m)
            eye = nearest
        left, points = _search_direction(
            ground,
            relief,
            terrain.highest_m,
            terrain.drop_per_m2,
            terrain.geodesics.at(row, col),
            row,
            col,
            eye,
            np.hypot(slack, SIGMAS * dem_error_m),
            mask,
            np.radians(band.azimuth_deg),
            band.low,
            band.high,
        )
        keep = left != 0
        survivors[band.label] = here[keep]
        mask = left[keep]
        explored += int(points.sum())
    return Stage1(cells, survivors, explored)


@kernel(parallel=True)
def _search_direction(
    height: Heights,
    relief: Heights,
    highest: float,
    drop: float,
    coefficients: Floats,
    row: Floats,
    col: Floats,
    eye: Floats,
    slack: Floats,
    mask: NDArray[np.uint64],
    azimuth: float,
    low: Floats,
    high: Floats,
) -> tuple[NDArray[np.uint64], Cells]:
    """For each CAMERA the mask of heading hypotheses that its highest POINT agrees with, and the number of POINTs visited."""
    cameras = row.shape[0]
    left = np.zeros(cameras, np.uint64)
    points = np.zeros(cameras, np.int64)
    top = -np.inf
    for k in range(high.shape[0]):
        top = max(top, high[k])
    east, north = np.sin(azimuth), np.cos(azimuth)
    for n in numba.prange(cameras):
        of_camera = coefficients[n]
        row_1 = of_camera[0, 0] * east + of_camera[0, 1] * north
        row_2 = (
            of_camera[0, 2] * east * east + of_camera[0, 3] * east * north + of_camera[0, 4] * north * north
        )
        col_1 = of_camera[1, 0] * east + of_camera[1, 1] * north
        col_2 = (
            of_camera[1, 2] * east * east + of_camera[1, 3] * east * north + of_camera[1, 4] * north * north
        )
        along_rows = abs(row_1) > abs(col_1)
        a1, a2, b1, b2 = (row_1, row_2, col_1, col_2) if along_rows else (col_1, col_2, row_1, row_2)
        start, minor_start = (row[n], col[n]) if along_rows else (col[n], row[n])
        last = (height.shape[0] if along_rows else height.shape[1]) - 1
        minor_last = (height.shape[1] if along_rows else height.shape[0]) - 1
        step = 1 if a1 > 0.0 else -1
        s1, s2 = 1.0 / a1, -a2 / (a1 * a1 * a1)
        best, best_s, best_relief = -np.inf, 1.0, 0.0
        line = int(start) + step
        above = False
        while 0 <= line <= last:
            d = line - start
            s = (s1 + s2 * d) * d
            minor = minor_start + (b1 + b2 * s) * s
            if minor < 0.0 or minor > minor_last:
                break
            sight = eye[n] + (best + drop * s) * s
            if best >= 0.0 and sight > highest:
                break
            points[n] += 1
            j = min(int(minor), minor_last - 1)
            f = minor - j
            if along_rows:
                z = height[line, j] * (1.0 - f) + height[line, j + 1] * f
            else:
                z = height[j, line] * (1.0 - f) + height[j + 1, line] * f
            if z > sight:
                near = int(minor + 0.5)
                around = relief[line, near] if along_rows else relief[near, line]
                best, best_s, best_relief = (z - eye[n]) / s - drop * s, s, around
                if z - np.hypot(around, slack[n]) > eye[n] + (top + drop * s) * s:
                    above = True
                    break
            line += step
        if above:
            continue
        tolerance = np.hypot(slack[n], best_relief) / best_s
        agreed = np.uint64(0)
        for k in range(low.shape[0]):
            if low[k] - tolerance <= best <= high[k] + tolerance:
                agreed |= np.uint64(1) << np.uint64(k)
        left[n] = agreed & mask[n]
    return left, points
