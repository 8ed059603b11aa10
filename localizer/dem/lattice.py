"""The digital elevation model that is searched: one lattice of elevations, read from one or more files.

A geographic DEM keeps its own lattice. Only files on another lattice than the finest one are resampled. Rows and columns refer
to cell centres: the value at (row, col) lies at ``transform @ (col + 0.5, row + 0.5)``, whether pixels are areas or points.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from os import PathLike
from pathlib import Path

import numpy as np
from affine import Affine
from numpy.typing import ArrayLike, NDArray
from pyproj import CRS
from pyproj.exceptions import CRSError

from localizer.dem.crs import degrees_per_unit, geographic_crs, is_metric, lattice_xy, own_lonlat_deg, utm_crs
from localizer.dem.datum import DatumShift, datum_shift
from localizer.dem.file import DemError, DemFile, read_tile
from localizer.dem.heights import GEOID_RANGE_M, NODES, Heights, to_sea_level
from localizer.dem.join import joined

__all__ = ["Dem", "DemError", "dem_from_array", "load_dem"]

MIN_SIDE = 3
SPACING_RANGE_M = (0.05, 10_000.0)
EDGE_TOLERANCE_CELLS = 1e-6


@dataclass(frozen=True, eq=False)
class Dem:
    """Elevations on a regular grid. Make one with `load_dem` or `dem_from_array`.

    Attributes
    ----------
    z_m : ndarray of float32, shape (rows, cols)
        Elevations at the cells' centres, row 0 northernmost, voids NaN. It cannot be written once the DEM was searched or a
        horizon was computed.
    crs : pyproj.CRS
        Horizontal CRS of the grid.
    transform : affine.Affine
        From (col, row) of a cell's corner to x, y in ``crs`` (apply with @); centres at + 0.5.
    metric_crs : pyproj.CRS
        ``crs`` itself if it is projected in metres, else the WGS84 UTM zone of the centre. Positions are given in it.
    spacing_ns_m, spacing_ew_m : float
        Metres from row to row and from column to column, at the centre.
    files : tuple
        What the files say about themselves; empty if the DEM does not come from files.
    error_m : float or None
        One standard deviation of the elevations, where somebody says it. 0: an exact DEM, as in a simulation.
    shift : DatumShift
        From ``crs`` to WGS84.
    heights : Heights
        What the elevations count from.
    joined_notes : tuple of str
        What was done to files that lie on different grids, in words.
    """

    z_m: NDArray[np.float32]
    crs: CRS
    transform: Affine
    metric_crs: CRS
    spacing_ns_m: float
    spacing_ew_m: float
    files: tuple[DemFile, ...] = ()
    error_m: float | None = None
    shift: DatumShift = field(default_factory=DatumShift)
    heights: Heights = field(default_factory=Heights)
    joined_notes: tuple[str, ...] = ()

    def to_lonlat_deg(self, x: ArrayLike, y: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """WGS84 longitude and latitude of coordinates in ``crs``."""
        return self.shift.to_lonlat_deg(self.crs, x, y)

    def from_lonlat_deg(
        self, lon_deg: ArrayLike, lat_deg: ArrayLike
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Coordinates in ``crs`` of WGS84 longitudes and latitudes."""
        return self.shift.from_lonlat_deg(self.crs, lon_deg, lat_deg)

    @property
    def metric_accuracy_m(self) -> float:
        """Accuracy of eastings and northings in ``metric_crs`` by the datum transformation; 0 without one."""
        return 0.0 if self.metric_crs == self.crs else self.shift.accuracy_m

    @property
    def lonlat_accuracy_m(self) -> float:
        """Additional uncertainty of WGS84 longitudes and latitudes over eastings and northings in ``metric_crs``."""
        return self.shift.accuracy_m if self.metric_crs == self.crs else 0.0

    @property
    def rows(self) -> int:
        return int(self.z_m.shape[0])

    @property
    def cols(self) -> int:
        return int(self.z_m.shape[1])

    @property
    def source(self) -> tuple[Path, ...]:
        """The files that the DEM was read from."""
        return tuple(file.path for file in self.files)

    def covers(self, row: float, col: float) -> bool:
        """Whether a lattice position lies in a cell of the DEM, void or not."""
        return -0.5 <= row <= self.rows - 0.5 and -0.5 <= col <= self.cols - 0.5

    def ground_m(self, row: ArrayLike, col: ArrayLike) -> NDArray[np.float64]:
        """Bilinear elevation, elementwise; NaN outside the lattice and where a cell that counts is void."""
        row, col = np.broadcast_arrays(np.asarray(row, np.float64), np.asarray(col, np.float64))
        inside = (
            (row >= -EDGE_TOLERANCE_CELLS)
            & (row <= self.rows - 1 + EDGE_TOLERANCE_CELLS)
            & (col >= -EDGE_TOLERANCE_CELLS)
            & (col <= self.cols - 1 + EDGE_TOLERANCE_CELLS)
        )
        r = np.where(inside, row, 0.0).clip(0.0, self.rows - 1)
        c = np.where(inside, col, 0.0).clip(0.0, self.cols - 1)
        r0 = np.minimum(r.astype(np.int64), self.rows - 2)
        c0 = np.minimum(c.astype(np.int64), self.cols - 2)
        fr, fc = r - r0, c - c0
        ground_m = np.zeros(r.shape)
        for dr, wr in ((0, 1.0 - fr), (1, fr)):
            for dc, wc in ((0, 1.0 - fc), (1, fc)):
                weight = wr * wc
                # on a grid line, the cells beside it have weight 0, also if they are void
                ground_m += np.where(weight > 0.0, weight * self.z_m[r0 + dr, c0 + dc], 0.0)
        return np.where(inside, ground_m, np.nan)


