"""One elevation file as it lies on disk: opened by rasterio, brought to metres, north up, voids as NaN."""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from affine import Affine
from numpy.typing import NDArray
from pyproj import CRS
from pyproj.exceptions import CRSError

from localizer.dem.crs import WGS84, is_projected, transform_xy
from localizer.dem.datum import is_named, is_of_the_earth
from localizer.dem.heights import Heights, heights_of
from localizer.dem.open import DemError, opened
from localizer.dem.units import UNSTATED, VERTICAL_UNITS, unit_named
from localizer.dem.values import HIGHEST_M, LOWEST_M, band_of, elevations_m, scale_of

if TYPE_CHECKING:
    from rasterio import DatasetReader

__all__ = ["MAX_CELLS", "DemError", "DemFile", "Tile", "read_tile"]

MAX_CELLS = 250_000_000


@dataclass(frozen=True)
class DemFile:
    """What a file says about itself."""

    path: Path
    driver: str
    shape: tuple[int, int]
    dtype: str
    pixel_is: str
    """"point" or "area", as the file declares; the transform already accounts for it."""
    vertical_unit: str
    """A key of ``VERTICAL_UNITS``."""
    vertical_unit_from: str
    """Source of the unit: "option", "band", "CRS" or "assumed"."""
    voids: int
    band: int = 1
    scale: float = 1.0
    """Stored numbers times this are in the vertical unit."""
    vertical_datum: str | None = None
    """Vertical datum by the file's CRS; None if not stated."""
    overruled: tuple[str, ...] = ()
    """Notes on metadata of the file that an option overrides."""


@dataclass(frozen=True)
class Tile:
    """A file's elevations in metres, (rows, cols) float32, row 0 northernmost, voids NaN."""

    z_m: NDArray[np.float32]
    transform: Affine
    crs: CRS
    """Horizontal."""
    file: DemFile
    heights: Heights = field(default_factory=Heights)


def read_tile(
    path: Path,
    vertical_unit: str | None,
    crs: str | None,
    nodata: float | None,
    band: int | None = None,
    scale: float | None = None,
) -> Tile:
    """Read one file; the options take precedence over what the file says. Raises ``DemError``."""
    path = Path(path)
    with opened(path) as dataset:
        return _tile_of(dataset, path, vertical_unit, crs, nodata, band, scale)


def _tile_of(
    dataset: "DatasetReader",
    path: Path,
    vertical_unit: str | None,
    crs: str | None,
    nodata: float | None,
    wanted_band: int | None,
    wanted_scale: float | None,
) -> Tile:
    band = band_of(dataset, path, wanted_band)
    _check_layout(dataset, path)
    stated_crs = _crs_of(dataset, path, crs)
    unit, unit_from = _vertical_unit(dataset, path, stated_crs, vertical_unit, band)
    overruled = _overruled(dataset, path, stated_crs, crs, vertical_unit, band, wanted_scale)
    scale, offset = scale_of(dataset, path, band, wanted_scale)
    heights = heights_of(_own_crs(dataset, stated_crs))
    if heights.downward and wanted_scale is None and scale > 0.0:
        raise DemError(
            f"{path}: its values count downwards ({heights.name}); say --scale -1, or --scale 1 where they are elevations all "
            "the same"
        )
    z_m = elevations_m(dataset, band, scale, offset, VERTICAL_UNITS[unit], nodata)
    voids = int(np.count_nonzero(np.isnan(z_m)))
    if voids == z_m.size:
        raise DemError(f"{path}: all void, no cell has an elevation between {LOWEST_M:g} and {HIGHEST_M:g} m")
    z_m, transform = _north_up(z_m, dataset.transform)
    return Tile(
        z_m=np.ascontiguousarray(z_m, np.float32),
        transform=transform,
        crs=stated_crs.to_2d(),
        heights=heights,
        file=DemFile(
            path=path,
            driver=dataset.driver,
            shape=(dataset.height, dataset.width),
            dtype=dataset.dtypes[band - 1],
            pixel_is=str(dataset.tags().get("AREA_OR_POINT", "Area")).lower(),
            vertical_unit=unit,
            vertical_unit_from=unit_from,
            voids=voids,
            band=band,
            scale=scale,
            vertical_datum=heights.name,
            overruled=overruled,
        ),
    )


def _check_layout(dataset: "DatasetReader", path: Path) -> None:
    rows, cols = dataset.shape
    if rows * cols > MAX_CELLS:
        raise DemError(f"{path}: {rows} x {cols} cells are too many; cut the area out with gdalwarp -te")
    transform = dataset.transform
    if transform.is_identity or transform.a == 0.0 or transform.e == 0.0:
        raise DemError(f"{path}: is not georeferenced (no north-up grid origin and spacing)")
    # a hundredth of a cell across the whole file is rounding, not rotation
    if abs(transform.b) * rows > 0.01 * abs(transform.a) or abs(transform.d) * cols > 0.01 * abs(transform.e):
        raise DemError(f"{path}: its grid is rotated; make it north-up with gdalwarp")


