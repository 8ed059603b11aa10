"""Heading of the base from a compass on the pan stage, and its declination."""

from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.attitude.declination import Declination, declination
from rig.attitude.heading import (
    CompassHeading,
    FieldAtPan,
    HeadingsAtPan,
    VehicleIron,
    circular_mean_deg,
    heading_from_field,
    heading_from_talker,
    true_heading,
)
from rig.attitude.kinematics import Attitude, pan_stage_rotation, wrapped_deg
from rig.attitude.level import BaseLevel
from rig.config.sections import Place
from rig.errors import ConfigError, DeviceError

PANS_DEG = (-135.0, -45.0, 45.0, 135.0)
EARTH_UT = np.array([0.0, 22.0, -43.0])  # magnetic east, magnetic north, up
NOVEMBER = datetime(2026, 11, 23, tzinfo=UTC)

headings = st.floats(0.0, 359.9)
slopes = st.floats(-8.0, 8.0)


def base_estimate(pitch_deg: float, roll_deg: float, sigma_deg: float = 0.0) -> BaseLevel:
    return BaseLevel(pitch_deg, roll_deg, 0.0, 0.0, 0.0, 0.0, sigma_deg, 0.0)


def fields(
    base: Attitude,
    pans_deg: tuple[float, ...] = PANS_DEG,
    stage_ut: tuple[float, float, float] = (0.0, 0.0, 0.0),
    noise_ut: float = 0.0,
) -> list[FieldAtPan]:
    rng = np.random.default_rng(3)
    found = []
    for pan_deg in pans_deg:
        exact = pan_stage_rotation(base, pan_deg).T @ EARTH_UT + stage_ut
        samples_ut = exact + rng.normal(0.0, noise_ut, (20, 3))
        found.append(
            FieldAtPan(pan_deg, samples_ut.mean(axis=0), float(samples_ut.std(axis=0).max()) / 20**0.5)
        )
    return found


def talks(
    base: Attitude, pans_deg: tuple[float, ...] = PANS_DEG, deviation_deg: float = 0.0
) -> list[HeadingsAtPan]:
    found = []
    for pan_deg in pans_deg:
        east, north, _ = pan_stage_rotation(base, pan_deg)[:, 1]
        heading = np.arctan2(east, north)
        shown = np.degrees(heading) + deviation_deg * np.sin(heading + 0.7)
        found.append(HeadingsAtPan(pan_deg, (float(shown % 360.0),) * 3))
    return found


@given(headings, slopes, slopes)
def test_heading_on_any_slope(heading_deg: float, pitch_deg: float, roll_deg: float) -> None:
    found = heading_from_field(
        fields(Attitude(heading_deg, pitch_deg, roll_deg)), base_estimate(pitch_deg, roll_deg)
    )
    assert wrapped_deg(found.heading_deg - heading_deg) == pytest.approx(0.0, abs=1e-6)
    assert (found.horizontal_ut, found.down_ut) == pytest.approx((22.0, 43.0))


@given(headings, st.floats(-15.0, 15.0), st.floats(-15.0, 15.0))
def test_iron_on_the_pan_stage_is_found_and_does_not_matter(
    heading_deg: float, x_ut: float, y_ut: float
) -> None:
    found = heading_from_field(
        fields(Attitude(heading_deg, 0.0, 0.0), stage_ut=(x_ut, y_ut, 0.0)), base_estimate(0, 0)
    )
    assert wrapped_deg(found.heading_deg - heading_deg) == pytest.approx(0.0, abs=1e-6)
    assert found.stage_field_ut == pytest.approx((x_ut, y_ut), abs=1e-9)


def test_uneven_pan_angles_do_as_well() -> None:
    base = Attitude(200.0, 2.0, 1.0)
    found = heading_from_field(fields(base, (-100.0, -20.0, 30.0), (6.0, -4.0, 0.0)), base_estimate(2.0, 1.0))
    assert found.heading_deg == pytest.approx(200.0, abs=1e-6)


