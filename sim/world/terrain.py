"""The simulator's own reading of a digital elevation model."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rasterio
import rasterio.errors
from affine import Affine
from numpy.typing import NDArray
from pyproj import CRS, Geod, Transformer
from pyproj.exceptions import CRSError
from rasterio.enums import ColorInterp

from sim.errors import SimulationError

FEET = {
    "ft": 0.3048,
    "foot": 0.3048,
    "feet": 0.3048,
    "us survey foot": 1200.0 / 3937.0,
    "us-ft": 1200.0 / 3937.0,
}
DECIMAL = {
    "dm": 0.1,
    "decimetre": 0.1,
    "decimeter": 0.1,
    "cm": 0.01,
    "centimetre": 0.01,
    "centimeter": 0.01,
    "mm": 0.001,
}
METRES = {"", "m", "metre", "metres", "meter", "meters"}
NOT_UPRIGHT = ("transverse", "hotine", "oblique", "space oblique", "swiss oblique")
_GEOD = Geod(ellps="WGS84")
LOWEST_M, HIGHEST_M = -501.0, 9001.0  # no land lies beyond
NETWORK = re.compile(
    r"vsi(curl|s3|gs|az|adls|oss|swift|hdfs|webhdfs)|\b(https?|ftp|s3|gs|az|abfss?):/", re.IGNORECASE
)
ALIGNMENT_TOLERANCE_CELLS = 0.01  # adjoining files must lie on one lattice


@dataclass(frozen=True)
class Terrain:
    """Elevations on a lattice; rows count southwards, cell centres are at whole numbers of (row, col)."""

    name: str
    height_m: NDArray[np.float32]  # (rows, cols); NaN where the file has none
    transform: Affine  # (col, row), cell centres at whole numbers, to the CRS's x, y
    crs: CRS
    metric_crs: CRS  # the DEM's own where that is projected in metres, else the UTM zone of its centre
    _to_wgs84: Transformer
    _from_wgs84: Transformer
    _wgs84_to_metric: Transformer

    def lonlat_deg(
        self, row: NDArray[np.float64] | float, col: NDArray[np.float64] | float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """WGS84 longitude, -180 <= lon < 180, and latitude of lattice positions."""
        lon, lat = self._to_wgs84.transform(*_apply(self.transform, np.asarray(col), np.asarray(row)))
        lon = np.asarray(lon)
        return np.where(np.abs(lon) < 180.0, lon, lon - 360.0 * np.floor((lon + 180.0) / 360.0)), np.asarray(
            lat
        )

    def row_col(
        self, lon_deg: NDArray[np.float64] | float, lat_deg: NDArray[np.float64] | float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Lattice position of WGS84 longitudes (in any 360 degree range) and latitudes."""
        lon = np.remainder(np.asarray(lon_deg, np.float64) + 180.0, 360.0) - 180.0
        x, y = self._from_wgs84.transform(lon, lat_deg)
        if (turn := _x_period(self.crs)) is not None:
            middle = self.transform.c + self.transform.a * (self.height_m.shape[1] - 1) / 2.0
            x = x - turn * np.round((x - middle) / turn)
        col, row = _apply(~self.transform, np.asarray(x), np.asarray(y))
        return row, col

    def easting_northing_m(self, row: float, col: float) -> tuple[float, float]:
        """Position in ``metric_crs`` of a lattice position."""
        if self.metric_crs == self.crs:
            x, y = _apply(self.transform, np.asarray(col), np.asarray(row))
            return float(x), float(y)
        easting, northing = self._wgs84_to_metric.transform(*self.lonlat_deg(row, col))
        return float(easting), float(northing)

    def cell_size_m(self) -> tuple[float, float]:
        """Extent of the middle cell southwards and eastwards, metres of the ground."""
        row, col = (np.array(self.height_m.shape) - 1) / 2.0
        lon, lat = self.lonlat_deg(np.array([row, row + 1, row]), np.array([col, col, col + 1]))
        _, _, length_m = _GEOD.inv(lon[[0, 0]], lat[[0, 0]], lon[1:], lat[1:])
        return float(length_m[0]), float(length_m[1])


