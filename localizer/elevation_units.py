"""The units that elevations come in."""

VERTICAL_UNITS = {"m": 1.0, "ft": 0.3048, "us-ft": 1200.0 / 3937.0}
"""Metres in one unit, by the names that ``--vertical-unit`` takes."""
