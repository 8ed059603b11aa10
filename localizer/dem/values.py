"""Decoding of a raster band: band number, unit, scale and voids."""

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from localizer.dem.open import DemError

if TYPE_CHECKING:
    from rasterio import DatasetReader

LOWEST_M, HIGHEST_M = -500.0, 9000.0
"""Elevations outside this range are voids: there is no such land, but undeclared nodata values lie there."""
USUAL_VOIDS = (-999.0, -9999.0, -99999.0, -32767.0, -32768.0, 9999.0, 99999.0, 32767.0, 65535.0)
"""Common nodata values. After scaling they could lie within the range of elevations."""
VOID_GAP_M = 20.0
"""A common nodata value is a void if it lies this far beyond all other cells: terrain has all elevations in between."""
MOST_NAMED = 6

Raw = NDArray[np.generic]


def band_of(dataset: "DatasetReader", path: Path, band: int | None) -> int:
    """The number of the band that holds the elevations, from 1. Raises ``DemError``."""
    from rasterio.enums import ColorInterp

    colours = dict(zip(dataset.indexes, dataset.colorinterp, strict=True))
    if band is not None:
        if band not in dataset.indexes:
            raise DemError(f"{path}: has no band {band}, only 1 to {dataset.count}; see --band")
        chosen = band
    else:
        bands = [i for i in dataset.indexes if colours[i] != ColorInterp.alpha]
        painted = {ColorInterp.red, ColorInterp.green, ColorInterp.blue}
        if len(painted & {colours[i] for i in bands}) > 1 and dataset.dtypes[0] == "uint8":
            raise DemError(
                f"{path}: is a picture in colours, not elevations; a Terrain-RGB tile or a shaded relief has to be turned into "
                "metres first, with gdal_calc"
            )
        if len(bands) != 1:
            raise DemError(f"{path}: has {_bands(dataset)}; choose the elevations with --band N")
        chosen = bands[0]
    if colours[chosen] == ColorInterp.palette:
        raise DemError(
            f"{path}: band {chosen} holds numbers of colours, not elevations; take the elevations themselves"
        )
    if np.dtype(dataset.dtypes[chosen - 1]).kind not in "iuf":
        raise DemError(f"{path}: holds {dataset.dtypes[chosen - 1]} values, which are no elevations")
    return chosen


def _bands(dataset: "DatasetReader") -> str:
    named = [
        f"{i} ({text})" if (text := dataset.descriptions[i - 1]) else str(i)
        for i in dataset.indexes[:MOST_NAMED]
    ]
    more = ", ..." if dataset.count > MOST_NAMED else ""
    return f"{dataset.count} bands: {', '.join(named)}{more}"


def scale_of(dataset: "DatasetReader", path: Path, band: int, scale: float | None) -> tuple[float, float]:
    """Scale and offset of a band; ``scale`` takes precedence over the file's. Raises ``DemError``."""
    own_scale, offset = dataset.scales[band - 1], dataset.offsets[band - 1]
    if not math.isfinite(offset):
        raise DemError(f"{path}: its band's offset is {offset}; mend it with gdal_edit -a_offset 0")
    if scale is None and not (math.isfinite(own_scale) and own_scale != 0.0):
        raise DemError(
            f"{path}: its band's scale is {own_scale:g}, which makes no elevations; name it with --scale, as --scale 1"
        )
    return (own_scale if scale is None else scale), offset


def elevations_m(
    dataset: "DatasetReader", band: int, scale: float, offset: float, unit_m: float, nodata: float | None
) -> NDArray[np.float64]:
    """The band in metres, (rows, cols), voids NaN: masked, transparent, declared, undeclared, and what no land has."""
    from rasterio.enums import ColorInterp

    raw = dataset.read(band, masked=True)
    z: NDArray[np.float64] = raw.astype(np.float64).filled(np.nan)
    for other, colour in zip(dataset.indexes, dataset.colorinterp, strict=True):
        if colour == ColorInterp.alpha and other != band:
            z[dataset.read(other) == 0] = np.nan
    if nodata is not None:
        z[raw.data == nodata] = np.nan  # in the precision of the file: a float32 void is not what z has
    if raw.dtype.kind in "iu" and raw.dtype.itemsize > 1:
        limits = np.iinfo(raw.dtype)
        for void in {limits.max, limits.min} - {0}:
            z[raw.data == void] = np.nan  # a void, or ground that did not fit the type
    z_m: NDArray[np.float64] = (z * scale + offset) * unit_m
    with np.errstate(invalid="ignore"):
        z_m[~((z_m >= LOWEST_M) & (z_m <= HIGHEST_M))] = np.nan
    if (scale, offset, unit_m) != (1.0, 0.0, 1.0):
        _drop_usual_voids(z, z_m)
    return z_m


def _drop_usual_voids(z: NDArray[np.float64], z_m: NDArray[np.float64]) -> None:
    """Make cells with a common nodata value void, if it lies apart from all other elevations."""
    for void in USUAL_VOIDS:
        here = (z == void) & np.isfinite(z_m)
        if not here.any():
            continue
        others = z_m[np.isfinite(z_m) & ~here]
        void_m = float(z_m[here][0])
        if not others.size or void_m < others.min() - VOID_GAP_M or void_m > others.max() + VOID_GAP_M:
            z_m[here] = np.nan
