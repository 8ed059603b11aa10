"""What is in a DEM, for ``localizer dem info``."""

import datetime
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pygeomag import GeoMag

from localizer.dem.crs import short_name
from localizer.dem.datum import unknown_datum_note
from localizer.dem.geodesy import bounds_deg, meridian_convergence_deg, rowcol_to_lonlat
from localizer.dem.heights import heights_note, heights_text
from localizer.dem.lattice import Dem

NOTED_DATUM_ACCURACY_M = 5.0
"""Datum accuracies below this are not noted: NAD83 and ETRS89 differ from WGS84 by less."""
FLAT_VOIDS_GAP_M = 100.0
"""Cells of 0 this far below all others are probably voids: a coast has all elevations in between."""


@dataclass(frozen=True)
class Bounds:
    """Outer edges of the outermost cells, WGS84."""

    south_deg: float
    west_deg: float
    north_deg: float
    east_deg: float


@dataclass(frozen=True)
class DemInfo:
    """Properties of a DEM; what `dem_info` returns.

    Attributes
    ----------
    rows, cols : int
        Of the grid.
    spacing_ns_m, spacing_ew_m : float
        Metres from row to row and from column to column, at the centre.
    crs, crs_name : str
        Horizontal CRS of the grid: its code where it has one, and its name.
    metric_crs : str
        CRS that positions are given in.
    bounds : Bounds
        South, west, north and east of the outer edges, WGS84 degrees.
    lowest_m, highest_m : float
        Elevations.
    voids_percent : float
        Share of the cells without an elevation.
    convergence_deg : tuple of float
        Smallest and largest direction of the metric CRS's grid north, clockwise from true north.
    declination_deg : float or None
        Magnetic north clockwise from true north at the centre, by the World Magnetic Model; None where that does not cover the
        date.
    declination_date : str
        ISO 8601.
    suspect_zeros : int
        Cells of 0 far below all others, which may be voids.
    datum_known : bool
        Whether there is an operation from the CRS's datum to WGS84.
    wgs84_operation : str
        Its name.
    wgs84_accuracy_m : float
        One standard deviation that it adds to WGS84 positions.
    vertical_datum : str
        Vertical datum and conversion, in words.
    """

    rows: int
    cols: int
    spacing_ns_m: float
    spacing_ew_m: float
    crs: str
    crs_name: str
    metric_crs: str
    bounds: Bounds
    lowest_m: float
    highest_m: float
    voids_percent: float
    convergence_deg: tuple[float, float]
    declination_deg: float | None
    declination_date: str
    suspect_zeros: int
    datum_known: bool
    wgs84_operation: str
    wgs84_accuracy_m: float
    vertical_datum: str


def dem_info(dem: Dem, date: datetime.date | None = None) -> DemInfo:
    """Compute the properties of a DEM.

    Parameters
    ----------
    dem : Dem
        The elevation model.
    date : datetime.date, optional
        Date of the magnetic declination; today, UTC, unless given.

    Returns
    -------
    DemInfo
        Grid, CRS, extent, elevations, voids, norths and datums.

    See Also
    --------
    dem_notes : What to take care of.

    Examples
    --------
    >>> info = localizer.dem_info(localizer.load_dem("terrain.tif"))
    >>> info.crs, info.metric_crs, info.voids_percent
    ('EPSG:4326', 'EPSG:32610', 0.0)
    """
    if date is None:
        date = datetime.datetime.now(datetime.UTC).date()
    row, col = np.linspace(-0.5, dem.rows - 0.5, 9), np.linspace(-0.5, dem.cols - 0.5, 9)
    rows, cols = np.meshgrid(row, col)
    centre_lon_deg, centre_lat_deg = (float(value) for value in rowcol_to_lonlat(dem, row[4], col[4]))
    convergence_deg = meridian_convergence_deg(dem, rows, cols)
    return DemInfo(
        rows=dem.rows,
        cols=dem.cols,
        spacing_ns_m=dem.spacing_ns_m,
        spacing_ew_m=dem.spacing_ew_m,
        crs=short_name(dem.crs),
        crs_name=dem.crs.name,
        metric_crs=short_name(dem.metric_crs),
        bounds=Bounds(*bounds_deg(dem, row, col)),
        lowest_m=float(np.nanmin(dem.z_m)),
        highest_m=float(np.nanmax(dem.z_m)),
        voids_percent=100.0 * float(np.mean(np.isnan(dem.z_m))),
        convergence_deg=(float(convergence_deg.min()), float(convergence_deg.max())),
        declination_deg=declination_deg(centre_lat_deg, centre_lon_deg, float(np.nanmean(dem.z_m)), date),
        declination_date=date.isoformat(),
        suspect_zeros=suspect_zeros(dem.z_m),
        datum_known=dem.shift.known,
        wgs84_operation=dem.shift.name,
        wgs84_accuracy_m=dem.shift.accuracy_m,
        vertical_datum=heights_text(dem.heights),
    )


