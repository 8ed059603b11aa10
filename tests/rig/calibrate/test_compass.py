"""Iron of pan stage and vehicle come out of turns of both, and headings are right afterwards on any slope."""

import numpy as np
import pytest

from rig.attitude.heading import FieldAtPan, heading_from_field
from rig.attitude.kinematics import Attitude, body_rotation, wrapped_deg
from rig.attitude.level import BaseLevel
from rig.calibrate.compass.fit import CompassFit, fit_compass
from rig.calibrate.compass.model import EarthField, VehicleStop
from rig.calibrate.compass.torque import TorqueOnOffPair, torque_field
from rig.config.calibration_files import CalibrationError

EARTH = EarthField(23.5, 42.0, 0.0)
UNDISTURBED = (0.0, EARTH.horizontal_ut, -EARTH.down_ut)
PANS_DEG = np.linspace(-170.0, 170.0, 6)


class Bent:
    """A compass on iron of degrees: what it measures at a heading, slope and pan angles."""

    def __init__(self, seed: int, field: tuple[float, float, float] = UNDISTURBED) -> None:
        rng = np.random.default_rng(seed)
        self.field = field
        self.stage, self.vehicle = (np.eye(3) + (a + a.T) / 2 for a in rng.normal(0.0, 0.025, (2, 3, 3)))
        self.stage_ut, self.vehicle_ut = rng.normal(0.0, 15.0, 3), rng.normal(0.0, 3.0, 3)
        self.rng = rng

    def measures(self, base: Attitude, pans_deg: np.ndarray) -> np.ndarray:
        there = body_rotation(base).T @ self.field
        x, y, z = self.vehicle @ there + self.vehicle_ut
        c, s = np.cos(np.radians(pans_deg)), np.sin(np.radians(pans_deg))
        stage = np.column_stack([c * x - s * y, s * x + c * y, np.full(len(c), z)])
        return stage @ self.stage.T + self.stage_ut + self.rng.normal(0.0, 0.01, stage.shape)

    def stops(
        self, headings: int, pans_deg: np.ndarray = PANS_DEG, uneven_deg: float = 0.0
    ) -> list[VehicleStop]:
        """The vehicle turned on ground that slopes by 4 degrees, every other time with its bow raised a little."""
        found = []
        for number, heading_deg in enumerate(20.0 + np.arange(headings) * 360.0 / headings):
            pitch, roll = 4.0 * np.cos(np.radians(heading_deg)), 4.0 * np.sin(np.radians(heading_deg))
            pitch += uneven_deg * (number % 2)
            field = self.measures(Attitude(heading_deg, pitch, roll), pans_deg)
            found.append(VehicleStop(pitch, roll, pans_deg, field))
        return found


