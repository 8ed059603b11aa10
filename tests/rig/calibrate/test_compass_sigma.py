"""The heading's sigma after a calibration of the compass: closed forms for one error at a time, and its growth with noise."""

import numpy as np
import pytest

from rig.attitude.heading import VehicleIron
from rig.calibrate.compass.fit import _heading_sigma_deg, _require_explained, _require_plausible, fit_compass
from rig.calibrate.compass.model import CompassModel, EarthField, Iron, VehicleStop
from rig.config.calibration_files import CalibrationError

EARTH = EarthField(23.5, 42.0, 0.0)
STAGE_X, STAGE_Z, VEHICLE_X, VEHICLE_Y, HORIZONTAL, DOWN = 6, 8, 14, 15, 16, 17


def sigma_deg(**variances: float) -> float:
    """Of headings where these unknowns are uncertain by so much (names of the positions above), and no others."""
    covariance = np.zeros((18, 18))
    for name, variance in variances.items():
        at = globals()[name.upper()]
        covariance[at, at] = variance
    return _heading_sigma_deg(np.zeros(18), covariance, EARTH)


def test_vertical_iron_of_the_stage_shows_on_slopes_only() -> None:
    """0.5 uT turn into 0.5 sin(5 deg) along the slope, and the heading by the part across: 1 / sqrt 2 of it on average.

    That on two of the three slopes, level ground and 5 degrees in pitch and in roll.
    """
    of_slope_deg = np.degrees(0.5 * np.sin(np.radians(5.0)) / 23.5) / np.sqrt(2.0)
    assert sigma_deg(stage_z=0.5**2) == pytest.approx(of_slope_deg * np.sqrt(2.0 / 3.0), rel=0.01)


def test_horizontal_iron_of_the_vehicle_shows_everywhere() -> None:
    """0.4 uT in both axes: whatever the heading, 0.4 across the field."""
    expected_deg = np.degrees(0.4 / 23.5)
    assert sigma_deg(vehicle_x=0.4**2, vehicle_y=0.4**2) == pytest.approx(expected_deg, rel=0.01)


def test_horizontal_iron_of_the_stage_goes_with_every_capture() -> None:
    assert sigma_deg(stage_x=10.0**2) == pytest.approx(0.0, abs=1e-6)


def test_how_strong_the_earths_field_is_does_not_matter_to_a_compass_without_iron() -> None:
    assert sigma_deg(horizontal=1.0, down=1.0) == pytest.approx(0.0, abs=1e-6)


def turned(noise_ut: float) -> list[VehicleStop]:
    """A vehicle without iron turned to eight headings, its bow raised every other time; readings of this noise."""
    rng = np.random.default_rng(4)
    model, stops = CompassModel(np.zeros(18), EARTH), []
    for number, heading_deg in enumerate(np.arange(0.0, 360.0, 45.0)):
        stop = VehicleStop(6.0 * (number % 2), 2.0, np.linspace(-170.0, 170.0, 6), np.empty((6, 3)))
        exact = model.measured(np.radians(heading_deg), stop)
        stop.field_ut[:] = exact + noise_ut * rng.normal(0.0, 1.0, exact.shape)
        stops.append(stop)
    return stops


def test_readings_that_fit_three_times_worse_than_supposed_make_the_heading_three_times_less_sure() -> None:
    """Supposed are 0.05 uT; what fits better makes it no surer."""
    better, supposed, worse = (fit_compass(turned(noise_ut), EARTH) for noise_ut in (0.005, 0.05, 0.15))
    assert supposed.rms_ut == pytest.approx(0.05, rel=0.15)
    assert worse.heading_sigma_deg / supposed.heading_sigma_deg == pytest.approx(3.0, rel=0.1)
    assert better.heading_sigma_deg == pytest.approx(supposed.heading_sigma_deg, rel=0.1)


@pytest.mark.parametrize(
    ("pans_deg", "said"),
    [
        ([0.0, 70.0, 140.0, 200.0], None),
        (
            [0.0, 70.0, 140.0, 199.0],
            "read at 4 pan angles through 199 deg only; take 4 or more through 200 deg",
        ),
        ([0.0, 120.0, 240.0], "read at 3 pan angles through 240 deg only"),
    ],
)
def test_four_pan_angles_through_200_degrees_are_enough(pans_deg: list[float], said: str | None) -> None:
    stops = turned(0.005)
    model, empty = CompassModel(np.zeros(18), EARTH), np.empty((0, 3))
    few = VehicleStop(0.0, 2.0, np.array(pans_deg), empty)
    stops[5] = VehicleStop(0.0, 2.0, few.pan_deg, model.measured(np.radians(225.0), few))
    if said is None:
        assert fit_compass(stops, EARTH).heading_sigma_deg < 1.0
    else:
        with pytest.raises(CalibrationError, match=said):
            fit_compass(stops, EARTH)


def test_a_vehicle_that_was_not_turned_keeps_its_iron() -> None:
    """2 uT of hard iron in 23.5, of which the field's strength tells the part along it, and what soft iron adds."""
    fits = [fit_compass(turned(0.005)[: 2 * headings : 2], EARTH) for headings in (1, 4)]
    assert fits[0].heading_sigma_deg > np.degrees(2.0 / 23.5) / np.sqrt(2.0)
    assert fits[1].heading_sigma_deg < 0.3 * fits[0].heading_sigma_deg
    assert (fits[1].headings_deg + 45.0) % 360.0 == pytest.approx([45.0, 135.0, 225.0, 315.0], abs=0.1)


def test_a_quarter_of_a_microtesla_may_be_left() -> None:
    _require_explained(0.24)
    with pytest.raises(
        CalibrationError, match=r"0\.26 uT are left that no iron of stage and vehicle explains"
    ):
        _require_explained(0.26)


def iron(stage_bends: float = 0.0, vehicle_bends: float = 0.0) -> Iron:
    stage = ((1.0, stage_bends, 0.0), (stage_bends, 1.0, 0.0), (0.0, 0.0, 1.0))
    vehicle = ((1.0, 0.0, 0.0), (0.0, 1.0 - vehicle_bends, 0.0), (0.0, 0.0, 1.0))
    return Iron((0.0, 0.0, 0.0), stage, VehicleIron((0.0, 0.0, 0.0), vehicle))


def test_iron_may_bend_the_field_by_three_tenths_and_headings_be_uncertain_by_ten_degrees() -> None:
    _require_plausible(iron(0.29, 0.29), 9.9, turned=True)
    for bent in (iron(0.31), iron(vehicle_bends=0.31)):
        with pytest.raises(CalibrationError, match="iron of the rig bends the field by 31% "):
            _require_plausible(bent, 1.0, turned=True)
    with pytest.raises(CalibrationError, match=r"known to 10\.1 deg only; read more pan angles"):
        _require_plausible(iron(), 10.1, turned=True)
    with pytest.raises(
        CalibrationError, match=r"known to 10\.1 deg only; turn the vehicle too, to 4 headings"
    ):
        _require_plausible(iron(), 10.1, turned=False)
