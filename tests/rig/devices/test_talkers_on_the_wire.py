"""Whole captures with talkers that tell the truth badly: the bundle agrees with the truth, or there is none."""

import json
from pathlib import Path
from typing import Any, get_args

import pytest
from fakes.simulated import quick_rig, world

from localizer.bundle import load_bundle
from rig.attitude.kinematics import wrapped_deg
from rig.check.devices import check_devices
from rig.config.load import load_config
from rig.errors import DeviceError
from sim.devices.talker_quirks import BAROMETER_QUIRKS, COMPASS_QUIRKS
from sim.world.scenario import BarometerQuirk, CompassQuirk


def taken(folder: Path, **devices: Any) -> tuple[dict[str, Any], float, float]:
    """``bundle.json`` of a quick capture, and by how much its heading and its altitude are off, in their sigmas."""
    with quick_rig(world(**devices), folder, in_this_process=True) as quick:
        path = quick.capture()
        truth = json.loads(quick.rig.truth_path.read_text())
        bundle = load_bundle(path)
        raw = json.loads((path / "bundle.json").read_text())
        assert bundle.altitude is not None
        heading_deg = raw["calibration"]["heading"]["heading_deg"]
        true_deg = quick.world.mechanics.base.heading_deg
        heading_sigmas = wrapped_deg(heading_deg - true_deg) / bundle.azimuth_bias_sigma_deg
        altitude_sigmas = (bundle.altitude.value_m - truth["altitude_m"]) / bundle.altitude.sigma_m
        return raw, heading_sigmas, altitude_sigmas


@pytest.mark.long
def test_one_stream_for_both_and_a_variation_that_is_a_filler(tmp_path: Path) -> None:
    raw, heading_sigmas, altitude_sigmas = taken(
        tmp_path,
        compass="hdg",
        altimeter="xdr",
        compass_quirk="variation-zero",
        altimeter_quirk="two-decimals",
        one_stream=True,
    )
    assert abs(heading_sigmas) < 4.0
    assert abs(altitude_sigmas) < 4.0
    assert raw["altitude"]["sigma_m"] > 20.0
    problems = [fault["problem"] for fault in raw["raw"]["faults"]]
    assert any("sends the variation 0.0 deg" in problem for problem in problems)


@pytest.mark.long
@pytest.mark.parametrize(
    ("kind", "quirk"),
    [
        ("hdg", "variation-as-deviation"),
        ("hdg", "variation-twice"),
        ("hdg", "magnetic-as-true"),
        ("hdm", "carriage-return"),
        ("hdm", "zero-byte"),
        ("hdm", "tagged"),
        ("hdm", "whole-degrees"),
        ("hdg", "hdg-and-hdm"),
        ("os5000", None),
    ],
)
def test_a_capture_agrees_with_the_truth(tmp_path: Path, kind: str, quirk: str | None) -> None:
    _, heading_sigmas, _ = taken(tmp_path, compass=kind, compass_quirk=quirk)
    assert abs(heading_sigmas) < 4.0


@pytest.mark.long
@pytest.mark.parametrize("quirk", ["two-compasses", "true-marked-magnetic", "no-value", "manual"])
def test_a_capture_with_no_heading_to_trust_is_refused(tmp_path: Path, quirk: str) -> None:
    with quick_rig(world(compass="hdm", compass_quirk=quirk), tmp_path, in_this_process=True) as quick:
        with pytest.raises(DeviceError):
            quick.capture()
        assert quick.left_over() == []


@pytest.mark.parametrize(
    "quirk",
    [
        "two-decimals",
        *(
            pytest.param(quirk, marks=pytest.mark.long)
            for quirk in (None, *BAROMETER_QUIRKS)
            if quirk != "two-decimals"
        ),
    ],
)
def test_the_altitude_by_a_talker_is_the_air_s(tmp_path: Path, quirk: str | None) -> None:
    with quick_rig(world(altimeter="xdr", altimeter_quirk=quirk), tmp_path, in_this_process=True) as quick:
        (row,) = [
            row for row in check_devices(load_config(quick.rig.config_path)) if row.device == "altimeter"
        ]
        if quirk == "two-barometers":
            assert "its sources do not agree" in (row.problem or "")
            return
        assert row.problem is None
        truth = json.loads(quick.rig.truth_path.read_text())
        told_m = float(row.reading.split(",")[1].split()[0])
        assert abs(told_m - truth["altitude_m"]) < (60.0 if quirk == "two-decimals" else 25.0)


def test_the_scenario_knows_all_quirks() -> None:
    assert set(get_args(CompassQuirk)) == set(COMPASS_QUIRKS)
    assert set(get_args(BarometerQuirk)) == set(BAROMETER_QUIRKS)
