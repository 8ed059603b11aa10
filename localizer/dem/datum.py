"""Datum transformation to WGS84: the operation of PROJ that fits a DEM, and its accuracy.

If PROJ knows no operation, it silently equates latitudes and longitudes on two datums (a "ballpark" operation), which can be
off by a hundred metres to a kilometre. Here such a datum counts as unknown. One operation is chosen for a whole DEM, so that
no boundary between two areas of use runs through it.
"""

import warnings
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pyproj import CRS, Transformer
from pyproj.enums import TransformDirection
from pyproj.exceptions import ProjError
from pyproj.transformer import AreaOfInterest, TransformerGroup

from localizer.dem.crs import WGS84, geographic_crs, transform_xy

BALLPARK = "ballpark"
EARTH_RADII_M = (6_350_000.0, 6_400_000.0)
"""Range of the semi-major axes of ellipsoids and spheres for the Earth."""
UNKNOWN_DATUM_M = 1500.0
"""Largest error of a place on an unknown datum: Pulkovo, Tokyo and Kandawala differ from WGS84 by up to 1 km."""
MODERN_RADIUS_M = 6378137.0
"""Semi-major axis of GRS 1980 and WGS84, which satellite datums use."""
UNNAMED_DATUM_ACCURACY_M = 3.0
"""Accuracy of an unnamed datum on the ellipsoid of WGS84, which only realizations of WGS84 and similar datums use."""
UNSTATED_ACCURACY_M = 5.0
"""Accuracy of a transformation that states none, as +towgs84: typical of three parameters for a country."""

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class DatumShift:
    """How the coordinates of a CRS become longitudes and latitudes on WGS84.

    ``pipeline`` is PROJ's, x and longitude first; None leaves the choice to PROJ, which may be a ballpark operation.
    """

    name: str = BALLPARK
    pipeline: str | None = None
    accuracy_m: float = 0.0
    """Standard deviation on the ground; 0 for WGS84 itself, or if not stated."""
    known: bool = True
    better: str | None = None
    """A better operation whose grid is not installed, in words."""

    def to_lonlat_deg(self, crs: CRS, x: ArrayLike, y: ArrayLike) -> tuple[Floats, Floats]:
        """WGS84 longitude and latitude, elementwise; infinite where ``crs`` is not defined."""
        return self._transformed(crs, x, y, back=False)

    def from_lonlat_deg(self, crs: CRS, lon_deg: ArrayLike, lat_deg: ArrayLike) -> tuple[Floats, Floats]:
        """The inverse."""
        return self._transformed(crs, lon_deg, lat_deg, back=True)

    def _transformed(self, crs: CRS, x: ArrayLike, y: ArrayLike, *, back: bool) -> tuple[Floats, Floats]:
        if self.pipeline is None:
            return transform_xy(*((WGS84, crs) if back else (crs, WGS84)), x, y)
        x, y = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
        direction = TransformDirection.INVERSE if back else TransformDirection.FORWARD
        to_x, to_y = pipeline(self.pipeline).transform(x, y, direction=direction)
        return np.asarray(to_x, np.float64), np.asarray(to_y, np.float64)


@lru_cache(maxsize=64)
def pipeline(definition: str) -> Transformer:
    """One of PROJ's, by its definition."""
    return Transformer.from_pipeline(definition)


def is_of_the_earth(crs: CRS) -> bool:
    """Whether the ellipsoid of the CRS has the size of the Earth, not of the Moon or of Mars."""
    ellipsoid = geographic_crs(crs).ellipsoid
    return (
        ellipsoid is None or EARTH_RADII_M[0] <= float(ellipsoid.semi_major_metre or 0.0) <= EARTH_RADII_M[1]
    )


