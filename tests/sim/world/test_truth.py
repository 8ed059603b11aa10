"""The truth of a simulated rig: what it is drawn from, and what its devices would measure."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.errors import SimulationError
from sim.world.scenario import Scenario
from sim.world.true_values import Air
from sim.world.truth import World

WriteDem = Callable[..., Path]


def scenario(**sections: dict[str, object]) -> Scenario:
    return Scenario.model_validate(sections)


def test_a_seed_is_a_world(santa_cruz: Path, world: World) -> None:
    assert World.create([santa_cruz], Scenario(), 1).truth_json() == world.truth_json()
    assert World.create([santa_cruz], Scenario(), 2).place != world.place


def test_a_draw_for_one_purpose_changes_nothing_else(santa_cruz: Path, world: World) -> None:
    noisy = World.create(
        [santa_cruz],
        scenario(
            compass={"hard_iron_sigma_ut": 50.0},
            vehicle={"heading_deg": 12.0},
            boresight={"roll_sigma_deg": 1.0},
        ),
        1,
    )
    assert noisy.biases.hard_iron_ut != world.biases.hard_iron_ut
    assert noisy.mechanics.base.heading_deg == 12.0
    for same in ("place", "air", "reference"):
        assert getattr(noisy, same) == getattr(world, same)
    assert noisy.mechanics.base.pitch_deg == world.mechanics.base.pitch_deg
    assert noisy.biases.boresight.heading_deg == world.biases.boresight.heading_deg
    assert noisy.biases.altimeter_bias_hpa == world.biases.altimeter_bias_hpa


@pytest.mark.parametrize("seed", [3, 4, 5])
def test_the_vehicle_stands_where_it_can_drive_and_terrain_closes_the_view(
    santa_cruz: Path, seed: int
) -> None:
    world = World.create([santa_cruz], Scenario(), seed)
    surface, place = world.surface, world.place
    assert surface.slope_deg(place.row, place.col) < 25.0
    assert place.ground_m == pytest.approx(surface.height(place.row, place.col))
    assert place.altitude_m == place.ground_m + 2.0
    azimuth_deg = np.arange(0.0, 360.0, 5.0)
    elevation_deg, distance_m = surface.horizon(world.observer, azimuth_deg)
    rows, cols = surface.lattice(world.observer, azimuth_deg, distance_m)
    inside = (np.minimum(rows, cols) > 30.0) & (np.maximum(rows, cols) < 769.0)
    assert inside.mean() >= 0.9
    for azimuth, elevation in zip(azimuth_deg[inside], elevation_deg[inside], strict=True):
        s, z = surface.profile(world.observer, azimuth)
        rim = np.degrees(np.arctan((z[-1] - place.altitude_m) / s[-1] - surface.drop_per_m2 * s[-1]))
        assert elevation > rim


def test_a_place_can_be_given(santa_cruz: Path, world: World) -> None:
    place = world.place
    given_place = {"lat_deg": place.lat_deg, "lon_deg": place.lon_deg}
    same = World.create([santa_cruz], scenario(place=given_place), 99).place
    assert (same.row, same.col, same.easting_m) == pytest.approx(
        (place.row, place.col, place.easting_m), abs=1e-3
    )
    assert same.crs == "EPSG:32610"
    with pytest.raises(SimulationError, match=r"has no height at 38\.00000, -122\.10000; choose another"):
        World.create([santa_cruz], scenario(place={"lat_deg": 38.0, "lon_deg": -122.1}), 1)


def test_a_terrain_without_such_a_place_is_refused(write_dem: WriteDem) -> None:
    slope = 3.0 * np.mgrid[:101, :101][0]  # looked along, a plane's horizon is the edge of the DEM
    for heights in (slope, np.zeros((101, 101)), np.zeros((20, 20))):
        with pytest.raises(SimulationError, match="found no drivable place") as failure:
            World.create([write_dem(1000.0 + heights)], Scenario(), 1)
        assert "\n" not in str(failure.value)


@given(pan=st.floats(-180.0, 180.0), tilt=st.floats(-40.0, 60.0))
def test_gravity_tells_the_tilt_and_roll_of_the_head(world: World, pan: float, tilt: float) -> None:
    x, y, z = world.gravity_in_head(pan, tilt)
    right, forward, up = world.mechanics.head_in_world(pan, tilt).T
    assert np.hypot(np.hypot(x, y), z) == pytest.approx(1.0)
    assert (x, y, z) == pytest.approx((right[2], forward[2], up[2]))


def test_the_field_turns_with_the_pan_stage_and_the_hard_iron_does_not(world: World) -> None:
    hard_iron = np.array(world.biases.hard_iron_ut)
    for pan in (0.0, 50.0, -120.0):
        in_world = world.mechanics.pan_stage_in_world(pan) @ (world.field_in_pan_stage(pan) - hard_iron)
        np.testing.assert_allclose(in_world, world.field.enu_ut, atol=1e-9)
    disturbance = world.field_in_pan_stage(0.0, moving=True) - world.field_in_pan_stage(0.0)
    assert np.linalg.norm(disturbance) == pytest.approx(8.0, rel=1e-3)


def test_the_field_is_the_magnetic_model_turned_by_the_local_anomaly(world: World) -> None:
    """WMM2025 for the Santa Cruz Mountains: some 12.7 deg east, inclination 61 deg, 47 uT."""
    field = np.array(world.field.enu_ut)
    assert world.field.declination_model_deg == pytest.approx(12.7, abs=0.3)
    assert world.field.declination_deg == pytest.approx(
        world.field.declination_model_deg + world.biases.declination_anomaly_deg
    )
    assert np.linalg.norm(field) == pytest.approx(47.2, abs=0.5)
    assert np.degrees(np.arctan2(-field[2], np.hypot(*field[:2]))) == pytest.approx(60.7, abs=0.7)


def test_iron_near_the_rig_adds_to_the_field(santa_cruz: Path, world: World) -> None:
    beside = World.create(
        [santa_cruz], scenario(compass={"disturbance_enu_ut": [3.0, -5.0, 2.0]}), world.seed
    )
    assert np.subtract(beside.field.enu_ut, world.field.enu_ut) == pytest.approx([3.0, -5.0, 2.0])


def test_a_talker_knows_magnetic_north_but_for_the_residual_iron(santa_cruz: Path) -> None:
    exact = {"hard_iron_calibration_sigma_ut": 0.0, "declination_anomaly_sigma_deg": 0.0}
    world = World.create([santa_cruz], scenario(compass=exact, vehicle={"max_tilt_deg": 0.0}), 1)
    for pan in (0.0, 77.0, -130.0):
        true_heading = world.mechanics.base.heading_deg + pan
        off = world.magnetic_heading_deg(pan) + world.field.declination_deg - true_heading
        assert (off + 180.0) % 360.0 - 180.0 == pytest.approx(0.0, abs=1e-9)


def test_pressure_falls_with_altitude_as_in_the_standard_atmosphere() -> None:
    air = Air(1019.1314, 15.0, 0.0065, 60.0, "clear", 0.0, 40.0)
    assert air.pressure_hpa(86.1908) == pytest.approx(1008.760063, abs=1e-3)  # the BMP3's worked example
    isothermal = Air(1013.25, 15.0, 0.0, 60.0, "clear", 0.0, 40.0)
    assert isothermal.pressure_hpa(8434.5) == pytest.approx(1013.25 / np.e, rel=1e-3)  # its scale height


def test_the_weather_drifts_and_the_reference_is_what_the_crew_read(world: World) -> None:
    drift = world.biases.weather_drift_hpa_h
    assert world.pressure_hpa(3600.0) - world.pressure_hpa(0.0) == pytest.approx(drift)
    then = world.pressure_hpa(-3600.0 * world.scenario.altimeter.reference_age_h)
    assert then == pytest.approx(world.air.pressure_hpa(world.place.altitude_m))
    reference = world.reference
    truth = world.air.pressure_hpa(reference.altitude_m)
    assert reference.pressure_hpa - truth == pytest.approx(world.biases.reference_pressure_error_hpa)


def test_the_truth_is_json_with_the_fields_of_the_contract(world: World) -> None:
    truth = json.loads(json.dumps(world.truth_json()))
    for field in ("easting_m", "northing_m", "lat_deg", "lon_deg", "altitude_m", "row", "col"):
        assert isinstance(truth[field], float)
    assert truth["crs"] == "EPSG:32610"
    assert set(truth["base_attitude"]) == {"heading_deg", "pitch_deg", "roll_deg"}


def test_a_void_is_no_place_to_stand_or_to_see(skyfix_data: Path) -> None:
    world = World.create([skyfix_data / "terrain" / "ventoux_srtm_3s_voids.tif"], Scenario(), 1)
    row, col = round(world.place.row), round(world.place.col)
    assert np.isfinite(world.surface.height_m[row - 9 : row + 10, col - 9 : col + 10]).all()