def load_dem(
    paths: str | PathLike[str] | Sequence[str | PathLike[str]],
    *,
    vertical_unit: str | None = None,
    crs: str | None = None,
    nodata: float | None = None,
    error_m: float | None = None,
    band: int | None = None,
    scale: float | None = None,
    geoid_offset_m: float | None = None,
) -> Dem:
    """Read a digital elevation model.

    Parameters
    ----------
    paths : path-like or sequence of path-like
        A raster that GDAL reads, or several that adjoin or overlap: where they overlap, the first counts. Files on another
        grid than the finest one are brought onto that. Names that only GDAL understands will do, as
        ``"/vsizip/tiles.zip/a.tif"``.
    vertical_unit : {"m", "dm", "cm", "mm", "km", "ft", "us-ft"}, optional
        Unit of the elevations. This and the next four are taken from the files unless given.
    crs : str, optional
        Horizontal CRS, as pyproj understands it, as ``"EPSG:4326"``.
    nodata : float, optional
        A further stored value that means void.
    error_m : float, optional
        One standard deviation of the elevations, where it is known; the search sets out from it. 0: an exact DEM, as in a
        simulation.
    band : int, optional
        The band with the elevations, from 1.
    scale : float, optional
        Factor of the stored numbers.
    geoid_offset_m : float, optional
        Height of the geoid above the ellipsoid, for elevations that count from the ellipsoid; it is taken off.

    Returns
    -------
    Dem
        The elevations on their own grid, a geographic one included.

    Raises
    ------
    DemError
        A file cannot be read, or is no elevation model that can be searched.

    Examples
    --------
    >>> dem = localizer.load_dem("terrain.tif")
    >>> dem.z_m.shape, dem.crs.name
    ((800, 800), 'WGS 84')
    """
    if isinstance(paths, str | PathLike):
        paths = [paths]
    if not paths:
        raise DemError("no elevation file was named")
    if scale is not None and not (np.isfinite(scale) and scale != 0.0):
        raise DemError(
            f"--scale: {scale:g} makes no elevations; name the factor of the stored numbers, as 0.1"
        )
    if geoid_offset_m is not None and not GEOID_RANGE_M[0] < geoid_offset_m < GEOID_RANGE_M[1]:
        raise DemError(
            f"--geoid-offset: {geoid_offset_m:g} m; the geoid lies between -107 and +86 m above the ellipsoid anywhere"
        )
    tiles = [read_tile(Path(path), vertical_unit, crs, nodata, band, scale) for path in paths]
    merged = joined(tiles)
    dem = dem_from_array(
        merged.z_m, merged.transform, merged.crs, tuple(tile.file for tile in tiles), error_m
    )
    row, col = np.meshgrid(
        np.linspace(0, dem.rows - 1, NODES), np.linspace(0, dem.cols - 1, NODES), indexing="ij"
    )
    lon_deg, lat_deg = dem.to_lonlat_deg(*lattice_xy(dem.transform, row, col))
    z_m, heights = to_sea_level(dem.z_m, lon_deg, lat_deg, tiles[0].heights, geoid_offset_m)
    return replace(dem, z_m=z_m, heights=heights, joined_notes=merged.notes)