def datum_shift(crs: CRS, x: ArrayLike, y: ArrayLike) -> DatumShift:
    """The best operation from ``crs`` to WGS84 around points in ``crs``, ballpark operations excluded."""
    if crs.equals(WGS84, ignore_axis_order=True):
        return DatumShift("none, it is WGS84 itself")
    area = _area(*transform_xy(crs, WGS84, x, y))  # near enough on any datum
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of grids that are missing, which is told below
            group = TransformerGroup(crs, WGS84, always_xy=True, area_of_interest=area, allow_ballpark=False)
            best = group.transformers[0] if group.transformers else None
            missing = [] if group.best_available else group.unavailable_operations
    except (ProjError, IndexError):
        best, missing = None, []
    # PROJ puts first what serves the area best
    absent = next(iter(missing), None)
    if best is None and not is_named(crs) and _has_wgs84_ellipsoid(crs):
        return DatumShift("its ellipsoid alone, which is WGS84's", None, UNNAMED_DATUM_ACCURACY_M)
    if best is None or _is_ballpark(best.description) or _is_ballpark(best.definition):
        needs = f"; {_missing_grid(absent.name, absent.grids)}" if absent is not None else ""
        return DatumShift(known=False, better=needs.removeprefix("; ") or None)
    better = None
    if absent is not None and _accuracy(absent.accuracy) < _accuracy(best.accuracy):
        better = _missing_grid("a better one", absent.grids)
    projection = f"Inverse of {crs.coordinate_operation.name}" if crs.coordinate_operation is not None else ""
    parts = [part for part in best.description.split(" + ") if "axis order change" not in part]
    name = " + ".join(part for part in parts if part != projection) or "none, it stands on WGS84"
    moves = "helmert" in best.definition or "grid" in best.definition or "molodensky" in best.definition
    accuracy_m = best.accuracy if best.accuracy >= 0.0 else UNSTATED_ACCURACY_M if moves else 0.0
    return DatumShift(name, best.definition, accuracy_m, True, better)


def unknown_datum_note(crs: CRS, shift: DatumShift) -> str:
    """The note for users that the datum is unknown."""
    datum = geographic_crs(crs).datum
    name = datum.name if datum is not None else crs.name
    needs = f" ({shift.better})" if shift.better else ""
    ellipsoid = geographic_crs(crs).ellipsoid
    modern = ellipsoid is not None and ellipsoid.semi_major_metre == MODERN_RADIUS_M
    off = "metres, and by hundreds of them if it is an old one" if modern else "hundreds of metres"
    return (
        f"the datum of the elevation model is not known ({name}): PROJ has no operation from {crs.name} to WGS84 here{needs}, "
        f"so latitudes and longitudes may be off by {off}; name the CRS with its datum, as --crs EPSG:26711"
    )


def is_named(crs: CRS) -> bool:
    """Whether a CRS names its datum, not only an ellipsoid."""
    datum = geographic_crs(crs).datum
    return datum is not None and not datum.name.lower().startswith(
        ("unknown", "not specified", "unspecified", "unnamed")
    )


def _has_wgs84_ellipsoid(crs: CRS) -> bool:
    own, wgs84 = geographic_crs(crs).ellipsoid, WGS84.ellipsoid
    if own is None or wgs84 is None:
        return False
    return (own.semi_major_metre, round(own.inverse_flattening, 8)) == (
        wgs84.semi_major_metre,
        round(wgs84.inverse_flattening, 8),
    )


def _area(lon_deg: Floats, lat_deg: Floats) -> AreaOfInterest | None:
    """Bounding area of the finite points; None without any."""
    there = np.isfinite(lon_deg) & np.isfinite(lat_deg)
    if not there.any():
        return None
    middle = float(lon_deg[there].ravel()[0])
    lon = middle + (lon_deg[there] - middle + 180.0) % 360.0 - 180.0
    west, east = ((float(edge) + 180.0) % 360.0 - 180.0 for edge in (lon.min(), lon.max()))
    south, north = (
        float(np.clip(edge, -90.0, 90.0)) for edge in (lat_deg[there].min(), lat_deg[there].max())
    )
    return AreaOfInterest(west, south, east, north)


def _accuracy(accuracy_m: float) -> float:
    return accuracy_m if accuracy_m >= 0.0 else np.inf


def _is_ballpark(text: str) -> bool:
    return BALLPARK in text.lower()


def _missing_grid(operation: str, grids: object) -> str:
    names = ", ".join(grid.short_name for grid in grids)  # type: ignore[attr-defined]
    return f"{operation.split(' + ')[-1]} needs the grid {names}, which is not installed"