def read_terrain(paths: Sequence[Path]) -> Terrain:
    """Read one raster, or several adjoining ones on one lattice, as one terrain.

    Raises:
        SimulationError: a file is no raster, has no CRS, holds voids only, or does not adjoin the first.
    """
    if not paths:
        raise SimulationError("no DEM given; name one with --dem FILE")
    tiles = [_read_tile(path) for path in paths]
    height_m, transform, crs = tiles[0] if len(tiles) == 1 else _mosaic(paths, tiles)
    to_wgs84 = Transformer.from_crs(crs, "EPSG:4326", always_xy=True)
    middle_row, middle_col = (np.array(height_m.shape) - 1.0) / 2.0
    middle = to_wgs84.transform(*_apply(transform, middle_col, middle_row))
    metric_crs = crs if _is_metric(crs) else _utm_of(*middle)
    return Terrain(
        name=", ".join(path.name for path in paths),
        height_m=height_m,
        transform=transform,
        crs=crs,
        metric_crs=metric_crs,
        _to_wgs84=to_wgs84,
        _from_wgs84=Transformer.from_crs("EPSG:4326", crs, always_xy=True),
        _wgs84_to_metric=Transformer.from_crs("EPSG:4326", metric_crs, always_xy=True),
    )


def crs_name(crs: CRS) -> str:
    """``EPSG:n`` where there is such a code, else the CRS in WKT."""
    authority = crs.to_authority()
    return ":".join(authority) if authority else str(crs.to_wkt())


def _read_tile(path: Path) -> tuple[NDArray[np.float32], Affine, CRS]:
    name = str(path)
    if NETWORK.search(name):
        raise SimulationError(f"DEM {path}: lies on a network, and nothing is downloaded; name a file")
    if path.exists() and not path.is_file():  # a pipe would be waited for
        raise SimulationError(f"DEM {path}: is not a file but a directory or a pipe")
    if path.is_file() and name.endswith(".gz"):
        name = f"/vsigzip/{name}"
    packed = re.match(r"(?:/vsi(?:zip|gzip|tar)/)+", name)
    inner = Path(name[packed.end() - 1 :]) if packed else None
    if packed and inner and any(folder.is_file() for folder in (inner, *inner.parents)):
        name = name[: packed.end()] + str(inner)  # absolute: Path removes the second slash
    try:
        with rasterio.open(name) as dataset:
            if dataset.crs is None:
                raise SimulationError(
                    f"DEM {path}: the file names no CRS; add one, for example with gdal_edit"
                )
            height_m = _elevations_m(path, dataset)
            transform, crs = (
                dataset.transform @ Affine.translation(0.5, 0.5),
                CRS.from_wkt(dataset.crs.to_wkt()),
            )
    except (rasterio.errors.RasterioError, CRSError) as error:
        raise SimulationError(f"DEM {path}: {error}; name a raster that GDAL reads") from error
    ellipsoid = crs.ellipsoid
    earthly = ellipsoid is None or 6.35e6 < (ellipsoid.semi_major_metre or 0.0) < 6.40e6
    if not (crs.is_geographic or crs.is_projected) or not earthly:
        raise SimulationError(
            f"DEM {path}: its CRS, {crs.name}, is nowhere on the Earth; correct it, for example with gdal_edit"
        )
    if not np.isfinite(height_m).any():
        raise SimulationError(f"DEM {path}: holds nothing but voids; name another file")
    return height_m.astype(np.float32), transform, crs


def _elevations_m(path: Path, dataset: rasterio.DatasetReader) -> NDArray[np.float64]:
    """The band in metres, voids NaN: masked, transparent, and values outside the range of land."""
    bands = [i for i in dataset.indexes if dataset.colorinterp[i - 1] != ColorInterp.alpha]
    if len(bands) != 1:
        raise SimulationError(f"DEM {path}: holds {len(bands)} bands; name a file with the elevations alone")
    index = bands[0] - 1
    scale, offset = dataset.scales[index], dataset.offsets[index]
    if not (np.isfinite([scale, offset]).all() and scale != 0.0):
        raise SimulationError(f"DEM {path}: its scale {scale:g} and offset {offset:g} make no elevations")
    band = dataset.read(bands[0], masked=True)
    height_m: NDArray[np.float64] = np.where(np.ma.getmaskarray(band), np.nan, band.data).astype(np.float64)
    for other in set(dataset.indexes) - set(bands):
        height_m[dataset.read(other) == 0] = np.nan
    height_m = (height_m * scale + offset) * _metres_per_unit(path, dataset.units[index])
    with np.errstate(invalid="ignore"):
        height_m[~((height_m > LOWEST_M) & (height_m < HIGHEST_M))] = np.nan
    return np.asarray(height_m)


def _metres_per_unit(path: Path, unit: str | None) -> float:
    name = (unit or "").strip().lower()
    if name in METRES:
        return 1.0
    if name in FEET:
        return FEET[name]
    if name.removesuffix("s") in DECIMAL:
        return DECIMAL[name.removesuffix("s")]
    raise SimulationError(f"DEM {path}: unknown vertical unit {unit!r}; convert the file to metres")


