"""Altitude from air pressure, against a pressure that was read at a known altitude."""

import math
from dataclasses import dataclass

from rig.errors import DeviceError

LAPSE_RATE_K_M = 0.0065
SEA_LEVEL_TEMPERATURE_K = 288.15
PRESSURE_EXPONENT = 0.190263  # R L / g of the standard atmosphere
KELVIN_AT_0_C = 273.15
PLAUSIBLE_M = (-500.0, 9000.0)


@dataclass(frozen=True)
class PressureReference:
    """Pressure at a known altitude, and temperature there (None: that of the standard atmosphere)."""

    pressure_hpa: float
    altitude_m: float
    temperature_c: float | None = None

    @property
    def temperature_k(self) -> float:
        """Absolute temperature of the air at the reference."""
        if self.temperature_c is None:
            return SEA_LEVEL_TEMPERATURE_K - LAPSE_RATE_K_M * self.altitude_m
        return self.temperature_c + KELVIN_AT_0_C


def altitude_m(pressure_hpa: float, reference: PressureReference) -> float:
    """Altitude at which the air has this pressure, in the datum of the reference altitude, metres.

    Hydrostatic air that is 6.5 K colder for each kilometre up, as in the standard atmosphere (ISO 2533), from
    the reference's temperature on. With the reference at sea level and its standard temperature this is
    44330.77 (1 - (p / p0)^0.190263).
    """
    ratio = math.pow(pressure_hpa / reference.pressure_hpa, PRESSURE_EXPONENT)
    return reference.altitude_m + reference.temperature_k / LAPSE_RATE_K_M * (1.0 - ratio)


def metres_per_hpa(pressure_hpa: float, reference: PressureReference) -> float:
    """Metres of altitude for one hPa at this pressure."""
    ratio = math.pow(pressure_hpa / reference.pressure_hpa, PRESSURE_EXPONENT)
    return reference.temperature_k / LAPSE_RATE_K_M * PRESSURE_EXPONENT * ratio / pressure_hpa


def plausible_altitude_m(pressure_hpa: float, reference: PressureReference, device: str) -> float:
    """``altitude_m``; ``DeviceError`` if no ground on Earth lies there."""
    altitude = altitude_m(pressure_hpa, reference)
    if not PLAUSIBLE_M[0] <= altitude <= PLAUSIBLE_M[1]:
        raise DeviceError(
            device,
            f"{pressure_hpa:.1f} hPa would be an altitude of {altitude:.0f} m",
            "check [altimeter] reference_pressure_hpa and reference_altitude_m, then the sensor",
        )
    return altitude
