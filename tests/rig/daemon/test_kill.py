"""The power fails at any instant: what was measured is there afterwards, complete, and nothing else is.

``pytest tests/rig/daemon/test_kill.py -m long`` kills the spool's user 200 times and the whole daemon 30 times.
"""

import os
import signal
import time
import traceback
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from fakes import search_worker
from fakes.daemon import LONG_PATIENCE_S, add_keys, running_daemon
from fakes.simulated import quick_rig, world

from localizer.bundle import Camera, load_bundle
from localizer.fix import Fix
from localizer.track.odometry import Movement
from localizer.track.tracker import Tracker
from rig.bundle.writer import FrameRecord, Measurement, write_bundle
from rig.clock import Instant
from rig.daemon.spool.store import Spool
from rig.daemon.state import Answer
from sim.commands.options import EMBEDDED_DEM

KILLS_OF_THE_SPOOL, KILLS_OF_THE_DAEMON = 200, 30
QUOTA_MB = 10
LONGEST_LIFE_S = 0.5


def measurement(rng: np.random.Generator) -> Measurement:
    """One frame, so many bytes that the quota has something to do."""
    now = datetime.now(UTC)
    image = rng.integers(0, 256, (480, 640, 3), np.uint8)
    frame = FrameRecord("N", image, now, 0.1, 0.1, 5.0, 0.01, 0.0, 0.02, {})
    camera = Camera(width_px=640, height_px=480, fx_px=500.0, fy_px=500.0, cx_px=319.5, cy_px=239.5)
    return Measurement(now, camera, 2.0, None, 0.5, 0.02, [frame], {}, {})


def answer_for(bundle: str) -> Answer:
    fix = Fix.model_validate({**search_worker.NO_FIX, "bundle": bundle})
    return Answer(bundle, Instant.now(), Instant.now(), "rest", fix, "whole DEM", (), 1.0, None, None, None)


def live(folder: Path, written: int, seed: int) -> None:
    """Capture and locate until killed. What is reported through ``written`` must never be lost."""
    rng = np.random.default_rng(seed)
    with Spool(folder, QUOTA_MB) as spool:
        while True:
            while entry := spool.next_waiting():
                tracker, _ = spool.tracker_for(entry)
                counted = tracker.model_copy(update={"look_evidence": tracker.look_evidence + 1.0})
                spool.set_answer(answer_for(entry.bundle), counted)
            spool.make_room()
            spool.begin_capture("rest", Movement(np.array([1.0, 2.0]), np.eye(2)))
            bundle = write_bundle(spool.bundles_dir, measurement(rng))
            os.write(written, f"{bundle.name}\n".encode())
            spool.end_capture()


def lives(folder: Path, seed: int, life_s: float) -> list[str]:
    """Run a process for that time; returns the bundles that it reported."""
    heard, written = os.pipe()
    pid = os.fork()
    if pid == 0:
        try:
            os.close(heard)
            live(folder, written, seed)
        except BaseException:  # noqa: BLE001 - a child of the tests must not go on as the tests
            traceback.print_exc()
            os._exit(3)
    os.close(written)
    time.sleep(life_s)
    os.kill(pid, signal.SIGKILL)
    _, status = os.waitpid(pid, 0)
    assert os.WIFSIGNALED(status), "it ended by itself: see the traceback"
    with os.fdopen(heard) as told:
        return told.read().split()


def assert_consistent(folder: Path, told: set[str]) -> None:
    """Index and folder agree, every bundle is complete, every reported one exists."""
    with Spool(folder, QUOTA_MB) as spool:
        entries = {entry.bundle: entry for entry in spool.entries(10_000)}
        here = {path.name for path in spool.bundles_dir.iterdir()}
        assert here == {name for name, entry in entries.items() if entry.here}
        for name in here:
            assert load_bundle(spool.bundles_dir / name).id == name
        for name in told:
            entry = entries[name]
            assert entry.here or entry.state == "located", f"{name} is lost"
        located = [entry for entry in entries.values() if entry.state == "located"]
        assert all(entry.answer is not None for entry in located)
        state = spool.recall("tracker")
        evidence = Tracker.from_json(state).look_evidence if state else 0.0
        assert evidence == len(located), "an answer without its track, or a track without its answer"


@pytest.mark.long
@pytest.mark.timeout(0)
def test_a_spool_whose_user_is_killed_is_whole(tmp_path: Path) -> None:
    rng, told = np.random.default_rng(1), set[str]()
    for number in range(KILLS_OF_THE_SPOOL):
        told |= set(lives(tmp_path, number, float(rng.uniform(0.0, LONGEST_LIFE_S))))
        assert_consistent(tmp_path, told)
    assert len(told) > KILLS_OF_THE_SPOOL / 4  # it did get to work
    print(f"{KILLS_OF_THE_SPOOL} kills, {len(told)} bundles")


@pytest.fixture
def hectic_rig(tmp_path: Path) -> Iterator[Path]:
    """The configuration of a simulated rig that is to capture without a pause."""
    with quick_rig(world(), tmp_path, dem_paths=[EMBEDDED_DEM]) as quick:
        ahead_deg = round(quick.world.mechanics.base.heading_deg)
        add_keys(quick.rig.config_path, "capture", directions=[ahead_deg, (ahead_deg + 25) % 360])
        add_keys(quick.rig.config_path, "run", every_s=0.1, retry_most_s=1.0)
        yield quick.rig.config_path
        assert quick.torques == [0, 0]


@pytest.mark.long
@pytest.mark.timeout(0)
def test_a_daemon_that_is_killed_is_followed_by_one_that_picks_up_everything(
    hectic_rig: Path, tmp_path: Path
) -> None:
    rng, complete = np.random.default_rng(2), set[str]()
    for _ in range(KILLS_OF_THE_DAEMON):
        with running_daemon(hectic_rig, tmp_path / "log", patience_s=LONG_PATIENCE_S) as daemon:
            daemon.until(lambda status: status["activity"] == "capturing", "capturing")
            time.sleep(float(rng.uniform(0.0, 12.0)))
            daemon.stop(signal.SIGKILL)
        bundles = daemon.spool / "bundles"
        visible = {path.name for path in bundles.iterdir() if not path.name.startswith(".")}
        assert complete <= visible
        for name in visible - complete:
            assert load_bundle(bundles / name).id == name
        complete = visible
    hectic_rig.write_text(hectic_rig.read_text().replace("every_s = 0.1", "every_s = 3600.0"))
    with running_daemon(hectic_rig, tmp_path / "log", patience_s=LONG_PATIENCE_S) as daemon:
        daemon.until_idle(answers=1)
        assert daemon.stop() == 0
    with Spool(daemon.spool, 2000) as spool:
        entries = {entry.bundle: entry for entry in spool.entries(10_000)}
        assert complete <= set(entries)
        assert {path.name for path in bundles.iterdir()} == set(entries)
        assert {entry.state for entry in entries.values()} == {"located"}
    assert complete
    print(f"{KILLS_OF_THE_DAEMON} kills, {len(entries)} bundles")