def _mosaic(
    paths: Sequence[Path], tiles: list[tuple[NDArray[np.float32], Affine, CRS]]
) -> tuple[NDArray[np.float32], Affine, CRS]:
    """Paste the tiles onto the first one's lattice, extended to hold them all."""
    _, transform, crs = tiles[0]
    corners = []
    tiles = [_shifted_next_to(tiles[0], tile) for tile in tiles]
    for path, (height_m, tile_transform, tile_crs) in zip(paths, tiles, strict=True):
        col, row = _apply(~transform, np.asarray(tile_transform.c), np.asarray(tile_transform.f))
        corner = np.array([round(float(row)), round(float(col))])
        same_step = np.allclose(
            [tile_transform.a, tile_transform.b, tile_transform.d, tile_transform.e],
            [transform.a, transform.b, transform.d, transform.e],
            rtol=ALIGNMENT_TOLERANCE_CELLS / max(height_m.shape),
            atol=0.0,
        )
        aligned = np.abs(corner - (row, col)).max() <= ALIGNMENT_TOLERANCE_CELLS
        if tile_crs != crs or not same_step or not aligned:
            raise SimulationError(
                f"DEM {path}: not on the lattice of {paths[0]}; resample it to that file's grid"
            )
        corners.append(corner)
    north_west = np.min(corners, axis=0)
    south_east = np.max([c + np.array(t[0].shape) for c, t in zip(corners, tiles, strict=True)], axis=0)
    whole = np.full(south_east - north_west, np.nan, dtype=np.float32)
    for corner, (height_m, _, _) in zip(corners, tiles, strict=True):
        row, col = corner - north_west
        part = whole[row : row + height_m.shape[0], col : col + height_m.shape[1]]
        part[:] = np.where(np.isnan(part), height_m, part)
    return whole, transform @ Affine.translation(float(north_west[1]), float(north_west[0])), crs


def _shifted_next_to(
    first: tuple[NDArray[np.float32], Affine, CRS], tile: tuple[NDArray[np.float32], Affine, CRS]
) -> tuple[NDArray[np.float32], Affine, CRS]:
    """A tile with its x shifted by multiples of 360 degrees to be closest to the first one, for both sides of the date
    line.
    """
    height_m, transform, crs = tile
    turn = _x_period(crs)
    if turn is None:
        return tile
    middle, first_middle = (t[1].c + t[1].a * t[0].shape[1] / 2.0 for t in (tile, first))
    return height_m, Affine.translation(turn * round((first_middle - middle) / turn), 0.0) @ transform, crs


def _x_period(crs: CRS) -> float | None:
    """The x period of 360 degrees of longitude, if the CRS is geographic or a normal cylindrical projection; else None."""
    unit = crs.axis_info[0].unit_conversion_factor
    if crs.is_geographic:
        return float(2.0 * np.pi / unit) if crs.axis_info[0].unit_name != "degree" else 360.0
    operation = crs.coordinate_operation
    if operation is None or operation.method_name.lower().startswith(NOT_UPRIGHT):
        return None
    if not any(name in operation.method_name.lower() for name in ("mercator", "cylindrical")):
        return None
    x, _ = Transformer.from_crs(crs.geodetic_crs, crs, always_xy=True).transform([10.0, 11.0], [0.0, 0.0])
    return float(360.0 * (x[1] - x[0]))


def _apply(
    transform: Affine, first: NDArray[np.float64], second: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    t = transform
    return t.a * first + t.b * second + t.c, t.d * first + t.e * second + t.f


def _is_metric(crs: CRS) -> bool:
    return bool(crs.is_projected) and all(axis.unit_name in ("metre", "meter") for axis in crs.axis_info[:2])


def _utm_of(lon_deg: float, lat_deg: float) -> CRS:
    """The UTM zone, with the exceptions around Norway and Svalbard, and Universal Polar Stereographic near the poles."""
    if lat_deg > 84.0 or lat_deg < -80.0:
        return CRS.from_epsg(5041 if lat_deg > 0.0 else 5042)
    zone = int((lon_deg + 180.0) // 6.0) % 60 + 1
    if 56.0 <= lat_deg < 64.0 and zone == 31 and lon_deg % 360.0 >= 3.0:
        zone = 32
    if lat_deg >= 72.0 and zone in (32, 34, 36):
        zone += 1 if (lon_deg - 6.0 * (zone - 31)) >= 3.0 else -1
    return CRS.from_epsg((32600 if lat_deg >= 0.0 else 32700) + zone)
