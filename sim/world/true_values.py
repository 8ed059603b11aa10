"""What is true of a simulated rig: place, constant errors, air, reference pressure, magnetic field."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from sim.world.mechanics import Attitude
from sim.world.surface import Observer

Array = NDArray[np.float64]


STANDARD_GRAVITY_M_S2 = 9.80665


DRY_AIR_GAS_CONSTANT = 287.0528  # J / (kg K)


KELVIN = 273.15


@dataclass(frozen=True)
class TruePlace:
    """Where the vehicle stands.

    Attributes
    ----------
    lat_deg, lon_deg : float
        WGS84.
    easting_m, northing_m : float
        In ``crs``: the DEM's own where that is projected, else a UTM zone.
    crs : str
        Its name, ``"EPSG:32610"``.
    row, col : float
        In the DEM file's grid, cell centres at whole numbers.
    ground_m, altitude_m : float
        Of the triangulated surface, and of the camera's optical centre, above the DEM's vertical datum.
    """

    lat_deg: float
    lon_deg: float
    easting_m: float
    northing_m: float
    crs: str
    row: float
    col: float
    ground_m: float  # of the triangulated surface
    altitude_m: float  # of the camera's optical centre


@dataclass(frozen=True)
class Biases:
    """Constant errors of this rig on this day, drawn from the scenario's sigmas."""

    boresight: Attitude
    pan_zero_deg: float  # true joint angle less what the installer's zero tick makes of it
    tilt_zero_deg: float
    inclinometer_offset_mg: tuple[
        float, float, float
    ]  # head x, y, z; zero error and temperature drift together
    inclinometer_mounting_deg: tuple[float, float, float]  # turns about head x, y, z, in this order
    inclinometer_scale: tuple[float, float, float]
    hard_iron_ut: tuple[float, float, float]  # pan stage x, y, z
    hard_iron_calibrated_ut: tuple[float, float, float]  # what the crew believes it to be
    soft_iron: tuple[tuple[float, float, float], ...]  # of the pan stage
    vehicle_hard_iron_ut: tuple[float, float, float]  # base x, y, z
    vehicle_soft_iron: tuple[tuple[float, float, float], ...]
    declination_anomaly_deg: float
    altimeter_bias_hpa: float
    weather_drift_hpa_h: float
    reference_pressure_error_hpa: float
    reference_temperature_error_c: float
    told_focal: tuple[float, float]  # factors on fx and fy
    told_centre_px: tuple[float, float]


@dataclass(frozen=True)
class Air:
    """The air when the reference was taken, hydrostatic with a constant lapse rate, and the light."""

    sea_level_pressure_hpa: float
    sea_level_temperature_c: float
    lapse_rate_k_m: float
    visibility_km: float
    sky: Literal["clear", "scattered", "broken", "overcast"]
    sun_azimuth_deg: float
    sun_elevation_deg: float

    def temperature_c(self, altitude_m: float) -> float:
        """Air temperature at an altitude."""
        return self.sea_level_temperature_c - self.lapse_rate_k_m * altitude_m

    def pressure_hpa(self, altitude_m: float) -> float:
        """Pressure at an altitude: the integral of dp/p = -g dz / (R T)."""
        sea_level_k = self.sea_level_temperature_c + KELVIN
        if self.lapse_rate_k_m == 0.0:
            exponent = -STANDARD_GRAVITY_M_S2 * altitude_m / (DRY_AIR_GAS_CONSTANT * sea_level_k)
            return float(self.sea_level_pressure_hpa * np.exp(exponent))
        ratio = (self.temperature_c(altitude_m) + KELVIN) / sea_level_k
        return float(
            self.sea_level_pressure_hpa
            * ratio ** (STANDARD_GRAVITY_M_S2 / (DRY_AIR_GAS_CONSTANT * self.lapse_rate_k_m))
        )


@dataclass(frozen=True)
class PressureReference:
    """Reference pressure as noted by the crew, with errors, for the rig's configuration."""

    pressure_hpa: float
    altitude_m: float
    temperature_c: float


@dataclass(frozen=True)
class MagneticField:
    """The Earth's field at the place."""

    declination_model_deg: float  # World Magnetic Model
    enu_ut: tuple[float, float, float]  # east, north, up, local anomaly and disturbance included

    @property
    def declination_deg(self) -> float:
        """True declination here, anomaly included."""
        east, north, _ = self.enu_ut
        return float(np.degrees(np.arctan2(east, north)))


@dataclass(frozen=True)
class Standpoint:
    """The vehicle's place, the camera's optical centre there, and the magnetic field."""

    place: TruePlace
    observer: Observer
    field: MagneticField


@dataclass
class Vehicle:
    """What changes when the vehicle drives: place, motion, and vibration (one sigma)."""

    standpoint: Standpoint
    speed_m_s: float = 0.0
    course_deg: float = 0.0
    shaken_mg: float = 0.0
