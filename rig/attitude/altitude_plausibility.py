"""Plausibility of an altitude: against [place], the elevation model, and the reference of the barometer.

A wrong but compatible chip, a pressure in another unit or a wrong reference gives a value that looks normal.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rig.config.model import RigConfig
from rig.config.sections import AltimeterSection
from rig.errors import DeviceError

if TYPE_CHECKING:
    from localizer.dem.lattice import Dem

MAX_FROM_PLACE_M = 3500.0
"""Allowed distance from [place] altitude_m, which is valid within some hundred kilometres. A pressure wrong by a factor
of two is 4,900 m or more.
"""

MAX_BEYOND_DEM_M = 300.0
"""Weather since the reference (150 m) and a different vertical datum (110 m) are less."""

LOOKALIKE_CHIPS = {"ms5611": "ms5607", "ms5607": "ms5611"}
"""Barometers with the same commands and a different conversion to pressure."""


@dataclass(frozen=True)
class AltitudeBounds:
    """Lowest and highest plausible altitude, and the source of these bounds."""

    low_m: float
    high_m: float
    by: str


def altitude_bounds(config: RigConfig, dem: "Dem | None" = None) -> tuple[AltitudeBounds, ...]:
    """Bounds from the elevation model, from [place] if it has an altitude, and, if not, from the barometer's reference
    for one of ``LOOKALIKE_CHIPS``.
    """
    bounds = []
    if dem is not None:
        low_m, high_m = float(np.nanmin(dem.z_m)), float(np.nanmax(dem.z_m))
        name = dem.source[0].name if dem.source else "the elevation model"
        bounds.append(
            AltitudeBounds(
                low_m - MAX_BEYOND_DEM_M,
                high_m + MAX_BEYOND_DEM_M,
                f"the ground of {name} lies at {low_m:.0f} to {high_m:.0f} m",
            )
        )
    if config.place is not None and "altitude_m" in config.place.model_fields_set:
        at_m = config.place.altitude_m
        bounds.append(_around(at_m, f"[place] altitude_m says {at_m:.0f} m"))
    elif config.altimeter is not None and dem is None:
        bounds += bounds_by_reference(config.altimeter)
    return tuple(bounds)


def bounds_by_reference(section: AltimeterSection) -> list[AltitudeBounds]:
    """Bounds from the reference, for one of ``LOOKALIKE_CHIPS``, if nothing else tells the altitude."""
    if section.kind not in LOOKALIKE_CHIPS:
        return []
    at_m = section.reference_altitude_m
    by = f"the reference lies at {at_m:.0f} m and there is no [place] altitude_m that says more"
    return [_around(at_m, by)]


def _around(altitude_m: float, by: str) -> AltitudeBounds:
    return AltitudeBounds(altitude_m - MAX_FROM_PLACE_M, altitude_m + MAX_FROM_PLACE_M, by)


def require_plausible_altitude(
    altitude_m: float,
    pressure_hpa: float,
    section: AltimeterSection,
    device: str,
    bounds: Iterable[AltitudeBounds],
) -> None:
    """Raise ``DeviceError`` if an altitude lies outside one of the bounds."""
    for bound in bounds:
        if bound.low_m <= altitude_m <= bound.high_m:
            continue
        problem = f"{pressure_hpa:.1f} hPa would be an altitude of {altitude_m:.0f} m, but {bound.by}"
        remedy = "check [altimeter] reference_pressure_hpa and reference_altitude_m, [place] altitude_m, then the sensor"
        if section.kind in LOOKALIKE_CHIPS:
            other = LOOKALIKE_CHIPS[section.kind]
            part = "half" if section.kind == "ms5611" else "twice"
            remedy = (
                f"an {other.upper()} read as an {section.kind.upper()} gives {part} the pressure: look at what is fitted "
                f'([altimeter] kind = "{other}"), then {remedy}'
            )
        raise DeviceError(device, problem, remedy)
