"""Base attitude from the readings at the stops and at the pictures."""

import math
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rig.attitude.kinematics import Attitude, JointAngles, pan_stage_rotation
from rig.attitude.level import HeadLevel
from rig.capture.base_attitude import HEADING_OF_STOPS, MeanField, Stop, estimate_base
from rig.config.load import load_config
from rig.config.model import RigConfig
from rig.config.sections import NmeaCompassSection
from rig.devices.readings import HeadingReading
from rig.fault_notes import collecting

NOW = datetime(2026, 11, 26, 9, tzinfo=UTC)
BASE = Attitude(30.0, 0.0, 0.0)
EARTH_UT = np.array([0.0, 22.0, -43.0])
STOPS_DEG = (-135.0, -45.0, 45.0, 135.0)
VIEWS_DEG = (-100.0, -10.0, 80.0, 170.0)
LEVEL = HeadLevel((0.0, 0.0, 1.0), 0.0, 0.0, 0.002, 0.002, 500, 20.0)
KINDS = ("chip", "talker")


@pytest.fixture(params=KINDS)
def config(request: pytest.FixtureRequest) -> RigConfig:
    """A rig with a magnetometer chip, and one with a talker."""
    found = load_config(Path(__file__).parents[3] / "configs" / "vehicle.toml")
    compass: Any = found.compass
    if request.param == "talker":
        compass = NmeaCompassSection(kind="nmea", port="/dev/ttyUSB1", azimuth_bias_sigma_deg=0.001)
    changed = {"declination_deg": 0.0, "heading_offset_deg": 0.0, "azimuth_bias_sigma_deg": 0.001}
    return found.model_copy(update={"compass": compass.model_copy(update=changed)})


def read(config: RigConfig, pans_deg: Sequence[float], misread_deg: float = 0.0) -> list[Stop]:
    """What is read at these angles of the pan, by an encoder that shows so much more."""
    found = []
    for pan_deg in pans_deg:
        stage = pan_stage_rotation(BASE, pan_deg)
        field, headings = None, ()
        if isinstance(config.compass, NmeaCompassSection):
            shown_deg = math.degrees(math.atan2(stage[0, 1], stage[1, 1])) % 360.0
            headings = (HeadingReading(shown_deg, "true", None, None, None, 0.0, NOW),) * 3
        else:
            x, y, z = (stage.T @ EARTH_UT).tolist()
            field = MeanField((x, y, z), (0.02, 0.02, 0.02), 30, 20.0)
        found.append(Stop((0, 0), JointAngles(pan_deg + misread_deg, 0.0), LEVEL, field, headings, NOW))
    return found


def test_what_the_pan_is_misread_by_at_the_pictures_is_in_the_heading_too(config: RigConfig) -> None:
    views = read(config, VIEWS_DEG, misread_deg=0.08)
    alone = estimate_base(config, read(config, STOPS_DEG), "compass")
    assert alone.attitude.azimuth_deg == pytest.approx(30.0, abs=1e-6), "pictures are then 0.08 deg off"
    together = estimate_base(config, read(config, STOPS_DEG), "compass", views)
    assert together.attitude.azimuth_deg == pytest.approx(30.0 - 0.04, abs=0.002)
    for view in views:
        true_deg = 30.0 + view.joints.pan_deg - 0.08
        assert together.attitude.azimuth_deg + view.joints.pan_deg - true_deg == pytest.approx(
            0.04, abs=0.002
        )


@pytest.mark.parametrize(
    ("offset_deg", "azimuth_deg"), [(4.0, 34.0), (-4.0, 26.0), (-45.0, 345.0), (335.0, 5.0)]
)
def test_the_calibrated_offset_of_headings_is_added(
    config: RigConfig, offset_deg: float, azimuth_deg: float
) -> None:
    assert config.compass is not None
    changed = config.compass.model_copy(update={"heading_offset_deg": offset_deg})
    offset = config.model_copy(update={"compass": changed})
    found = estimate_base(offset, read(config, STOPS_DEG), "compass")
    assert found.attitude.azimuth_deg == pytest.approx(azimuth_deg, abs=1e-6)
    assert found.heading.heading_deg == pytest.approx(azimuth_deg, abs=1e-6)
    assert found.calibration["heading"]["heading_deg"] == pytest.approx(azimuth_deg, abs=1e-6)


def test_the_level_is_of_the_stops_alone(config: RigConfig) -> None:
    stops = read(config, STOPS_DEG)
    leaning = replace(LEVEL, tilt_deg=12.0, roll_deg=3.0)
    views = [replace(view, level=leaning) for view in read(config, VIEWS_DEG)]
    together = estimate_base(config, stops, "compass", views)
    assert together.level == estimate_base(config, stops, "compass").level
    assert together.stops == tuple(stops)
    assert len(together.raw["stops"]) == len(stops)


def test_a_picture_without_a_reading_of_the_compass_says_nothing(config: RigConfig) -> None:
    stops, views = read(config, STOPS_DEG), read(config, VIEWS_DEG, misread_deg=0.08)
    unread = [replace(view, field=None, headings=()) for view in views[1:]]
    assert estimate_base(config, stops, "compass", unread) == estimate_base(config, stops, "compass")
    mixed = estimate_base(config, stops, "compass", [views[0], *unread])
    assert mixed == estimate_base(config, stops, "compass", views[:1])


@pytest.mark.parametrize("at_deg", [VIEWS_DEG, (125.0, 128.0, 131.0, 145.0)])
def test_a_compass_that_froze_after_the_stops_is_noted_and_not_believed(
    config: RigConfig, at_deg: tuple[float, ...]
) -> None:
    """It goes on to say what it said at the last stop: not even plausible far from there, disturbed near by."""
    stops = read(config, STOPS_DEG)
    frozen = [replace(stops[-1], joints=JointAngles(pan_deg, 0.0)) for pan_deg in at_deg]
    with collecting() as faults:
        found = estimate_base(config, stops, "compass", frozen)
    assert found == estimate_base(config, stops, "compass")
    (note,) = faults.all()
    assert (note.device, note.action) == ("compass", HEADING_OF_STOPS)
