"""The whole chain over the real commands: simulated devices, ``rig``, ``localizer``; and what bad input comes to."""

import hashlib
import json
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from localizer.bundle import load_bundle
from localizer.fix import Fix
from sim.commands.demo import judge
from sim.commands.options import EMBEDDED_DEM
from sim.launch.child_command import find_command
from sim.launch.launcher import SimulatedRig, simulated_rig
from sim.world.scenario import Scenario
from sim.world.truth import World

CELL_M = 30.0
BAD_INPUT, NOWHERE, INTERRUPTED = 2, 4, 130
HASTE = {
    "[pan_tilt]": "velocity_deg_s = 200.0\nacceleration_deg_s2 = 1000.0",
    "[inclinometer]": "average_s = 0.3",
    "[camera]": "exposure_settle_s = 0.1\nopen_timeout_s = 2.0\nread_timeout_s = 1.0",
}
"""Keys that make a capture quick; the rest is as the simulator writes it."""

ODD_JOBS = "\n[capture]\nbase_attitude_pan_angles_deg = [-120.0, 0.0, 120.0]\n"


@dataclass(frozen=True)
class Ended:
    """A command that has ended."""

    status: int
    out: str
    err: str

    def assert_one_line(self, *words: str) -> None:
        """Bad input: status 2, and one line on standard error that says these words."""
        assert self.status == BAD_INPUT, self.err
        assert self.err.count("\n") == 1, self.err
        for word in words:
            assert word in self.err


def call(*command: str | Path) -> Ended:
    name, *arguments = map(str, command)
    done = subprocess.run(
        [find_command(name), *arguments], capture_output=True, text=True, timeout=120, check=False
    )
    return Ended(done.returncode, done.stdout, done.stderr)


@pytest.fixture(scope="module")
def world() -> World:
    return World.create([EMBEDDED_DEM], Scenario(), 3)


def sky_over_ground(rotation: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.uint8]:
    """A quick picture, good enough to be captured."""
    picture = np.full((480, 640, 3), (230, 190, 150), dtype=np.uint8)
    picture[240 + round(492.8 * np.tan(np.arcsin(rotation[2, 2]))) :] = (40, 70, 50)
    return picture


@contextmanager
def hasty_rig(world: World, *, drawn: bool) -> Iterator[SimulatedRig]:
    """A simulated rig whose configuration asks for a quick capture."""
    with simulated_rig(world, picture=None if drawn else sky_over_ground) as rig:
        text = rig.config_path.read_text()
        for section, keys in HASTE.items():
            text = text.replace(section + "\n", f"{section}\n{keys}\n")
        rig.config_path.write_text(text + ODD_JOBS)
        yield rig


@dataclass(frozen=True)
class Chain:
    """What one run through the whole chain left."""

    captured: Ended
    bundle: Path
    located: Ended
    picture: Path
    truth: dict[str, Any]


@pytest.fixture(scope="module")
def chain(world: World, tmp_path_factory: pytest.TempPathFactory) -> Chain:
    folder = tmp_path_factory.mktemp("chain")
    bundles, picture = folder / "bundles", folder / "fix.png"
    with hasty_rig(world, drawn=True) as rig:
        captured = call("rig", "capture", "--config", rig.config_path, "--out", bundles)
        assert captured.status == 0, captured.err
        (bundle,) = bundles.iterdir()
        located = call(
            *("localizer", "locate", bundle, "--dem", EMBEDDED_DEM, "--json"),
            *("--plot", picture, "--truth", rig.truth_path),
        )
    return Chain(captured, bundle, located, picture, world.truth_json())


class TestChain:
    def test_the_fix_is_within_a_cell_of_the_truth(self, chain: Chain) -> None:
        assert chain.located.status == 0, chain.located.err
        fix = Fix.model_validate_json(chain.located.out)
        outcome = judge(fix, chain.truth)
        assert (fix.status, outcome.wrong) == ("fix", False)
        assert outcome.error_m is not None
        assert outcome.error_m < CELL_M

    def test_readings_agree_with_the_truth_within_their_sigmas(self, chain: Chain) -> None:
        bundle = load_bundle(chain.bundle)
        assert {frame.label for frame in bundle.frames} == set("NESW")
        assert bundle.altitude is not None
        assert abs(bundle.altitude.value_m - chain.truth["altitude_m"]) < 4 * bundle.altitude.sigma_m
        for frame in bundle.frames:
            wanted_deg = {"N": 0.0, "E": 90.0, "S": 180.0, "W": 270.0}[frame.label]
            assert abs((frame.azimuth_deg - wanted_deg + 180.0) % 360.0 - 180.0) < 1.0

    def test_the_bundle_is_named_on_standard_output(self, chain: Chain) -> None:
        assert chain.captured.out == f"{chain.bundle}\n"

    def test_the_picture_is_drawn(self, chain: Chain) -> None:
        assert cv2.imread(str(chain.picture)) is not None