def dem_from_array(
    z_m: NDArray[np.floating],
    transform: Affine,
    crs: CRS | str,
    files: tuple[DemFile, ...] = (),
    error_m: float | None = None,
) -> Dem:
    """Make a digital elevation model of an array.

    Parameters
    ----------
    z_m : ndarray of float, shape (rows, cols)
        Elevations in metres at the cells' centres, row 0 northernmost, voids NaN.
    transform : affine.Affine
        From (col, row) of a cell's corner to x, y in ``crs``, as rasterio has it; without rotation, north up.
    crs : pyproj.CRS or str
        Horizontal CRS of the grid.
    files : tuple, optional
        What the files say about themselves that the array was read from.
    error_m : float, optional
        One standard deviation of the elevations, where it is known. 0: an exact DEM, as in a simulation.

    Returns
    -------
    Dem
        The elevations on this grid.

    Raises
    ------
    DemError
        The grid is tiny, or does not lie where the CRS is defined.

    Examples
    --------
    >>> import numpy as np
    >>> from affine import Affine
    >>> z_m = 500.0 + np.add.outer(np.arange(50.0), np.arange(60.0))
    >>> dem = localizer.dem_from_array(z_m, Affine(30.0, 0.0, 560000.0, 0.0, -30.0, 5120000.0), "EPSG:32610")
    >>> dem.z_m.shape, round(dem.spacing_ew_m)
    ((50, 60), 30)
    """
    if isinstance(crs, str):
        try:
            crs = CRS.from_user_input(crs)
        except CRSError:
            raise DemError(
                f"crs: {crs} is not a coordinate reference system; name one as EPSG:32610"
            ) from None
    rows, cols = z_m.shape
    where = ", ".join(str(file.path) for file in files) or "DEM"
    if min(rows, cols) < MIN_SIDE:
        raise DemError(f"{where}: {rows} x {cols} cells are too few to search")
    if crs.is_geographic:
        degrees = degrees_per_unit(crs)
        south, north = (transform.f + transform.e * rows) * degrees, transform.f * degrees
        if not -90.1 <= south < north <= 90.1:
            raise DemError(f"{where}: its coordinates are no degrees, but its CRS is {crs.name}; see --crs")
    # the centre, and half a cell to the west, east, north and south of it
    row, col = (rows - 1) / 2, (cols - 1) / 2
    x, y = lattice_xy(transform, row + np.array([0, 0, 0, -0.5, 0.5]), col + np.array([0, -0.5, 0.5, 0, 0]))
    lon_deg, lat_deg = own_lonlat_deg(crs, x, y)
    if not (np.isfinite(lon_deg).all() and np.isfinite(lat_deg).all()):
        raise DemError(f"{where}: lies where {crs.name} is not defined; see --crs")
    geod = geographic_crs(crs).get_geod()
    assert geod is not None
    _, _, lengths_m = geod.inv(lon_deg[[1, 3]], lat_deg[[1, 3]], lon_deg[[2, 4]], lat_deg[[2, 4]])
    spacing_ew_m, spacing_ns_m = (float(length) for length in np.asarray(lengths_m))
    shortest_m, longest_m = sorted((spacing_ew_m, spacing_ns_m))
    if not SPACING_RANGE_M[0] <= shortest_m <= longest_m <= SPACING_RANGE_M[1]:
        raise DemError(
            f"{where}: its cells measure {spacing_ew_m:g} x {spacing_ns_m:g} m, as no elevation model's do; "
            f"is its CRS really {crs.name}? See --crs"
        )
    corner_row, corner_col = np.array([0, 0, rows - 1, rows - 1]), np.array([0, cols - 1, 0, cols - 1])
    corner_x, corner_y = lattice_xy(transform, corner_row, corner_col)
    shift = datum_shift(crs, np.append(x[:1], corner_x), np.append(y[:1], corner_y))
    centre_lon_deg, centre_lat_deg = shift.to_lonlat_deg(crs, x[:1], y[:1])
    return Dem(
        z_m=np.ascontiguousarray(z_m, np.float32),
        crs=crs,
        transform=transform,
        metric_crs=crs if is_metric(crs) else utm_crs(float(centre_lon_deg[0]), float(centre_lat_deg[0])),
        spacing_ns_m=spacing_ns_m,
        spacing_ew_m=spacing_ew_m,
        files=files,
        error_m=error_m,
        shift=shift,
    )
