"""A series whose process is killed repeatedly, as by power cuts, ends with every number taken once."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from fakes.simulated import quick_rig, world

from localizer.bundle import load_bundle
from rig.bundle.summary import bundles_in
from rig.series.journal import load_series
from rig.telemetry.reader import TelemetryFile, TelemetryReadError

BUNDLES = 8
KILLS = 5


@pytest.mark.long
def test_a_series_that_is_killed_again_and_again(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    with quick_rig(world(), tmp_path) as quick:
        ahead_deg = round(quick.world.mechanics.base.heading_deg)
        directions = ",".join(str((ahead_deg + aside_deg) % 360) for aside_deg in (-25, 25))
        command = [str(Path(sys.executable).with_name("rig")), "capture", "--out", str(tmp_path / "out")]
        command += ["--directions", directions, "--repeat", str(BUNDLES), "--json"]
        command += ["--telemetry", str(tmp_path / "session.mcap")]
        environment = {**os.environ, **quick.rig.environment}
        killed, status = 0, None
        while status is None:
            process = subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL)
            if killed < KILLS:
                time.sleep(float(rng.uniform(4.0, 16.0)))
                process.send_signal(signal.SIGKILL)
                killed += process.wait() == -signal.SIGKILL
                status = None if process.returncode == -signal.SIGKILL else process.returncode
            else:
                status = process.wait()
    assert killed >= 1
    (folder,) = (tmp_path / "out").iterdir()
    series = load_series(folder)
    assert series.ended
    outcomes = [series.outcomes[number] for number in range(1, BUNDLES + 1)]
    taken = [outcome for outcome in outcomes if outcome.bundle]
    assert len(taken) >= BUNDLES // 2, "a busy computer may have a capture fail, and the record says why"
    assert all(outcome.bundle or outcome.reason for outcome in outcomes)
    assert status == (0 if len(taken) == BUNDLES else 2)
    bundles = bundles_in(series.bundles)
    assert [outcome.bundle for outcome in taken] == [path.name for path in bundles]
    for outcome, path in zip(taken, bundles, strict=True):
        assert load_bundle(path).model_extra["raw"]["series"] == {"id": series.id, "number": outcome.number}
    assert sorted(path.name for path in series.bundles.iterdir()) == [path.name for path in bundles]
    assert len(list((folder / "previews").iterdir())) == len(taken)
    assert json.loads((folder / "summary.json").read_text())["taken"] == len(taken)
    problems = []
    for path in tmp_path.glob("session*.mcap"):
        session = TelemetryFile(path)
        with contextlib.suppress(TelemetryReadError):  # killed before its first second was written
            assert sum(1 for _ in session) > 0
            problems.append(session.problem)
    assert None in problems
    assert any(problems), "a killed process leaves a file that is cut off, and readable"