class TestBadBundles:
    @pytest.fixture
    def copy(self, chain: Chain, tmp_path: Path) -> Path:
        copy = tmp_path / chain.bundle.name
        (copy / "frames").mkdir(parents=True)
        for path in ("bundle.json", *(f"frames/{label}.png" for label in "NESW")):
            (copy / path).write_bytes((chain.bundle / path).read_bytes())
        return copy

    def test_a_missing_frame(self, copy: Path) -> None:
        (copy / "frames/E.png").unlink()
        call("localizer", "locate", copy, "--dem", EMBEDDED_DEM).assert_one_line("E.png")

    def test_a_changed_frame(self, copy: Path) -> None:
        data = (copy / "frames/S.png").read_bytes()
        (copy / "frames/S.png").write_bytes(data[:-1] + bytes([data[-1] ^ 1]))
        call("localizer", "locate", copy, "--dem", EMBEDDED_DEM).assert_one_line("S.png", "sha256")

    def test_an_altitude_outside_the_terrain_fits_nowhere(self, copy: Path) -> None:
        self._change(copy, lambda fields: fields["altitude"].update(value_m=8848.0))
        self._assert_fits_nowhere(copy)

    def test_frames_without_sky_fit_nowhere(self, copy: Path) -> None:
        rng = np.random.default_rng(1)
        ground = np.clip(rng.normal(90.0, 12.0, (480, 640, 3)), 0, 255).astype(np.uint8)
        for label in "NESW":
            assert cv2.imwrite(str(copy / f"frames/{label}.png"), ground)
        self._change(copy, lambda fields: None)
        self._assert_fits_nowhere(copy)

    def test_a_terrain_that_is_not_there(self, copy: Path) -> None:
        call("localizer", "locate", copy, "--dem", "no-such-terrain.tif").assert_one_line(
            "no-such-terrain.tif"
        )

    @staticmethod
    def _assert_fits_nowhere(bundle: Path) -> None:
        ended = call("localizer", "locate", bundle, "--dem", EMBEDDED_DEM, "--json")
        assert ended.status == NOWHERE, ended.err
        assert Fix.model_validate_json(ended.out).status == "none"

    @staticmethod
    def _change(bundle: Path, change: Any) -> None:
        fields = json.loads((bundle / "bundle.json").read_text())
        change(fields)
        for frame in fields["frames"]:
            frame["sha256"] = hashlib.sha256((bundle / frame["file"]).read_bytes()).hexdigest()
        (bundle / "bundle.json").write_text(json.dumps(fields))


@pytest.fixture(scope="module")
def rig(world: World) -> Iterator[SimulatedRig]:
    with hasty_rig(world, drawn=False) as rig:
        yield rig


class TestBadRigs:
    @pytest.mark.parametrize(
        ("pattern", "instead", "words"),
        [
            (r"mast_height_m = .*", "mast_heigth_m = 2.0", ["[rig] mast_heigth_m", "unknown key"]),
            (r'port = "[^"]*servo[^"]*"', 'port = "/dev/ttyNOSUCH"', ["/dev/ttyNOSUCH"]),
            (r'kind = "bmp390"', 'kind = "bmp388"', ["BMP388", "0x60"]),
            (r'model = "XM430-W350"', 'model = "XL430-W250"', ["XL430-W250", "XM430-W350"]),
            (r"address = 29", "address = 83", ["0x53"]),
            (r"id = 2", "id = 7", ["7"]),
            (r"stream\.mjpg", "nothing.mjpg", ["nothing.mjpg"]),
        ],
        ids=["key", "port", "chip identity", "servo model", "chip absent", "servo absent", "camera"],
    )
    def test_capture_says_in_one_line_what_is_wrong(
        self, rig: SimulatedRig, tmp_path: Path, pattern: str, instead: str, words: list[str]
    ) -> None:
        text, count = re.subn(pattern, instead, rig.config_path.read_text())
        assert count
        config, bundles = tmp_path / "rig.toml", tmp_path / "bundles"
        config.write_text(text)
        call("rig", "capture", "--config", config, "--out", bundles).assert_one_line(*words)
        assert not bundles.exists() or not list(bundles.iterdir())
        assert rig.pan.register("torque_enable") == 0
        assert rig.tilt.register("torque_enable") == 0

    def test_a_missing_configuration(self, tmp_path: Path) -> None:
        call("rig", "capture", "--config", tmp_path / "none.toml").assert_one_line("none.toml")


