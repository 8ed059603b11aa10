"""Every fault of the simulator, for a moment and for good, against what docs/faults.md says about it."""

import json
import math
import re
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from fakes.simulated import Quick, open_descriptors, quick_rig, threads, world

import rig.capture.base_attitude
import rig.capture.sequence
import rig.capture.view
from localizer.bundle import load_bundle
from localizer.errors import SkyfixError
from rig.attitude.kinematics import wrapped_deg
from rig.devices.pan_tilt import PanTilt
from sim.faults.catalogue import CATALOGUE, DEVICES
from sim.faults.injector import steps
from sim.faults.script import Fault, parse_faults
from sim.launch.child_command import find_command

MATRIX = Path(__file__).parents[2] / "docs" / "faults.md"
FITTED = {"compass: a talker": {"compass": "hdg"}, "altimeter: a talker": {"altimeter": "xdr"}}
MOMENT_S = 0.6
QUICK = {  # shown by default, on a faster clock; the others take minutes together
    "servo-bus unplugged moment",
    "pan reboot good",
    "camera black moment",
    "camera frozen good",
    "disk read-only good",
}
TRIGGERS: dict[str, tuple[Any, str, int]] = {
    "servo-bus": (PanTilt, "wait_settled", 2),
    "pan": (PanTilt, "wait_settled", 2),
    "tilt": (PanTilt, "wait_settled", 2),
    "inclinometer": (rig.capture.base_attitude, "still_level", 2),
    "compass": (rig.capture.base_attitude, "still_level", 2),
    "altimeter": (rig.capture.sequence, "_altitude", 1),
    "camera": (rig.capture.view, "take_pictures", 2),
    "clock": (rig.capture.view, "take_pictures", 2),
}
"""Which call of which function of the rig the fault begins at."""

BEFORE_THE_HEAD_TURNS = (rig.capture.sequence, "aim_and_take", 2)
OLD_PICTURES = ("frozen", "stale")
SMALLER = {"width_px": 80, "height_px": 60}
PARAMETERS: dict[str, dict[str, float]] = {
    "resolution": SMALLER,
    "stale": {"seconds": 3.0},
    "blurred": {"sigma_px": 2.5},
}


@dataclass(frozen=True)
class Case:
    """One cell of the matrix."""

    device: str
    fault: str
    lasting: str
    cell: str

    @property
    def name(self) -> str:
        return f"{self.device} {self.fault} {self.lasting}"

    @property
    def ends(self) -> set[str]:
        return set(self.cell.split(":")[0].split("`")[0].strip().split(" or "))

    @property
    def words(self) -> list[str]:
        return re.findall(r"`([^`]+)`", self.cell)

    def parsed(self) -> Fault:
        """What a script would say."""
        entry = {"at": 0.0, "device": self.device.split(":")[0], "fault": self.fault}
        return parse_faults([entry | PARAMETERS.get(self.fault, {})])[0]


def matrix() -> Iterator[Case]:
    device = ""
    for line in MATRIX.read_text(encoding="utf-8").splitlines():
        if line.startswith("## "):
            device = line.removeprefix("## ")
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if len(cells) != 4 or device.split(":")[0] not in DEVICES or cells[0] in ("fault", "---"):
            continue
        yield Case(device, cells[0], "moment", cells[2])
        yield Case(device, cells[0], "good", cells[3])


CASES = list(matrix())


def parameters() -> Iterator[Any]:
    for case in CASES:
        if case.cell != "-":
            yield pytest.param(case, id=case.name, marks=() if case.name in QUICK else pytest.mark.long)


def test_the_matrix_is_complete() -> None:
    known = set()
    for device, groups in DEVICES.items():
        for group in groups:
            heading = f"{device}: a {group}" if len(groups) > 1 else device
            known |= {(heading, fault, kind.lasts) for fault, kind in CATALOGUE[group].items()}
    told = {(case.device, case.fault) for case in CASES}
    assert told == {(device, fault) for device, fault, _ in known}
    for case in CASES:
        lasts = (case.device, case.fault, True) in known
        assert (case.cell == "-") == (case.lasting == "moment" and not lasts), case.name
        assert case.cell == "-" or case.ends <= {"noted", "refused", "harmless"}, case.name
    assert {case.name for case in CASES} >= QUICK


def test_what_the_page_names_is_there() -> None:
    root = Path(__file__).parents[2]
    page = (root / "docs" / "faults.md").read_text(encoding="utf-8")
    for named in re.findall(r"(?<![\w/])(?:tests|rig|sim)/[\w/]+(?:\.py)?", page):
        assert (root / named).exists(), named
    defined = "\n".join(file.read_text(encoding="utf-8") for file in (root / "tests").rglob("test_*.py"))
    for test in re.findall(r"\btest_\w+(?!\w|\.py)", page):
        assert f"def {test}(" in defined, test


