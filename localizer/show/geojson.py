"""The candidates as GeoJSON (RFC 7946): a point and the ellipse that holds 95 % for each."""

import json
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from localizer.bundle import Bundle
from localizer.dem.crs import wrapped_lon_deg
from localizer.dem.lattice import Dem
from localizer.fix import Fix
from localizer.show.candidates import CandidatePlace, ellipse_ring_lonlat

DECIMALS = 7
"""A centimetre."""

Ring = list[tuple[float, float]]


def candidates_geojson(places: Sequence[CandidatePlace], fix: Fix, bundle: Bundle, dem: Dem) -> str:
    """Points first, so that a program that takes the first feature takes the likeliest place."""
    features = [
        _feature(place, fix, bundle, "place", {"type": "Point", "coordinates": _rounded(place)})
        for place in places
    ]
    features += [_feature(place, fix, bundle, "ellipse_95", _ellipse(place, dem)) for place in places]
    collection = {"type": "FeatureCollection", "features": features}
    return json.dumps(collection, indent=1, allow_nan=False) + "\n"


def _feature(
    place: CandidatePlace, fix: Fix, bundle: Bundle, kind: str, geometry: dict[str, Any]
) -> dict[str, Any]:
    return {
        "type": "Feature",
        "geometry": geometry,
        "properties": {
            "kind": kind,
            "rank": place.rank,
            "probability": place.probability,
            "rms_px": place.rms_px,
            "status": fix.status,
            "sigma_major_m": place.axes.major_m,
            "sigma_minor_m": place.axes.minor_m,
            "sigma_azimuth_deg": place.azimuth_deg,
            "bundle": bundle.id,
            "time": bundle.created.isoformat().replace("+00:00", "Z"),
        },
    }


def _rounded(place: CandidatePlace) -> list[float]:
    return [wrapped_lon_deg(round(place.lon_deg, DECIMALS)), round(place.lat_deg, DECIMALS)]


def _ellipse(place: CandidatePlace, dem: Dem) -> dict[str, Any]:
    lon_deg, lat_deg = ellipse_ring_lonlat(place, dem)
    if (around_pole := _around_pole(lon_deg, lat_deg)) is not None:
        return {"type": "Polygon", "coordinates": [around_pole]}
    # longitudes relative to the place, so that the ring is not split at the date line
    lon_deg = place.lon_deg + (lon_deg - place.lon_deg + 180.0) % 360.0 - 180.0
    ring = list(zip(lon_deg.tolist(), lat_deg.tolist(), strict=True))
    limit = float(np.copysign(180.0, place.lon_deg))
    around = [(lon - 2.0 * limit, lat) for lon, lat in _clipped(ring, limit, beyond=True)]
    # a part may have no area after rounding
    parts = [part for part in map(_closed, (_clipped(ring, limit, beyond=False), around)) if _has_area(part)]
    if len(parts) < 2:
        return {"type": "Polygon", "coordinates": parts or [_closed(ring)]}
    return {"type": "MultiPolygon", "coordinates": [[part] for part in parts]}


def _around_pole(lon_deg: NDArray[np.float64], lat_deg: NDArray[np.float64]) -> list[list[float]] | None:
    """A ring that holds a pole as that which it is on a map of longitudes: all of it up, or down, to 90 degrees; else None."""
    steps = (np.diff(lon_deg, append=lon_deg[:1]) + 180.0) % 360.0 - 180.0
    if abs(steps.sum()) < 180.0:
        return None
    order = np.argsort(lon_deg)
    lon, lat = lon_deg[order], lat_deg[order]
    edge = float(np.interp(180.0, [lon[-1], lon[0] + 360.0], [lat[-1], lat[0]]))
    line = [(-180.0, edge), *zip(lon.tolist(), lat.tolist(), strict=True), (180.0, edge)]
    pole = float(np.copysign(90.0, lat[0]))
    ring = [*line, (180.0, pole), (-180.0, pole)]
    return _closed(ring if pole > 0.0 else ring[::-1])  # counter-clockwise


def _has_area(ring: list[list[float]]) -> bool:
    return len({lon for lon, _ in ring}) > 1 and len({lat for _, lat in ring}) > 1


def _clipped(ring: Ring, limit: float, *, beyond: bool) -> Ring:
    """The part of a convex ring on one side of the meridian ``limit`` (180 or -180), in the same order."""
    side = 1.0 if (limit > 0.0) == beyond else -1.0
    out: Ring = []
    for (lon, lat), (next_lon, next_lat) in zip(ring, ring[1:] + ring[:1], strict=True):
        here, there = side * (lon - limit), side * (next_lon - limit)
        if here >= 0.0:
            out.append((lon, lat))
        if here * there < 0.0:
            out.append((limit, lat + (next_lat - lat) * here / (here - there)))
    return out


def _closed(ring: Ring) -> list[list[float]]:
    return [[round(lon, DECIMALS), round(lat, DECIMALS)] for lon, lat in [*ring, *ring[:1]]]