def worst_heading_deg(bent: Bent, fit: CompassFit) -> float:
    pans_deg = np.array([-135.0, -45.0, 45.0, 135.0])
    worst = 0.0
    for heading_deg in np.arange(0.0, 360.0, 40.0):
        base = Attitude(heading_deg, -4.0, 3.0)
        stage = bent.measures(base, pans_deg) - fit.iron.stage_hard_ut
        stage = np.linalg.solve(np.array(fit.iron.stage_soft), stage.T).T
        fields = [FieldAtPan(p, f, 0.01) for p, f in zip(pans_deg.tolist(), stage, strict=True)]
        level = BaseLevel(-4.0, 3.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        found = heading_from_field(fields, level, fit.iron.vehicle)
        worst = max(worst, abs(wrapped_deg(found.heading_deg - heading_deg)))
    return worst


@pytest.mark.parametrize("seed", range(4))
def test_turning_pan_and_vehicle_makes_headings_right(seed: int) -> None:
    bent = Bent(seed)
    fit = fit_compass(bent.stops(8), EARTH)
    assert worst_heading_deg(bent, fit) < 0.3
    assert fit.heading_sigma_deg < 0.2
    assert fit.rms_ut < 0.02


@pytest.mark.parametrize("seed", range(4))
def test_a_vehicle_that_was_not_turned_keeps_its_doubt(seed: int) -> None:
    bent = Bent(seed)
    fit = fit_compass(bent.stops(1), EARTH)
    assert fit.heading_sigma_deg > 2.0
    assert worst_heading_deg(bent, fit) < 4.0 * fit.heading_sigma_deg


def test_the_models_declination_counts() -> None:
    stops = Bent(1).stops(8)
    sure, unsure = (fit_compass(stops, EarthField(23.5, 42.0, d)) for d in (0.0, 0.35))
    assert unsure.heading_sigma_deg == pytest.approx(np.hypot(sure.heading_sigma_deg, 0.35))


def test_a_small_turn_of_the_pan_is_refused() -> None:
    with pytest.raises(CalibrationError, match=r"through 90 deg only"):
        fit_compass(Bent(1).stops(8, np.linspace(0.0, 90.0, 6)), EARTH)


def test_iron_that_does_not_stay_in_its_place_is_refused() -> None:
    stops = Bent(1).stops(8)
    stops[3].field_ut[2] += [4.0, -3.0, 2.0]  # somebody walks past with a spade
    with pytest.raises(CalibrationError, match="no iron of stage and vehicle explains"):
        fit_compass(stops, EARTH)


@pytest.mark.parametrize("seed", range(4))
def test_the_fields_strength_and_dip_are_measured(seed: int) -> None:
    field = fit_compass(Bent(seed).stops(8, uneven_deg=6.0), EARTH).field
    assert field.dip_is_measured
    assert abs(field.horizontal_ut - EARTH.horizontal_ut) < 3.0 * field.horizontal_sigma_ut < 4.0
    assert abs(field.dip_deg - np.degrees(np.arctan2(42.0, 23.5))) < 3.0 * field.dip_sigma_deg < 9.0


@pytest.mark.parametrize("seed", range(4))
def test_even_ground_tells_the_strength_and_not_the_dip(seed: int) -> None:
    field = fit_compass(Bent(seed).stops(8), EARTH).field
    assert not field.dip_is_measured
    assert abs(field.horizontal_ut - EARTH.horizontal_ut) < 3.0 * field.horizontal_sigma_ut < 2.3


@pytest.mark.parametrize("horizontal_ut", [19.5, 27.5])
def test_a_disturbed_field_is_refused_on_even_ground_too(horizontal_ut: float) -> None:
    with pytest.raises(CalibrationError, match="horizontal field is"):
        fit_compass(Bent(1, (0.0, horizontal_ut, -42.0)).stops(8), EARTH)


@pytest.mark.parametrize("seed", range(4))
def test_a_field_as_the_model_has_it_raises_no_doubt(seed: int) -> None:
    assert fit_compass(Bent(seed).stops(8, uneven_deg=6.0), EARTH).warnings == []


@pytest.mark.parametrize(
    ("field", "words"),
    [
        ((0.0, 30.0, -42.0), r"horizontal field is .* more than the World Magnetic Model's 23\.5 uT"),
        ((0.0, 17.0, -42.0), r"horizontal field is .* less than the World Magnetic Model's 23\.5 uT"),
        ((0.0, 23.5, -20.0), r"field dips by .* less than the World Magnetic Model's 60\.8 deg"),
        ((0.0, 23.5, -42.0 * 2), r"field dips by .* more than the World Magnetic Model's 60\.8 deg"),
    ],
)
def test_a_disturbed_field_is_refused(field: tuple[float, float, float], words: str) -> None:
    with pytest.raises(CalibrationError, match=words):
        fit_compass(Bent(1, field).stops(8, uneven_deg=6.0), EARTH)


def test_a_field_that_is_a_little_off_is_warned_of() -> None:
    (warning,) = fit_compass(Bent(3, (0.0, 25.0, -42.0)).stops(8, uneven_deg=6.0), EARTH).warnings
    assert "horizontal field is" in warning


def test_a_compass_upside_down_is_refused() -> None:
    stops = Bent(1).stops(8)
    for stop in stops:
        stop.field_ut[:, 2] *= -1.0
    with pytest.raises(CalibrationError, match="sign of z in"):
        fit_compass(stops, EARTH)


def held_and_free(pan_deg: float, gave_way_deg: float, torque_ut: list[float]) -> TorqueOnOffPair:
    bent = Bent(1)
    held, free = bent.measures(Attitude(30.0, 0.0, 0.0), np.array([pan_deg, pan_deg + gave_way_deg]))
    return TorqueOnOffPair(held + torque_ut, free, pan_deg, pan_deg + gave_way_deg)


def test_the_torque_field_is_separated_from_a_head_that_sinks() -> None:
    hard_ut = Bent(1).stage_ut
    pairs = [
        held_and_free(pan, turn, [1.2, -0.5, 0.8]) for pan, turn in ((-150.0, 3.0), (0.0, -2.0), (150.0, 0.2))
    ]
    found = torque_field(pairs, hard_ut.tolist(), EARTH.horizontal_ut, 4)
    assert found.field_ut == pytest.approx([1.2, -0.5, 0.8], abs=0.1)
    assert found.heading_deg == pytest.approx(np.degrees(np.arctan2(1.3, 23.5)), abs=0.3)
    assert found.varies_ut < 0.1


def test_torque_that_changes_from_angle_to_angle_counts_in_the_heading() -> None:
    pairs = [held_and_free(pan, 0.0, [x, 0.0, 0.0]) for pan, x in ((-150.0, 0.0), (0.0, 2.0), (150.0, 4.0))]
    found = torque_field(pairs, Bent(1).stage_ut.tolist(), EARTH.horizontal_ut, 4)
    assert found.varies_ut == pytest.approx(np.sqrt(2.0), abs=0.1)
    assert found.varying_deg == pytest.approx(np.degrees(found.varies_ut / 23.5) / 2.0)
