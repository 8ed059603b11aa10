"""Many captures with random faults on one machine: no partial bundle, nothing leaked, no failure without an explanation.

``--captures N`` says how many; ``pytest tests/faults/test_soak.py -m long --captures 20 -s`` is a quick look.
"""

import json
import os
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fakes.simulated import open_descriptors, quick_rig, threads, world

from localizer.bundle import load_bundle
from localizer.errors import SkyfixError
from sim.faults.catalogue import CATALOGUE, DEVICES
from sim.faults.script import parse_faults

FITTINGS: tuple[dict[str, str], ...] = (
    {},
    {"compass": "hdg", "altimeter": "xdr"},
    {"inclinometer": "iis2iclx", "altimeter": "ms5611"},
)
FAULTS = 3
LONGEST_S = 60.0
TELL_EVERY = 25
LEAKS_OF_LIBRARIES = 3


def random_faults(rng: np.random.Generator, fitted: dict[str, str]) -> list[dict[str, Any]]:
    """None to three faults at random times of a capture, most of them short."""
    entries = []
    for _ in range(rng.integers(FAULTS + 1)):
        device = str(rng.choice([name for name in DEVICES if name != "disk"]))
        groups = DEVICES[device]
        group = groups[-1] if fitted.get(device, "") in ("hdg", "xdr") else groups[0]
        name = str(rng.choice(list(CATALOGUE[group])))
        kind = CATALOGUE[group][name]
        entry: dict[str, Any] = {
            "at": round(float(rng.uniform(0.0, 3.0)), 3),
            "device": device,
            "fault": name,
        }
        if kind.lasts and rng.random() < 0.8:
            entry["for"] = round(float(rng.uniform(0.05, 1.0)), 3)
        if "share" in kind.parameters:
            entry["share"] = round(float(rng.uniform(0.1, 1.0)), 2)
        entries.append(entry)
    cameras = [entry for entry in entries if entry["device"] == "camera"]
    # One fault of each kind at a time is what FaultyPictures can undo.
    return [e for e in entries if e not in cameras[1:]]


@pytest.mark.long
@pytest.mark.timeout(0)
def test_soak(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rig.devices.bus.retry.REPLUG_S", 2.0)
    monkeypatch.setattr("rig.capture.pictures.take.TIME_LIMIT_S", 4.0)
    rng = np.random.default_rng(int(request.config.getoption("--soak-seed")))
    ends: Counter[str] = Counter()
    longest_s, descriptors, running = 0.0, 0, threads()
    for number in range(int(request.config.getoption("--captures"))):
        fitted = FITTINGS[number % len(FITTINGS)]
        entries = random_faults(rng, fitted)
        where = f"capture {number}: {entries}"
        folder = tmp_path / str(number)
        begun_s = time.monotonic()
        with quick_rig(world(**fitted), folder, parse_faults(entries)) as quick:
            monkeypatch.setenv("SKYFIX_CLOCK_OFFSET", str(quick.rig.stage.clock_file))
            bundle_dir, failure = None, None
            try:
                bundle_dir = quick.capture()
            except SkyfixError as error:
                failure = error
            if failure is not None:
                assert failure.exit_status == 2, where
                assert "\n" not in str(failure), where
                assert entries, f"{where}: failed without a fault: {failure}"
                assert quick.left_over() == [], where
                ends["refused"] += 1
            elif bundle_dir is not None:
                load_bundle(bundle_dir)
                assert quick.left_over() == [bundle_dir.name], where
                notes = json.loads((bundle_dir / "bundle.json").read_text())["raw"]["faults"]
                ends["noted" if notes else "clean"] += 1
            time.sleep(0.0 if quick.is_safe else 0.6)  # the bus watchdog's time
            assert quick.is_safe, where
        took_s = time.monotonic() - begun_s
        longest_s = max(longest_s, took_s)
        assert took_s < LONGEST_S, where
        settle(running)
        assert threads() == running, where
        if number == len(FITTINGS):  # libraries are loaded by then
            descriptors = open_descriptors()
        if number > len(FITTINGS):
            assert open_descriptors() <= descriptors + LEAKS_OF_LIBRARIES, where
        if (number + 1) % TELL_EVERY == 0:
            print(f"soak: {number + 1} captures, {dict(ends)}, longest {longest_s:.1f} s", flush=True)
    print(f"\nsoak: {dict(ends)}, longest {longest_s:.1f} s, {os.times().user:.0f} s of CPU")


def settle(running: list[str]) -> None:
    """A camera that is being opened when a capture ends takes its timeout to notice."""
    deadline_s = time.monotonic() + 5.0
    while threads() != running and time.monotonic() < deadline_s:
        time.sleep(0.05)
