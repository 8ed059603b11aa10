"""Readings against what else is known: an altitude and the terrain, a tilt and its servo, a declination and the model."""

from dataclasses import dataclass
from datetime import UTC, datetime
from types import SimpleNamespace

import numpy as np
import pytest

from rig.attitude.altitude_plausibility import AltitudeBounds, altitude_bounds, require_plausible_altitude
from rig.attitude.declination import Declination, declination
from rig.attitude.kinematics import Attitude, JointAngles
from rig.attitude.magnetic_model import ModelField
from rig.attitude.tilt_agreement import require_agreement
from rig.config.sections import I2cAltimeterSection, Place
from rig.errors import ConfigError, DeviceError
from rig.fault_notes import collecting

NOVEMBER = datetime(2026, 11, 23, tzinfo=UTC)
PLACE = Place(lat_deg=47.0, lon_deg=8.0)
NOWHERE_NEAR = Place(lat_deg=47.0, lon_deg=8.0, altitude_m=800.0)


def barometer(kind: str = "bmp390") -> I2cAltimeterSection:
    return I2cAltimeterSection.model_validate(
        {
            "kind": kind,
            "bus": "/dev/i2c-1",
            "address": 0x77,
            "reference_pressure_hpa": 980.0,
            "reference_altitude_m": 500.0,
        }
    )


@dataclass
class Config:
    place: Place | None = None
    altimeter: I2cAltimeterSection | None = None


def dem(*heights_m: float) -> SimpleNamespace:
    return SimpleNamespace(z_m=np.array([heights_m]), source=[SimpleNamespace(name="dem.tif")])


@pytest.mark.parametrize(
    ("config", "terrain", "bounds"),
    [
        (Config(), None, []),
        # 300 m beyond the terrain, whose voids do not count.
        (
            Config(),
            dem(400.0, np.nan, 2200.0),
            [(100.0, 2500.0, "the ground of dem.tif lies at 400 to 2200 m")],
        ),
        # 3500 m around the place, if it has an altitude.
        (Config(NOWHERE_NEAR), None, [(-2700.0, 4300.0, "[place] altitude_m says 800 m")]),
        (Config(PLACE), None, []),
        (
            Config(NOWHERE_NEAR, barometer("ms5611")),
            dem(400.0),
            [
                (100.0, 700.0, "the ground of dem.tif lies at 400 to 400 m"),
                (-2700.0, 4300.0, "[place] altitude_m says 800 m"),
            ],
        ),
        # The reference counts where nothing else does, and for a chip that has a double.
        (Config(PLACE, barometer("bmp390")), None, []),
        (
            Config(PLACE, barometer("ms5607")),
            None,
            [
                (
                    -3000.0,
                    4000.0,
                    "the reference lies at 500 m and there is no [place] altitude_m that says more",
                )
            ],
        ),
        (
            Config(None, barometer("ms5611")),
            dem(400.0, 600.0),
            [(100.0, 900.0, "the ground of dem.tif lies at 400 to 600 m")],
        ),
    ],
)
def test_the_bounds_of_an_altitude_and_where_they_come_from(
    config: Config, terrain: SimpleNamespace | None, bounds: list[tuple[float, float, str]]
) -> None:
    found = altitude_bounds(config, terrain)  # type: ignore[arg-type]
    assert [(bound.low_m, bound.high_m, bound.by) for bound in found] == bounds


def test_an_unnamed_terrain_is_the_elevation_model() -> None:
    terrain = SimpleNamespace(z_m=np.array([[400.0]]), source=[])
    (bound,) = altitude_bounds(Config(), terrain)  # type: ignore[arg-type]
    assert bound.by == "the ground of the elevation model lies at 400 to 400 m"


@pytest.mark.parametrize(
    ("altitude_m", "is_possible"),
    [(99.0, False), (100.0, True), (500.0, True), (501.0, False), (2600.0, False)],
)
def test_an_altitude_must_lie_within_all_bounds(altitude_m: float, is_possible: bool) -> None:
    bounds = [AltitudeBounds(100.0, 2500.0, "the terrain"), AltitudeBounds(-3000.0, 500.0, "the place")]
    if is_possible:
        require_plausible_altitude(altitude_m, 900.0, barometer(), "BMP390", bounds)
        return
    by = "the place" if 100.0 <= altitude_m <= 2500.0 else "the terrain"
    with pytest.raises(
        DeviceError, match=rf"BMP390: 900\.0 hPa would be an altitude of \d+ m, but {by}; check"
    ):
        require_plausible_altitude(altitude_m, 900.0, barometer(), "BMP390", bounds)


@pytest.mark.parametrize(("kind", "part"), [("ms5611", "half"), ("ms5607", "twice")])
def test_a_barometer_with_a_double_names_it(kind: str, part: str) -> None:
    other = {"ms5611": "ms5607", "ms5607": "ms5611"}[kind]
    said = rf'an {other.upper()} read as an {kind.upper()} gives {part} the pressure: .*kind = "{other}"\), then check'
    with pytest.raises(DeviceError, match=said):
        require_plausible_altitude(
            9.0, 473.0, barometer(kind), "x", [AltitudeBounds(10.0, 20.0, "the place")]
        )


