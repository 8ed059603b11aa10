"""Parses directions: letters of the compass rose, or degrees clockwise from true north."""

import math
from dataclasses import dataclass

ROSE = ("N", "NNE", "NE", "ENE", "E", "ESE", "SE", "SSE", "S", "SSW", "SW", "WSW", "W", "WNW", "NW", "NNW")
MIN_APART_DEG = 1.0


@dataclass(frozen=True)
class Direction:
    """The direction of a frame: a true azimuth, and the label that names the frame and its file."""

    label: str
    azimuth_deg: float


def parse_directions(names: list[str]) -> list[Direction]:
    """Directions in the given order. ``ValueError``, one sentence, for an invalid one, two alike, or none."""
    directions = [parse_direction(name) for name in names]
    if not directions:
        raise ValueError("no directions; give letters (N, NE, ...) or degrees, for example N,E,S,W")
    for i, one in enumerate(directions):
        for other in directions[:i]:
            apart = abs((one.azimuth_deg - other.azimuth_deg + 180.0) % 360.0 - 180.0)
            if apart < MIN_APART_DEG:
                raise ValueError(f"{names[i].strip()!r} is given twice (also as {other.label})")
    return directions


def parse_direction(name: str) -> Direction:
    """One direction: "NE", or "45" or "222.5" degrees true, labelled A045, A222.5; else ``ValueError``."""
    letters = name.strip().upper()
    if letters in ROSE:
        return Direction(letters, ROSE.index(letters) * 360.0 / len(ROSE))
    try:
        azimuth_deg = float(letters)
    except ValueError:
        azimuth_deg = math.nan
    if not 0.0 <= azimuth_deg < 360.0:
        raise ValueError(
            f"{name.strip()!r} is no direction; give letters (N, NE, ...) or degrees from 0 to below 360"
        )
    return Direction("A" + f"{azimuth_deg:05.1f}".removesuffix(".0"), azimuth_deg)