def test_noise_and_level_show_in_the_scatter() -> None:
    base = Attitude(80.0, 1.0, -2.0)
    quiet = heading_from_field(fields(base, noise_ut=0.04), base_estimate(1.0, -2.0))
    assert abs(quiet.heading_deg - 80.0) < 0.1
    assert 0.0 < quiet.scatter_deg < 0.1
    loud = heading_from_field(fields(base, noise_ut=1.0), base_estimate(1.0, -2.0))
    assert loud.scatter_deg > 3 * quiet.scatter_deg
    shaky = heading_from_field(fields(base), base_estimate(1.0, -2.0, sigma_deg=0.5))
    assert shaky.scatter_deg == pytest.approx(0.5 * 43 / 22, rel=0.01)


def test_more_angles_make_a_surer_heading() -> None:
    base = Attitude(80.0, 0.0, 0.0)
    few, many = PANS_DEG, (*PANS_DEG, -171.0, -81.0, 9.0, 99.0)
    errors_deg, told_deg = [], []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        for pans_deg in (few, many):
            off_deg = rng.normal(0.0, 0.03, len(pans_deg))
            read = [
                FieldAtPan(f.pan_deg + off, f.mean_ut, f.noise_ut)
                for f, off in zip(fields(base, pans_deg), off_deg, strict=True)
            ]
            found = heading_from_field(read, base_estimate(0.0, 0.0))
            errors_deg.append(found.heading_deg - 80.0)
            told_deg.append(found.scatter_deg)
    error, told = (np.sqrt(np.square(x).reshape(-1, 2).mean(axis=0)) for x in (errors_deg, told_deg))
    assert error[1] < 0.8 * error[0]
    assert told == pytest.approx(error, rel=0.35)


def test_the_same_angle_twice_makes_no_heading_surer() -> None:
    base = Attitude(80.0, 0.0, 0.0)
    off_deg = (0.05, -0.03, 0.02, -0.06)
    read = [FieldAtPan(f.pan_deg + off, f.mean_ut, 0.0) for f, off in zip(fields(base), off_deg, strict=True)]
    once, twice = (heading_from_field(read * times, base_estimate(0.0, 0.0)) for times in (1, 2))
    assert once.scatter_deg > 0.01
    assert twice.scatter_deg == pytest.approx(once.scatter_deg)
    said = [replace(h, pan_deg=h.pan_deg + off) for h, off in zip(talks(base), off_deg, strict=True)]
    once_said, twice_said = (heading_from_talker(said * times, base_estimate(0.0, 0.0)) for times in (1, 2))
    assert once_said.scatter_deg > 0.01
    assert twice_said.scatter_deg == pytest.approx(once_said.scatter_deg)


def test_three_angles_of_a_talker_and_one_of_them_again_are_averaged() -> None:
    three = talks(Attitude(10.0, 0.0, 0.0), (-120.0, 0.0, 120.0), 3.0)
    assert heading_from_talker([*three, three[1]], base_estimate(0.0, 0.0)).scatter_deg > 0.5


def test_a_field_that_is_not_the_earths() -> None:
    magnet = [FieldAtPan(f.pan_deg, f.mean_ut * 5.0, 0.0) for f in fields(Attitude(0.0, 0.0, 0.0))]
    with pytest.raises(
        DeviceError, match=r"compass: measures 241\.\d uT.* check \[compass\] axes and hard_iron_ut"
    ):
        heading_from_field(magnet, base_estimate(0.0, 0.0))


def of_field(east_ut: float, north_ut: float, up_ut: float) -> list[FieldAtPan]:
    """What a compass reads of a field in the axes of a level vehicle that heads north."""
    found = []
    for pan_deg in PANS_DEG:
        c, s = np.cos(np.radians(pan_deg)), np.sin(np.radians(pan_deg))
        stage = np.array([c * east_ut - s * north_ut, s * east_ut + c * north_ut, up_ut])
        found.append(FieldAtPan(pan_deg, stage, 0.01))
    return found


