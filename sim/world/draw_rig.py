"""Draws the attitude of the base, the air and the constant errors of a rig from the sigmas of a scenario."""

import zlib
from collections.abc import Sequence
from typing import Literal

import numpy as np
from pygeomag import GeoMag

from sim.world.mechanics import Attitude
from sim.world.scenario import Scenario
from sim.world.surface import Surface
from sim.world.true_values import (
    Air,
    Array,
    Biases,
    MagneticField,
    PressureReference,
    TruePlace,
)

ZEROING_TEMPERATURE_C = 20.0  # at which the inclinometer was zeroed


SKIES: tuple[Literal["clear", "scattered", "broken", "overcast"], ...] = (
    "clear",
    "scattered",
    "broken",
    "overcast",
)


def random_generator(seed: int | Sequence[int], purpose: str) -> np.random.Generator:
    """The random generator of one purpose; streams of different purposes are independent."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(zlib.crc32(purpose.encode()),)))


def draw_base(scenario: Scenario, rng: np.random.Generator) -> Attitude:
    """Attitude of the parked vehicle: tilt in a random direction, uniform per area up to the largest."""
    heading = rng.uniform(0.0, 360.0)
    lean = scenario.vehicle.max_tilt_deg * np.sqrt(rng.uniform())
    towards = rng.uniform(0.0, 2.0 * np.pi)
    if scenario.vehicle.heading_deg is not None:
        heading = scenario.vehicle.heading_deg
    return Attitude(float(heading), float(lean * np.cos(towards)), float(lean * np.sin(towards)))


def draw_air(scenario: Scenario, rng: np.random.Generator) -> Air:
    weather = scenario.weather
    pressure, temperature = rng.normal(1015.0, 7.0), rng.normal(18.0, 6.0)
    sun_azimuth, sun_elevation = rng.uniform(0.0, 360.0), rng.uniform(8.0, 65.0)
    sky = SKIES[int(rng.integers(len(SKIES)))]
    return Air(
        sea_level_pressure_hpa=float(_given(weather.sea_level_pressure_hpa, pressure)),
        sea_level_temperature_c=float(_given(weather.sea_level_temperature_c, temperature)),
        lapse_rate_k_m=weather.lapse_rate_k_km / 1000.0,
        visibility_km=weather.visibility_km,
        sky=sky if weather.sky == "drawn" else weather.sky,
        sun_azimuth_deg=float(_given(weather.sun_azimuth_deg, sun_azimuth)),
        sun_elevation_deg=float(_given(weather.sun_elevation_deg, sun_elevation)),
    )


def _given(value: float | None, drawn: float) -> float:
    return drawn if value is None else value


def draw_biases(scenario: Scenario, temperature_c: float, seed: int) -> Biases:
    mount, tilt_meter, compass, altimeter = (
        random_generator(seed, purpose) for purpose in ("boresight", "inclinometer", "compass", "altimeter")
    )
    boresight = mount.normal(size=3) * [
        scenario.boresight.azimuth_sigma_deg,
        scenario.boresight.tilt_sigma_deg,
        scenario.boresight.roll_sigma_deg,
    ]
    zero_mg = tilt_meter.normal(size=3) * scenario.inclinometer.zero_offset_sigma_mg
    drift_mg_c = tilt_meter.normal(size=3) * scenario.inclinometer.temperature_drift_sigma_mg_c
    hard_iron = compass.normal(size=3) * scenario.compass.hard_iron_sigma_ut
    mounting_rng, iron_rng, intrinsics_rng = (
        random_generator(seed, purpose) for purpose in ("chip mounting", "soft iron", "told camera")
    )
    joints = random_generator(seed, "joint zeros").normal(size=2) * scenario.servo.zero_sigma_deg
    mounting_deg = mounting_rng.normal(size=3) * scenario.inclinometer.mounting_sigma_deg
    scale = 1.0 + mounting_rng.normal(size=3) * scenario.inclinometer.scale_sigma
    stage_soft = _bent(iron_rng, scenario.compass.soft_iron_sigma)
    vehicle_soft = _bent(iron_rng, scenario.compass.vehicle_soft_iron_sigma)
    vehicle_hard = iron_rng.normal(size=3) * scenario.compass.vehicle_hard_iron_sigma_ut
    focal = 1.0 + intrinsics_rng.normal(size=2) * scenario.camera.told_focal_sigma
    centre_px = intrinsics_rng.normal(size=2) * scenario.camera.told_centre_sigma_px
    believed = hard_iron + compass.normal(size=3) * scenario.compass.hard_iron_calibration_sigma_ut
    return Biases(
        boresight=Attitude(*(float(x) for x in boresight)),
        pan_zero_deg=float(joints[0]),
        tilt_zero_deg=float(joints[1]),
        inclinometer_mounting_deg=_triple(mounting_deg),
        inclinometer_scale=_triple(scale),
        soft_iron=stage_soft,
        vehicle_hard_iron_ut=_triple(vehicle_hard),
        vehicle_soft_iron=vehicle_soft,
        told_focal=(float(focal[0]), float(focal[1])),
        told_centre_px=(float(centre_px[0]), float(centre_px[1])),
        inclinometer_offset_mg=_triple(zero_mg + drift_mg_c * (temperature_c - ZEROING_TEMPERATURE_C)),
        hard_iron_ut=_triple(hard_iron),
        hard_iron_calibrated_ut=_triple(believed),
        declination_anomaly_deg=float(compass.normal() * scenario.compass.declination_anomaly_sigma_deg),
        altimeter_bias_hpa=float(altimeter.normal() * scenario.altimeter.bias_sigma_hpa),
        weather_drift_hpa_h=float(altimeter.normal() * scenario.altimeter.weather_drift_sigma_hpa_h),
        reference_pressure_error_hpa=float(altimeter.normal() * scenario.altimeter.reference_sigma_hpa),
        reference_temperature_error_c=float(
            altimeter.normal() * scenario.altimeter.reference_temperature_sigma_c
        ),
    )


def _bent(rng: np.random.Generator, sigma: float) -> tuple[tuple[float, float, float], ...]:
    """A symmetric matrix close to the identity: the effect of soft iron."""
    random = np.triu(rng.normal(size=(3, 3))) * sigma
    return tuple(_triple(row) for row in np.eye(3) + random + np.triu(random, 1).T)


def _triple(vector: Array) -> tuple[float, float, float]:
    x, y, z = (float(component) for component in vector)
    return x, y, z


def draw_reference(surface: Surface, air: Air, biases: Biases, rng: np.random.Generator) -> PressureReference:
    """Reference pressure, read by the crew at a known point at low altitude, where roads are."""
    known = surface.height_m[np.isfinite(surface.height_m)]
    altitude_m = float(np.round(np.quantile(known, rng.uniform(0.05, 0.5))))
    return PressureReference(
        pressure_hpa=air.pressure_hpa(altitude_m) + biases.reference_pressure_error_hpa,
        altitude_m=altitude_m,
        temperature_c=air.temperature_c(altitude_m) + biases.reference_temperature_error_c,
    )


def magnetic_field(
    place: TruePlace, decimal_year: float, anomaly_deg: float, disturbance_enu_ut: tuple[float, float, float]
) -> MagneticField:
    model = GeoMag().calculate(
        glat=place.lat_deg, glon=place.lon_deg, alt=place.altitude_m / 1000.0, time=decimal_year
    )
    declination = np.radians(model.d + anomaly_deg)
    enu_ut = np.array([model.h * np.sin(declination), model.h * np.cos(declination), -model.z]) / 1000.0
    return MagneticField(float(model.d), _triple(enu_ut + disturbance_enu_ut))