class TestInterrupted:
    @contextmanager
    def capturing(self, rig: SimulatedRig, bundles: Path) -> Iterator[subprocess.Popen[str]]:
        """A capture whose head moves."""
        command = [find_command("rig"), "capture", "--config", str(rig.config_path), "--out", str(bundles)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
            deadline_s = time.monotonic() + 30.0
            while not rig.pan.shaft()[1]:
                assert process.poll() is None
                assert time.monotonic() < deadline_s
                time.sleep(0.01)
            yield process

    def test_ctrl_c_leaves_the_head_safe_and_nothing_half_written(self, world: World, tmp_path: Path) -> None:
        bundles = tmp_path / "bundles"
        with hasty_rig(world, drawn=False) as rig, self.capturing(rig, bundles) as process:
            process.send_signal(signal.SIGINT)
            _, err = process.communicate(timeout=15)
            assert process.returncode == INTERRUPTED
            assert "Traceback" not in err
            assert [servo.register("torque_enable") for servo in (rig.pan, rig.tilt)] == [0, 0]
            assert not rig.pan.shaft()[1]
        assert not bundles.exists() or not list(bundles.iterdir())

    def test_the_head_stops_by_itself_when_the_host_dies(self, world: World, tmp_path: Path) -> None:
        with hasty_rig(world, drawn=False) as rig, self.capturing(rig, tmp_path) as process:
            process.kill()
            process.communicate()
            time.sleep(1.3)  # the watchdog of 1 s, and the way to a stop
            assert not rig.pan.shaft()[1]
            assert rig.pan.register("bus_watchdog") == -1


class TestSimRun:
    def test_a_command_that_does_not_exist(self) -> None:
        call("sim", "run", "--seed", "3", "--", "no-such-command").assert_one_line("no-such-command")

    def test_a_terrain_that_does_not_exist(self) -> None:
        call("sim", "run", "--dem", "none.tif", "--", "true").assert_one_line("none.tif")

    def test_a_scenario_with_an_unknown_key(self, tmp_path: Path) -> None:
        scenario = tmp_path / "scenario.toml"
        scenario.write_text("[servo]\nbacklsah_deg = 1.0\n")
        call("sim", "run", "--scenario", scenario, "--", "true").assert_one_line("servo.backlsah_deg")

    def test_the_command_has_the_configuration_and_its_status_is_returned(self) -> None:
        check = "import os, rig.config.load as c; c.load_config(c.config_path(None)); os._exit(7)"
        assert call("sim", "run", "--seed", "3", "--", sys.executable, "-c", check).status == 7


@pytest.mark.long
@pytest.mark.timeout(1800)
def test_ten_seeds_give_nine_fixes_within_a_cell_and_no_wrong_one(tmp_path: Path) -> None:
    """What the project promises of ``make demo``."""
    near = []
    for seed in range(1, 11):
        out = tmp_path / str(seed)
        ended = call("sim", "demo", "--seed", str(seed), "--out", out)
        print(f"seed {seed}: status {ended.status}\n{ended.out}")
        assert ended.status == 0, f"seed {seed}: {ended.out}{ended.err}"
        fix = Fix.model_validate_json((out / "fix.json").read_text())
        outcome = judge(fix, json.loads((out / "truth.json").read_text()))
        near.append(fix.status == "fix" and outcome.error_m is not None and outcome.error_m < CELL_M)
    assert sum(near) >= 9