def declination_deg(lat_deg: float, lon_deg: float, altitude_m: float, date: datetime.date) -> float | None:
    """Magnetic declination by the World Magnetic Model; None if the model does not cover ``date``."""
    year = date.year + (date.timetuple().tm_yday - 1) / (366 if date.year % 4 == 0 else 365)
    model = GeoMag()
    first, last = model.life_span
    if not first <= year <= last:
        return None
    return float(model.calculate(lat_deg, lon_deg, altitude_m / 1000.0, year).d)


def suspect_zeros(z_m: NDArray[np.float32]) -> int:
    """How many cells of exactly 0 lie far below all others, as undeclared voids do; 0 if that is not so.

    The Aletsch DEM has 6891 of them, the next lowest cell lies at 854 m. Around San Francisco 7.9 million zeros are
    sea, with ground at every metre above and below.
    """
    zeros = int(np.count_nonzero(z_m == 0.0))
    others = z_m[np.isfinite(z_m) & (z_m != 0.0)]
    return zeros if zeros and others.size and others.min() > FLAT_VOIDS_GAP_M else 0


def info_fields(dem: Dem, info: DemInfo) -> dict[str, Any]:
    """As one JSON object."""
    files = [asdict(file) | {"path": str(file.path)} for file in dem.files]
    return {"files": files} | asdict(info) | {"notes": dem_notes(dem)}


def info_text(dem: Dem, info: DemInfo) -> str:
    """In lines for people to read."""
    lines = []
    for file in dem.files:
        lines += [
            f"file          {file.path}",
            f"              {file.driver}, {file.shape[0]} x {file.shape[1]} {file.dtype}, "
            f"pixel is {file.pixel_is}, vertical unit {file.vertical_unit} ({_UNIT_FROM[file.vertical_unit_from]})"
            + (f", band {file.band}" if file.band != 1 else "")
            + (f", scale {file.scale:g}" if file.scale != 1.0 else ""),
        ]
    bounds = info.bounds
    declination = (
        f"no World Magnetic Model at hand for {info.declination_date}"
        if info.declination_deg is None
        else f"{info.declination_deg:+.2f}° at the centre on {info.declination_date} (magnetic from true north)"
    )
    lines += [
        f"grid          {info.rows} rows x {info.cols} columns, "
        f"{info.spacing_ns_m:.2f} m north-south x {info.spacing_ew_m:.2f} m east-west at the centre",
        f"CRS           {_named(info.crs, info.crs_name)}; positions in {_named(info.metric_crs, dem.metric_crs.name)}",
        f"datum         {_datum(info)}",
        f"heights       {info.vertical_datum}",
        f"bounds        {bounds.south_deg:.5f}° to {bounds.north_deg:.5f}° north, "
        f"{bounds.west_deg:.5f}° to {bounds.east_deg:.5f}° east (WGS84)",
        f"elevations    {info.lowest_m:.1f} to {info.highest_m:.1f} m, {info.voids_percent:.2f} % void",
        f"convergence   {info.convergence_deg[0]:+.3f}° to {info.convergence_deg[1]:+.3f}° "
        f"(grid from true north, in {dem.metric_crs.name})",
        f"declination   {declination}",
    ]
    lines += [f"note          {note}" for note in dem_notes(dem)]
    return "\n".join(lines)


def dem_notes(dem: Dem) -> list[str]:
    """Say what to take care of when a DEM is searched.

    Parameters
    ----------
    dem : Dem
        The elevation model.

    Returns
    -------
    list of str
        One line each: zeros that may be voids, an unknown datum, options that overrule the file. Empty in the ordinary case.

    Examples
    --------
    >>> localizer.dem_notes(localizer.load_dem("terrain.tif"))
    []
    """
    zeros = suspect_zeros(dem.z_m)
    overruled = [note for file in dem.files for note in file.overruled]
    notes = overruled + list(dem.joined_notes) + ([zeros_note(zeros)] if zeros else [])
    if not dem.shift.known:
        notes.append(unknown_datum_note(dem.crs, dem.shift))
    elif dem.shift.accuracy_m >= NOTED_DATUM_ACCURACY_M:
        better = f"; {dem.shift.better}" if dem.shift.better else ""
        notes.append(
            f"positions on WGS84 are good to {dem.shift.accuracy_m:g} m at best, by {dem.shift.name} from the DEM's "
            f"datum{better}"
        )
    note = heights_note(dem.heights)
    return [*notes, note] if note else notes


def zeros_note(count: int) -> str:
    """The note on suspicious zeros."""
    return f"{count} cells of 0 lie far below all others; if they are voids, say --nodata 0"


_UNIT_FROM = {
    "option": "as told",
    "band": "says the file",
    "CRS": "says its CRS",
    "assumed": "assumed, the file does not say",
}


def _datum(info: DemInfo) -> str:
    if not info.datum_known:
        return "not known; latitudes and longitudes are not on WGS84 (see the note)"
    accuracy = f", good to {info.wgs84_accuracy_m:g} m" if info.wgs84_accuracy_m else ""
    return f"to WGS84 by: {info.wgs84_operation}{accuracy}"


def _named(code: str, name: str) -> str:
    return f"{code} ({name})" if code.startswith("EPSG:") else name