def _own_crs(dataset: "DatasetReader", taken: CRS) -> CRS:
    """The file's own CRS for the vertical datum, if --crs names a horizontal one only."""
    if len(taken.axis_info) > 2 or not dataset.crs:
        return taken
    try:
        return CRS.from_wkt(dataset.crs.to_wkt())
    except CRSError:
        return taken


def _crs_of(dataset: "DatasetReader", path: Path, option: str | None) -> CRS:
    if option is None and not dataset.crs:
        raise DemError(
            f"{path}: does not say its coordinate reference system; name it with --crs, as EPSG:4326"
        )
    try:
        crs = CRS.from_user_input(option if option is not None else dataset.crs.to_wkt())
    except CRSError:
        where, stated = ("--crs", repr(option)) if option is not None else (str(path), dataset.crs)
        raise DemError(f"{where}: not a coordinate reference system: {stated}") from None
    if not (crs.is_geographic or is_projected(crs)):
        raise DemError(f"{path}: {crs.name} is neither geographic nor projected; name another with --crs")
    if not is_of_the_earth(crs):
        raise DemError(
            f"{path}: {crs.name} lies on another body than the Earth, which is the only one that can be searched"
        )
    return crs if option is not None else _named(crs, dataset)


def _overruled(
    dataset: "DatasetReader",
    path: Path,
    taken: CRS,
    crs: str | None,
    vertical_unit: str | None,
    band: int,
    scale: float | None,
) -> tuple[str, ...]:
    """Notes on overridden metadata: a mistaken option would move a fix by kilometres."""
    notes = []
    if crs is not None and dataset.crs:
        own = _named(CRS.from_wkt(dataset.crs.to_wkt()), dataset)
        if not own.to_2d().equals(taken.to_2d(), ignore_axis_order=True):
            notes.append(f"{path}: says {own.name}; --crs takes it for {taken.name}")
    if vertical_unit is not None and dataset.units[band - 1]:
        own_unit = unit_named(dataset.units[band - 1])
        if own_unit is not None and own_unit != vertical_unit:
            notes.append(
                f"{path}: says its elevations are in {own_unit}; --vertical-unit takes them for {vertical_unit}"
            )
    if scale is not None and dataset.scales[band - 1] not in (scale, 1.0):
        notes.append(
            f"{path}: says its scale is {dataset.scales[band - 1]:g}; --scale takes it for {scale:g}"
        )
    return tuple(notes)


def _named(crs: CRS, dataset: "DatasetReader") -> CRS:
    """The CRS by its EPSG code if it is the same one; the CRS of USGS DEMs, for example, has no name."""
    code = crs.to_epsg()
    if code is None or len(crs.axis_info) != 2 or not is_named(crs):
        return crs  # an unnamed datum could be several listed ones
    listed = CRS.from_epsg(code)
    corners = dataset.bounds
    x, y = [corners.left, corners.right], [corners.bottom, corners.top]
    same = np.allclose(transform_xy(crs, WGS84, x, y), transform_xy(listed, WGS84, x, y), rtol=0.0, atol=1e-9)
    return listed if same else crs


def _vertical_unit(
    dataset: "DatasetReader", path: Path, crs: CRS, option: str | None, band: int
) -> tuple[str, str]:
    if option is not None:
        if option not in VERTICAL_UNITS:
            raise DemError(f"--vertical-unit: {option} is not one of {', '.join(VERTICAL_UNITS)}")
        return option, "option"
    band_unit = dataset.units[band - 1]
    if band_unit is not None and band_unit.strip().lower() not in UNSTATED:
        named = unit_named(band_unit)
        if named is not None:
            return named, "band"
        raise DemError(f"{path}: its vertical unit {band_unit!r} is unknown; name it with --vertical-unit")
    for axis in crs.axis_info:
        if axis.direction in ("up", "down"):
            for unit, metres in VERTICAL_UNITS.items():
                if math.isclose(axis.unit_conversion_factor, metres, rel_tol=1e-9):
                    return unit, "CRS"
            raise DemError(
                f"{path}: the unit of its vertical axis ({axis.unit_name}) is unknown; "
                "name the unit of the elevations with --vertical-unit"
            )
    if crs.is_projected and any(axis.unit_conversion_factor != 1.0 for axis in crs.axis_info):
        raise DemError(
            f"{path}: its grid is in {crs.axis_info[0].unit_name} but the vertical unit is not stated; "
            "name it with --vertical-unit"
        )
    return "m", "assumed"


def _north_up(z_m: NDArray[np.float64], transform: Affine) -> tuple[NDArray[np.float64], Affine]:
    """Row 0 northernmost and column 0 westernmost."""
    rows, cols = z_m.shape
    if transform.e > 0.0:
        z_m, transform = z_m[::-1], transform @ Affine(1, 0, 0, 0, -1, rows)
    if transform.a < 0.0:
        z_m, transform = z_m[:, ::-1], transform @ Affine(-1, 0, cols, 0, 1, 0)
    # rotation terms within the rounding tolerance are dropped
    return z_m, Affine(transform.a, 0.0, transform.c, 0.0, transform.e, transform.f)