@pytest.mark.parametrize(
    ("horizontal_ut", "down_ut", "is_the_earths"),
    [
        (9.0, 11.9, False),  # hypot 14.92
        (9.0, 12.1, True),  # 15.08
        (60.0, 79.9, True),  # 99.9
        (60.0, 80.1, False),  # 100.1
        (1.9, 60.0, False),  # near a magnetic pole
        (2.1, 60.0, True),
        (0.0, 50.0, False),
    ],
)
def test_the_earths_field_has_15_to_100_ut_and_2_of_them_horizontal(
    horizontal_ut: float, down_ut: float, is_the_earths: bool
) -> None:
    read = of_field(0.6 * horizontal_ut, 0.8 * horizontal_ut, -down_ut)
    if is_the_earths:
        found = heading_from_field(read, base_estimate(0.0, 0.0))
        assert found.heading_deg == pytest.approx(360.0 - 36.8699, abs=1e-3), (
            "north is 36.87 deg to the right"
        )
        assert (found.horizontal_ut, found.down_ut) == pytest.approx((horizontal_ut, down_ut))
        return
    with pytest.raises(DeviceError, match=rf"measures .* uT, {horizontal_ut:.1f} of it horizontal: not the"):
        heading_from_field(read, base_estimate(0.0, 0.0))


def test_the_vehicles_iron_is_taken_off_in_its_own_axes() -> None:
    """Hard iron of 5 uT to the right and soft iron that makes a quarter more of what lies ahead."""
    iron = VehicleIron((5.0, 0.0, 0.0), ((1.0, 0.0, 0.0), (0.0, 1.25, 0.0), (0.0, 0.0, 1.0)))
    found = heading_from_field(of_field(15.0 + 5.0, 1.25 * 20.0, -40.0), base_estimate(0.0, 0.0), iron)
    assert found.heading_deg == pytest.approx(360.0 - 36.8699, abs=1e-3)
    assert (found.horizontal_ut, found.down_ut) == pytest.approx((25.0, 40.0))


def test_the_scatter_of_an_even_turn_is_the_noise_over_the_field() -> None:
    """Eight readings of two axes for the two horizontal parts: sigma^2 / 4 each. And the level's share, by the dip."""
    quiet = [replace(field, noise_ut=0.4) for field in of_field(0.0, 20.0, -40.0)]
    found = heading_from_field(quiet, base_estimate(0.0, 0.0, sigma_deg=0.1))
    by_noise_deg = np.degrees(0.4 / 2.0 / 20.0)
    assert found.scatter_deg == pytest.approx(np.hypot(by_noise_deg, 0.1 * 40.0 / 20.0))
    assert found.misfit_deg == pytest.approx(0.0, abs=1e-9)


def test_the_misfit_is_the_residual_for_the_degrees_of_freedom() -> None:
    """A second harmonic of 0.4 uT, which no field and no iron has: four vectors of that length, 8 values less 4 unknowns."""
    bent = []
    for field in of_field(0.0, 20.0, -40.0):
        twice = np.radians(2.0 * field.pan_deg)
        bent.append(
            replace(field, mean_ut=field.mean_ut + 0.4 * np.array([np.cos(twice), np.sin(twice), 0.0]))
        )
    found = heading_from_field(bent, base_estimate(0.0, 0.0))
    rms_ut = np.sqrt(4 * 0.4**2 / (8 - 4))
    assert found.misfit_deg == pytest.approx(np.degrees(rms_ut / 20.0))
    assert found.scatter_deg == pytest.approx(np.degrees(rms_ut / 2.0 / 20.0))


@pytest.mark.parametrize(("off_deg", "is_refused"), [(19.0, False), (21.0, True)])
def test_a_talker_may_deviate_by_20_degrees(off_deg: float, is_refused: bool) -> None:
    """To the right and to the left by turns, so that the mean stays."""
    said = [
        HeadingsAtPan(pan_deg, ((pan_deg + off_deg * (-1) ** i) % 360.0,))
        for i, pan_deg in enumerate((0.0, 120.0, 180.0, 300.0))
    ]
    if is_refused:
        with pytest.raises(DeviceError, match=r"its headings do not turn with the pan \(21 deg off\)"):
            heading_from_talker(said, base_estimate(0.0, 0.0))
    else:
        assert heading_from_talker(said, base_estimate(0.0, 0.0)).misfit_deg > 5.0


