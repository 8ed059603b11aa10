"""The units that elevations come in."""

VERTICAL_UNITS = {
    "m": 1.0,
    "dm": 0.1,
    "cm": 0.01,
    "mm": 0.001,
    "km": 1000.0,
    "ft": 0.3048,
    "us-ft": 1200.0 / 3937.0,
}
"""Metres in one unit, by the names that ``--vertical-unit`` takes."""

_NAMES = {
    "m": ("m", "metre", "metres", "meter", "meters", "mtr", "m.a.s.l.", "masl", "metro", "metros"),
    "dm": ("dm", "decimetre", "decimetres", "decimeter", "decimeters"),
    "cm": ("cm", "centimetre", "centimetres", "centimeter", "centimeters"),
    "mm": ("mm", "millimetre", "millimetres", "millimeter", "millimeters"),
    "km": ("km", "kilometre", "kilometres", "kilometer", "kilometers"),
    "ft": ("ft", "foot", "feet", "international foot", "foot (international)"),
    "us-ft": ("us-ft", "ftus", "us survey foot", "us survey feet", "foot_us", "foot us", "sfoot"),
}


UNSTATED = ("", "unspecified", "unknown", "undefined", "none", "n/a", "unitless", "1")
"""Unit names in files that stand for no unit."""


def unit_named(name: str) -> str | None:
    """Which of ``VERTICAL_UNITS`` a file means by a name; None where that is another."""
    return next((unit for unit, names in _NAMES.items() if name.strip().lower() in names), None)