def begin_at(case: Case, quick: Quick, patch: pytest.MonkeyPatch) -> list[threading.Timer]:
    """Let the fault begin in the middle of a capture, and end after a moment or not at all."""
    fault = case.parsed()
    begin, end = steps(quick.rig.stage, fault)
    old = fault.device == "camera" and fault.fault in OLD_PICTURES
    target, name, number = BEFORE_THE_HEAD_TURNS if old else TRIGGERS[fault.device]
    inner: Callable[..., Any] = getattr(target, name)
    calls = [0]
    timers: list[threading.Timer] = []

    def outer(*arguments: Any, **keywords: Any) -> Any:
        calls[0] += 1
        if calls[0] == number:
            begin()
            if case.lasting == "moment":
                timers.append(threading.Timer(MOMENT_S / quick.speed, end))
                timers[0].start()
        return inner(*arguments, **keywords)

    patch.setattr(target, name, outer)
    return timers


@pytest.mark.timeout(60)
@pytest.mark.parametrize("case", [p for p in parameters() if p.values[0].device != "disk"])
def test_fault(case: Case, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rig.devices.bus.retry.REPLUG_S", 2.0)
    monkeypatch.setattr("rig.capture.pictures.take.TIME_LIMIT_S", 5.0)
    truth = world(**FITTED.get(case.device, {}))
    open_before, threads_before = open_descriptors(), threads()
    with quick_rig(truth, tmp_path, in_this_process=case.name in QUICK) as quick:
        monkeypatch.setenv("SKYFIX_CLOCK_OFFSET", str(quick.rig.stage.clock_file))
        timers = begin_at(case, quick, monkeypatch)
        message, status, bundle_dir = "", 0, None
        try:
            bundle_dir = quick.capture()
        except SkyfixError as error:
            message = str(error)
            status = error.exit_status
        for timer in timers:
            timer.join()
        assert_safe(quick, message)
    assert threads() == threads_before
    assert open_descriptors() <= open_before + 2  # libraries that were loaded meanwhile
    if bundle_dir is None:
        assert quick.left_over() == []
        assert status == 2
        assert "refused" in case.ends, message
        assert_says(case, message)
        return
    assert quick.left_over() == [bundle_dir.name]
    notes = json.loads((bundle_dir / "bundle.json").read_text())["raw"]["faults"]
    assert case.ends & ({"noted", "harmless"} if notes else {"harmless"}), notes
    if notes and "harmless" not in case.ends:
        assert_says(case, " | ".join(f"{n['device']}: {n['problem']}; {n['action']}" for n in notes))
    assert_true(bundle_dir, truth)


def assert_says(case: Case, said: str) -> None:
    assert "\n" not in said
    for word in case.words:
        assert word in said


def assert_safe(quick: Quick, message: str) -> None:
    """Torque off; or, if that was impossible, stationary with a message that says so."""
    deadline_s = time.monotonic() + 1.0  # the bus watchdog of these tests is 0.4 s
    while not quick.is_safe:
        assert time.monotonic() < deadline_s, "the head moves"
        time.sleep(0.05)
    assert (
        quick.torques == [0, 0] or "torque could not be switched off: switch the servo power off" in message
    )


def assert_true(bundle_dir: Path, truth: Any) -> None:
    """What was measured in spite of the fault is right."""
    bundle = load_bundle(bundle_dir)
    standing = json.loads((bundle_dir / "bundle.json").read_text())["calibration"]
    base = truth.mechanics.base
    off_deg = wrapped_deg(standing["heading"]["heading_deg"] - base.heading_deg)
    assert abs(off_deg) < 5 * standing["heading"]["sigma_deg"]
    for name, true_deg in (("pitch_deg", base.pitch_deg), ("roll_deg", base.roll_deg)):
        assert standing["level"][name] == pytest.approx(
            true_deg, abs=max(0.1, 5 * standing["level"]["sigma_deg"])
        )
    assert bundle.altitude is not None
    assert abs(bundle.altitude.value_m - truth.place.altitude_m) < 5 * bundle.altitude.sigma_m
    for frame in bundle.frames:
        assert math.isfinite(frame.tilt_deg)


@pytest.mark.timeout(60)
@pytest.mark.parametrize("case", [p for p in parameters() if p.values[0].device == "disk"])
def test_fault_of_the_disk(case: Case, tmp_path: Path) -> None:
    """Over the real command: a full disk is its resource limit."""
    entry: dict[str, Any] = {"at": 0.5, "device": "disk", "fault": case.fault}
    entry |= {"largest_file_bytes": 4000} if case.fault == "full" else {}
    entry |= {"for": 0.3} if case.lasting == "moment" else {}
    with quick_rig(world(), tmp_path, parse_faults([entry])) as quick:
        command = [
            find_command("rig"),
            "capture",
            "--config",
            str(quick.rig.config_path),
            "--directions",
            "N",
        ]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
            quick.rig.stage.command_started(process.pid)
            out, err = process.communicate(timeout=50)
        assert quick.torques == [0, 0]
    if case.ends == {"harmless"}:
        assert process.returncode == 0, err
        assert quick.left_over() == [Path(out.strip()).name]
        return
    assert process.returncode == 2
    assert out == ""
    assert_says(case, err.splitlines()[-1])
    assert quick.left_over() == []