def test_the_scatter_of_a_steady_talker_is_the_noise_of_its_mean() -> None:
    """Three angles, averaged; at each four headings 0.3 deg off by turns: 0.3 / sqrt(4) / sqrt(3)."""
    said = [
        HeadingsAtPan(pan_deg, tuple((pan_deg + off) % 360.0 for off in (0.3, -0.3, 0.3, -0.3)))
        for pan_deg in (-120.0, 0.0, 120.0)
    ]
    found = heading_from_talker(said, base_estimate(0.0, 0.0))
    assert found.scatter_deg == pytest.approx(0.3 / 2.0 / np.sqrt(3.0), rel=1e-6)


@given(headings, slopes, slopes)
def test_a_talker_on_any_slope(heading_deg: float, pitch_deg: float, roll_deg: float) -> None:
    found = heading_from_talker(
        talks(Attitude(heading_deg, pitch_deg, roll_deg)), base_estimate(pitch_deg, roll_deg)
    )
    assert wrapped_deg(found.heading_deg - heading_deg) == pytest.approx(0.0, abs=1e-6)


@given(headings)
def test_a_talkers_deviation_is_solved_for(heading_deg: float) -> None:
    found = heading_from_talker(
        talks(Attitude(heading_deg, 0.0, 0.0), deviation_deg=3.0), base_estimate(0.0, 0.0)
    )
    assert wrapped_deg(found.heading_deg - heading_deg) == pytest.approx(0.0, abs=0.2)


def test_three_angles_of_a_talker_are_averaged() -> None:
    found = heading_from_talker(
        talks(Attitude(10.0, 0.0, 0.0), (-120.0, 0.0, 120.0), 3.0), base_estimate(0.0, 0.0)
    )
    assert found.heading_deg == pytest.approx(10.0, abs=0.2)
    assert found.scatter_deg > 0.5


def test_a_talker_that_does_not_turn() -> None:
    stuck = [HeadingsAtPan(pan_deg, (120.0,)) for pan_deg in PANS_DEG]
    with pytest.raises(DeviceError, match="compass: its headings do not turn with the pan"):
        heading_from_talker(stuck, base_estimate(0.0, 0.0))


def test_mean_of_directions_across_north() -> None:
    assert circular_mean_deg([359.0, 2.0]) == pytest.approx(0.5)


def test_true_heading_adds_declination_and_trust() -> None:
    heading = true_heading(CompassHeading(355.0, 0.3, 0.0), 0.4, Declination(13.0, "configuration"))
    assert heading.heading_deg == pytest.approx(8.0)
    assert heading.sigma_deg == pytest.approx(0.5)
    unknown = true_heading(CompassHeading(355.0, 170.0, 0.0), 170.0, None)
    assert unknown.sigma_deg == 180.0, "no more than nothing is known"
    assert true_heading(CompassHeading(355.0, 0.0, 0.0), 1.0, None).heading_deg == 355.0


@pytest.mark.parametrize(
    ("lat_deg", "lon_deg", "altitude_m", "declination_deg"),
    [(47.37, 8.54, 400.0, 3.6567), (27.70, 85.30, 1400.0, 0.4275)],
)
def test_declination_of_the_world_magnetic_model(
    lat_deg: float, lon_deg: float, altitude_m: float, declination_deg: float
) -> None:
    place = Place(lat_deg=lat_deg, lon_deg=lon_deg, altitude_m=altitude_m)
    found = declination(None, None, place, datetime(2026, 11, 25, 12, tzinfo=UTC))
    assert found.declination_deg == pytest.approx(declination_deg, abs=0.002)
    assert found.source == "World Magnetic Model"


def test_the_nearest_source_of_declination_wins() -> None:
    place = Place(lat_deg=47.0, lon_deg=8.0)
    assert declination(1.0, 2.0, place, NOVEMBER) == Declination(1.0, "configuration")
    assert declination(None, 2.0, place, NOVEMBER) == Declination(2.0, "talker")
    assert declination(None, 0.0, place, NOVEMBER).source == "World Magnetic Model", "a filler"
    assert declination(None, 9.0, place, NOVEMBER).source == "World Magnetic Model", "from elsewhere"


def test_no_declination_to_be_had() -> None:
    with pytest.raises(ConfigError, match=r"\[compass\] declination_deg: needed.* or the rough \[place\]"):
        declination(None, None, None, NOVEMBER)
