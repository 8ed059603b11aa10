"""Keep-out zones (rectangles in pan and tilt), and routes around them.

The two servos are not synchronised, so a move may pass through any pair of angles between its ends. It is clear of a
zone only if the whole rectangle between its ends is.
"""

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Protocol

from rig.errors import GoalError

MARGIN_DEG = 1.0  # droop, backlash and overshoot

Angles = tuple[float, float]
"""Pan and tilt, degrees."""


class Zone(Protocol):
    """[[pan_tilt.keep_out]] of the configuration."""

    @property
    def pan_min_deg(self) -> float: ...
    @property
    def pan_max_deg(self) -> float: ...
    @property
    def tilt_min_deg(self) -> float: ...
    @property
    def tilt_max_deg(self) -> float: ...


def zone_at(angles: Angles, zones: Sequence[Zone]) -> Zone | None:
    """The zone, with its margin, that contains these angles; None if there is none."""
    return _zone_between(angles, angles, zones)


def lies_in_a_zone(angles: Angles, zones: Sequence[Zone]) -> bool:
    """Whether these angles lie in a zone, not counting its margin."""
    return any(
        zone.pan_min_deg < angles[0] < zone.pan_max_deg and zone.tilt_min_deg < angles[1] < zone.tilt_max_deg
        for zone in zones
    )


def described(zone: Zone) -> str:
    """The zone in words for messages."""
    return f"pan {zone.pan_min_deg:g} to {zone.pan_max_deg:g}, tilt {zone.tilt_min_deg:g} to {zone.tilt_max_deg:g} deg"


def require_allowed(angles: Angles, zones: Sequence[Zone]) -> None:
    """Raise ``GoalError`` if the angles lie in a zone or its margin."""
    zone = zone_at(angles, zones)
    if zone:
        raise GoalError(
            f"pan {angles[0]:.1f}, tilt {angles[1]:.1f} deg lies in the keep-out zone {described(zone)}; "
            "ask for another direction, or change [[pan_tilt.keep_out]]"
        )


def route(start: Angles, goal: Angles, zones: Sequence[Zone], low: Angles, high: Angles) -> list[Angles]:
    """Waypoints from ``start`` to ``goal`` (the last one), within the limits ``low`` to ``high``.

    ``GoalError`` if the goal or the present position lies in a zone, or if no route is found.
    """
    if not zones:
        return [goal]
    require_allowed(goal, zones)
    inside = zone_at(start, zones)
    if inside:
        raise GoalError(
            f"the head stands at pan {start[0]:.1f}, tilt {start[1]:.1f} deg, in the keep-out zone {described(inside)}; "
            "move it out by hand with the servo power off"
        )
    clear = [way for way in _ways(start, goal, zones, low, high) if _is_clear([start, *way], zones)]
    if not clear:
        raise GoalError(
            f"no way from pan {start[0]:.1f}, tilt {start[1]:.1f} to pan {goal[0]:.1f}, tilt {goal[1]:.1f} deg "
            "leads round the keep-out zones; move the head by hand, or change [[pan_tilt.keep_out]]"
        )
    return min(clear, key=lambda way: (len(way), _length_deg([start, *way])))


def _ways(
    start: Angles, goal: Angles, zones: Sequence[Zone], low: Angles, high: Angles
) -> Iterator[list[Angles]]:
    """Candidate routes: direct, via another tilt, or via another pan."""
    yield [goal]
    clearance_deg = 2 * MARGIN_DEG
    tilts = {start[1], goal[1], low[1], high[1]}
    tilts |= {z.tilt_min_deg - clearance_deg for z in zones} | {z.tilt_max_deg + clearance_deg for z in zones}
    for tilt_deg in tilts:
        if low[1] <= tilt_deg <= high[1]:
            yield _without_repeats(start, [(start[0], tilt_deg), (goal[0], tilt_deg), goal])
    pans = {start[0], goal[0], low[0], high[0]}
    pans |= {z.pan_min_deg - clearance_deg for z in zones} | {z.pan_max_deg + clearance_deg for z in zones}
    for pan_deg in pans:
        if low[0] <= pan_deg <= high[0]:
            yield _without_repeats(start, [(pan_deg, start[1]), (pan_deg, goal[1]), goal])


def _without_repeats(start: Angles, way: list[Angles]) -> list[Angles]:
    return [there for here, there in pairwise([start, *way]) if here != there] or [way[-1]]


def _is_clear(way: list[Angles], zones: Sequence[Zone]) -> bool:
    return not any(_zone_between(here, there, zones) for here, there in pairwise(way))


def _zone_between(a: Angles, b: Angles, zones: Sequence[Zone]) -> Zone | None:
    for zone in zones:
        pan_apart = (
            max(a[0], b[0]) <= zone.pan_min_deg - MARGIN_DEG
            or min(a[0], b[0]) >= zone.pan_max_deg + MARGIN_DEG
        )
        tilt_apart = (
            max(a[1], b[1]) <= zone.tilt_min_deg - MARGIN_DEG
            or min(a[1], b[1]) >= zone.tilt_max_deg + MARGIN_DEG
        )
        if not (pan_apart or tilt_apart):
            return zone
    return None


def _length_deg(way: list[Angles]) -> float:
    return sum(max(abs(a[0] - b[0]), abs(a[1] - b[1])) for a, b in pairwise(way))