LEVEL = Attitude(30.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("joint_deg", "measured_deg", "is_refused"),
    [
        # Up to 8 deg of tilt 2 deg of backlash, above that a quarter.
        (7.0, 8.9, False),
        (7.0, 9.1, True),
        (7.0, 5.1, False),
        (7.0, 4.9, True),
        (-7.0, -8.9, False),
        (-7.0, -9.1, True),
        (20.0, 24.9, False),
        (20.0, 25.1, True),
        (-20.0, -15.1, False),
        (-20.0, -14.9, True),
        # Below 6 deg a factor says nothing.
        (5.9, 30.0, False),
        (6.1, 30.0, True),
        (-5.9, 30.0, False),
        (-6.1, 30.0, True),
    ],
)
def test_a_tilt_agrees_with_its_servo_but_for_backlash(
    joint_deg: float, measured_deg: float, is_refused: bool
) -> None:
    joints = JointAngles(40.0, joint_deg)
    if not is_refused:
        require_agreement(LEVEL, joints, measured_deg, "chip")
        return
    said = rf"tilted by {measured_deg:.1f} deg where the tilt servo turned it by {joint_deg:.1f} deg, a factor of "
    with pytest.raises(DeviceError, match=f"{said}{measured_deg / joint_deg:.2f}"):
        require_agreement(LEVEL, joints, measured_deg, "chip")


def test_a_slope_is_not_taken_for_a_tilt_of_the_servo() -> None:
    """A vehicle with its bow up by 10: the head ahead is at 10, and at 25 with 15 of the servo."""
    bow_up = Attitude(0.0, 10.0, 0.0)
    require_agreement(bow_up, JointAngles(0.0, 15.0), 25.0, "chip")
    with pytest.raises(DeviceError, match=r"tilted by 5\.0 deg where the tilt servo turned it by 15\.0 deg"):
        require_agreement(bow_up, JointAngles(0.0, 15.0), 15.0, "chip")
    require_agreement(bow_up, JointAngles(180.0, 15.0), 5.0, "chip")


def model(
    monkeypatch: pytest.MonkeyPatch,
    declination_deg: float,
    sigma_deg: float = 0.36,
    date_sigma_deg: float = 0.0,
    problem: str | None = None,
) -> None:
    found = ModelField(22.0, 43.0, declination_deg, sigma_deg, problem, date_sigma_deg)
    monkeypatch.setattr("rig.attitude.declination.model_field", lambda place, when: found)


@pytest.mark.parametrize(
    ("model_deg", "sent_deg", "sigmas", "source"),
    [
        # Two degrees from the model are another year's, or rounded.
        (3.0, 4.9, (0.36, 0.0), "talker"),
        (3.0, 5.1, (0.36, 0.0), "World Magnetic Model"),
        (3.0, 1.1, (0.36, 0.0), "talker"),
        (3.0, 0.9, (0.36, 0.0), "World Magnetic Model"),
        # Three sigmas of a model that is less sure, near a pole.
        (3.0, 5.9, (1.0, 0.0), "talker"),
        (3.0, 6.1, (1.0, 0.0), "World Magnetic Model"),
        # Twice the change over the model's years, of a date that is not known.
        (3.0, 6.9, (0.36, 2.0), "talker"),
        (3.0, 7.1, (0.36, 2.0), "World Magnetic Model"),
        # Across the south.
        (179.5, -179.5, (0.36, 0.0), "talker"),
        # 0.0 is a filler where the model says more than half a degree.
        (0.4, 0.0, (0.36, 0.0), "talker"),
        (-0.4, 0.0, (0.36, 0.0), "talker"),
        (0.6, 0.0, (0.36, 0.0), "World Magnetic Model"),
        (-0.6, 0.0, (0.36, 0.0), "World Magnetic Model"),
    ],
)
def test_a_talkers_variation_counts_where_the_model_agrees(
    monkeypatch: pytest.MonkeyPatch,
    model_deg: float,
    sent_deg: float,
    sigmas: tuple[float, float],
    source: str,
) -> None:
    model(monkeypatch, model_deg, *sigmas)
    found = declination(None, sent_deg, PLACE, NOVEMBER)
    assert found.source == source
    assert found.declination_deg == (sent_deg if source == "talker" else model_deg)
    off_deg = abs((sent_deg - model_deg + 180.0) % 360.0 - 180.0)
    assert found.sigma_deg == pytest.approx(off_deg / 2.0 if source == "talker" else sigmas[1])


def test_a_variation_that_is_not_believed_is_noted(monkeypatch: pytest.MonkeyPatch) -> None:
    model(monkeypatch, 3.0, problem="the clock says 1970", date_sigma_deg=0.5)
    found = declination(None, 12.0, PLACE, NOVEMBER)
    with collecting() as faults:
        found.note()
    (note,) = faults.all()
    said = "sends the variation 12.0 deg, and the World Magnetic Model has 3.0 deg at [place] (the clock says 1970)"
    assert (note.device, note.problem, note.action) == ("compass", said, "the model's is used")
    assert found.record() == {
        "declination_deg": 3.0,
        "source": "World Magnetic Model",
        "sigma_deg": 0.5,
        "doubt": said,
        "action": "the model's is used",
    }
    undated = declination(None, None, PLACE, NOVEMBER)
    assert (undated.doubt, undated.action) == (
        "the clock says 1970",
        "the nearest date's declination is used",
    )


def test_a_declination_without_doubt_notes_nothing() -> None:
    with collecting() as faults:
        Declination(3.0, "configuration").note()
    assert list(faults.all()) == []
    assert Declination(3.0, "configuration").record() == {"declination_deg": 3.0, "source": "configuration"}


def test_a_zero_alone_is_no_declination() -> None:
    with pytest.raises(
        ConfigError, match=r"magnetic headings; the variation 0\.0 that it sends may be a filler;"
    ):
        declination(None, 0.0, None, NOVEMBER)
    with pytest.raises(ConfigError, match=r"magnetic headings; give it"):
        declination(None, None, None, NOVEMBER)
