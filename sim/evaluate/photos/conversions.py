"""Converts published poses and traces to the contract's conventions."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pyproj import CRS, Transformer

Floats = NDArray[np.float64]

_STEP_M = 100.0


def grid_convergence_deg(crs: CRS, easting_m: float, northing_m: float) -> float:
    """True azimuth of grid north at a place; positive where grid north points east of true north."""
    geographic = crs.geodetic_crs
    geod = crs.get_geod()
    if geographic is None or geod is None:
        raise ValueError(f"{crs.name} has no geodetic datum")
    lon, lat = Transformer.from_crs(crs, geographic.to_2d(), always_xy=True).transform(
        [easting_m, easting_m], [northing_m - _STEP_M, northing_m + _STEP_M]
    )
    azimuth_deg, _, _ = geod.inv(lon[0], lat[0], lon[1], lat[1])
    return float(azimuth_deg)


def true_azimuth_deg(crs: CRS, easting_m: float, northing_m: float, grid_azimuth_deg: float) -> float:
    """True azimuth, 0 to 360, of a grid azimuth."""
    return (grid_azimuth_deg + grid_convergence_deg(crs, easting_m, northing_m)) % 360.0


def principal_point_px(size_px: Sequence[int], offset_px: Sequence[float]) -> tuple[float, float]:
    """cx, cy of a principal point given as an offset from the picture's middle.

    The middle of a picture w pixels wide is w / 2 from its left border, and the contract counts from the centre of the first
    pixel, half a pixel further in.
    """
    return size_px[0] / 2.0 - 0.5 + offset_px[0], size_px[1] / 2.0 - 0.5 + offset_px[1]


def cropped(principal_point: tuple[float, float], left_px: int, top_px: int) -> tuple[float, float]:
    """cx, cy after cropping columns on the left and rows at the top."""
    return principal_point[0] - left_px, principal_point[1] - top_px


def trace_rows_px(lines: Sequence[ArrayLike], width_px: int) -> Floats:
    """Row per column (width,) of a skyline traced as polylines [(x, y), ...] counted from the picture's corner; NaN in gaps.

    Where two lines overlap the upper one counts.
    """
    column = np.arange(width_px, dtype=float)
    rows = np.full(width_px, np.nan)
    for line in lines:
        points = np.asarray(line, float) - 0.5
        points = points[np.argsort(points[:, 0], kind="stable")]
        row = np.interp(column, points[:, 0], points[:, 1], left=np.nan, right=np.nan)
        rows = np.fmin(rows, row)
    return rows


def distortion_of(
    radial: Sequence[float], tangential: Sequence[float]
) -> tuple[float, float, float, float, float]:
    """k1, k2, p1, p2, k3 as OpenCV and the contract order them. Raises ValueError for a rational model (k4 to k6)."""
    k: list[Any] = list(radial)
    if any(k[3:]):
        raise ValueError("the lens has a rational distortion (k4, k5, k6), which a bundle cannot state")
    return k[0], k[1], tangential[0], tangential[1], k[2]
