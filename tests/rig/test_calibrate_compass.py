"""Iron of pan stage and vehicle come out of turns of both, and headings are right afterwards on any slope."""

import numpy as np
import pytest

from rig.attitude import BaseLevel
from rig.calibrate.compass_fit import CompassFit, EarthField, VehicleStop, fit_compass
from rig.calibration import CalibrationError
from rig.heading import FieldAtPan, heading_from_field
from rig.kinematics import Attitude, body_rotation, wrapped_deg

EARTH = EarthField(23.5, 42.0, 0.0)
PANS_DEG = np.linspace(-170.0, 170.0, 6)


class Bent:
    """A compass on iron of degrees: what it measures at a heading, slope and pan angles."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.stage, self.vehicle = (np.eye(3) + (a + a.T) / 2 for a in rng.normal(0.0, 0.025, (2, 3, 3)))
        self.stage_ut, self.vehicle_ut = rng.normal(0.0, 15.0, 3), rng.normal(0.0, 3.0, 3)
        self.rng = rng

    def measures(self, base: Attitude, pans_deg: np.ndarray) -> np.ndarray:
        there = body_rotation(base).T @ [0.0, EARTH.horizontal_ut, -EARTH.down_ut]
        x, y, z = self.vehicle @ there + self.vehicle_ut
        c, s = np.cos(np.radians(pans_deg)), np.sin(np.radians(pans_deg))
        stage = np.column_stack([c * x - s * y, s * x + c * y, np.full(len(c), z)])
        return stage @ self.stage.T + self.stage_ut + self.rng.normal(0.0, 0.01, stage.shape)

    def stops(self, headings: int, pans_deg: np.ndarray = PANS_DEG) -> list[VehicleStop]:
        """The vehicle turned on ground that slopes by 4 degrees."""
        found = []
        for heading_deg in 20.0 + np.arange(headings) * 360.0 / headings:
            pitch, roll = 4.0 * np.cos(np.radians(heading_deg)), 4.0 * np.sin(np.radians(heading_deg))
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


def test_a_field_that_is_not_the_models_is_refused() -> None:
    with pytest.raises(CalibrationError, match="World Magnetic Model"):
        fit_compass(Bent(1).stops(8), EarthField(46.0, 42.0, 0.0))
