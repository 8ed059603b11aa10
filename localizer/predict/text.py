"""Predicted skylines as text and as JSON."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from localizer.predict.views import Standpoint, View, warnings

SCHEMA = "skyfix.predict/1"
POINTS_PER_DEG = 4
"""Of the skyline in the JSON."""

_NAMES = {0.0: "N", 90.0: "E", 180.0: "S", 270.0: "W"}


def name_of(azimuth_deg: float) -> str:
    """``N`` for the four main directions, else ``123.4°``."""
    return _NAMES.get(azimuth_deg % 360.0, f"{azimuth_deg % 360.0:.1f}°")


def text(place: Standpoint, views: Sequence[View], notes: Sequence[Sequence[str]]) -> str:
    """For people. ``notes``: further warnings for each view."""
    lines = [
        f"place    {place.lat_deg:.5f}°, {place.lon_deg:.5f}° (WGS84), ground {place.ground_m:.1f} m, "
        f"camera {place.altitude_m:.1f} m"
    ]
    for seen, more in zip(views, notes, strict=True):
        lines += ["", _summary(seen)]
        if seen.summits:
            lines.append("   azimuth  elevation   distance   latitude   longitude    height")
        lines += [
            f"  {s.azimuth_deg:7.2f}°  {s.elevation_deg:+8.2f}°  {s.distance_m / 1000.0:6.2f} km  "
            f"{s.lat_deg:9.5f}  {s.lon_deg:10.5f}  {s.height_m:6.0f} m"
            for s in seen.summits
        ]
        lines += [f"  warning: {warning}" for warning in [*warnings(seen), *more]]
    return "\n".join(lines)


def _summary(seen: View) -> str:
    met = np.isfinite(seen.distance_m)
    head = f"{name_of(seen.azimuth_deg)}: azimuth {seen.azimuth_deg % 360.0:.1f}°, {seen.width_deg:.1f}° wide"
    if not met.any():
        return f"{head}; no terrain at all in this direction"
    elevation_deg, distance_m = seen.elevation_deg[met], seen.distance_m[met]
    return (
        f"{head}; skyline {elevation_deg.min():+.2f}° to {elevation_deg.max():+.2f}°, "
        f"{distance_m.min() / 1000.0:.2f} to {distance_m.max() / 1000.0:.2f} km away"
    )


def fields(place: Standpoint, views: Sequence[View], notes: Sequence[Sequence[str]]) -> dict[str, Any]:
    """As one JSON object."""
    return {
        "schema": SCHEMA,
        "place": {
            "lat_deg": place.lat_deg,
            "lon_deg": place.lon_deg,
            "row": place.row,
            "col": place.col,
            "ground_m": place.ground_m,
            "altitude_m": place.altitude_m,
        },
        "views": [
            {
                "azimuth_deg": seen.azimuth_deg % 360.0,
                "width_deg": seen.width_deg,
                "summits": [
                    {key: round(value, 7) for key, value in vars(summit).items()} for summit in seen.summits
                ],
                "skyline": _skyline(seen),
                "warnings": [*warnings(seen), *more],
            }
            for seen, more in zip(views, notes, strict=True)
        ],
    }


def _skyline(seen: View) -> list[dict[str, Any]]:
    count = max(2, round(seen.width_deg * POINTS_PER_DEG) + 1)
    chosen = np.unique(np.round(np.linspace(0, len(seen.offset_deg) - 1, count)).astype(int))
    return [
        {
            "azimuth_deg": round(float(seen.azimuths_deg[i]), 4),
            "elevation_deg": None if np.isnan(seen.distance_m[i]) else round(float(seen.elevation_deg[i]), 4),
            "distance_m": None if np.isnan(seen.distance_m[i]) else round(float(seen.distance_m[i]), 1),
            "reliable": not bool(seen.at_edge[i] or seen.too_near[i]),
        }
        for i in chosen
    ]
