"""The launcher: what a rig finds, and that nothing is left behind."""

import json
import threading
import time
import tomllib
from pathlib import Path

import cv2
import numpy as np
import pytest
import serial
from numpy.typing import NDArray

from rig.config.load import load_config
from sim.commands.options import EMBEDDED_DEM
from sim.launch.launcher import simulated_rig
from sim.world.scenario import Altimeter, Compass, Inclinometer, Scenario, load_scenario
from sim.world.truth import World


def draw(rotation: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.uint8]:
    """A picture that is bright when the camera looks up."""
    return np.full((48, 64, 3), 100 + 100 * rotation[2, 2], dtype=np.uint8)


def make_world(scenario: Scenario) -> World:
    return World.create([EMBEDDED_DEM], scenario, 1)


@pytest.fixture(scope="module")
def world() -> World:
    return make_world(Scenario())


def open_descriptors() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


@pytest.mark.parametrize(
    ("inclinometer", "compass", "altimeter"),
    [
        ("adxl355", "mmc5983ma", "bmp390"),
        ("iis2iclx", "hdg", "bmp388"),
        ("adxl355", "ohpr", "ms5611"),
        ("iis2iclx", "ptnthpr", "xdr"),
        ("adxl355", "ths", "vaisala-pa50"),
    ],
)
def test_the_rig_accepts_the_configuration_of_whatever_is_fitted(
    inclinometer: str, compass: str, altimeter: str, tmp_path: Path
) -> None:
    scenario = Scenario(
        inclinometer=Inclinometer.model_validate({"chip": inclinometer}),
        compass=Compass.model_validate({"kind": compass}),
        altimeter=Altimeter.model_validate({"kind": altimeter}),
    )
    with simulated_rig(make_world(scenario), picture=draw, bundle_dir=tmp_path) as rig:
        config = load_config(rig.config_path)
        assert config.inclinometer.chip == inclinometer
        serial_ports = [
            section.port for section in (config.compass, config.altimeter) if hasattr(section, "port")
        ]
        assert len(serial_ports) == len(rig.talkers)
        for path in serial_ports:
            with serial.Serial(path, 4800, timeout=2.0) as port:
                assert port.readline()


def test_a_rig_without_errors_is_accepted_too() -> None:
    ideal = load_scenario(Path(__file__).parents[3] / "configs/scenarios/ideal.toml")
    with simulated_rig(make_world(ideal), picture=draw) as rig:
        assert load_config(rig.config_path).inclinometer.tilt_bias_sigma_deg > 0.0


def test_the_camera_follows_the_servos(world: World) -> None:
    with simulated_rig(world, picture=draw) as rig:
        source = tomllib.loads(rig.config_path.read_text())["camera"]["source"]
        capture = cv2.VideoCapture(source, cv2.CAP_FFMPEG)
        before = int(np.median(capture.read()[1]))
        rig.tilt.write(64, b"\x01")
        rig.tilt.write(116, (1992 - round(40 * 4096 / 360)).to_bytes(4, "little"))
        deadline_s = time.monotonic() + 5.0
        while int(np.median(capture.read()[1])) < before + 50:
            assert time.monotonic() < deadline_s
        time.sleep(1.0)
        capture.read()
        capture.release()
        assert world.head.tilt_deg == pytest.approx(40.0, abs=0.3)
        assert not world.head.moving


def test_the_truth_is_next_to_the_configuration(world: World) -> None:
    with simulated_rig(world, picture=draw) as rig:
        assert set(rig.environment) == {"SKYFIX_CONFIG", "SKYFIX_TRUTH"}
        truth = json.loads(Path(rig.environment["SKYFIX_TRUTH"]).read_text())
        assert {"easting_m", "northing_m", "crs", "lat_deg", "lon_deg", "altitude_m", "row", "col"} <= set(
            truth
        )
        config = rig.config_path.read_text()
        assert f"{truth['lat_deg']:.4f}"[:7] not in config


def test_nothing_is_left_behind(world: World) -> None:
    threads, descriptors = threading.active_count(), open_descriptors()
    with simulated_rig(world, picture=draw) as rig:
        assert rig.config_path.exists()
        assert threading.active_count() > threads
    assert threading.active_count() == threads
    assert open_descriptors() == descriptors
    assert not rig.config_path.parent.exists()


def test_a_failure_within_tears_down_too(world: World) -> None:
    threads = threading.active_count()
    with pytest.raises(RuntimeError), simulated_rig(world, picture=draw):
        raise RuntimeError
    assert threading.active_count() == threads
