"""Through the commands, as a user would: every kind of device recorded on several rigs and played back to other commands."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.long

RIGS = [
    (1, "adxl355", "mmc5983ma", "bmp390"),
    (2, "iis2iclx", "hdg", "ms5611"),
    (3, "iis2iclx", "ptnthpr", "xdr"),
    (4, "adxl355", "ohpr", "vaisala-pa50"),
    (5, "iis2iclx", "mmc5983ma", "bmp388"),
    (6, "adxl355", "ths", "mda"),
]
COMMANDS = [("check",), ("watch", "--for", "4"), ("move", "--azimuth", "45")]


def ran(folder: Path, *words: object) -> subprocess.CompletedProcess[str]:
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    return subprocess.run(
        list(map(str, words)),
        cwd=folder,
        env={**os.environ, "PATH": path},
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command[0])
@pytest.mark.parametrize(("seed", "inclinometer", "compass", "altimeter"), RIGS)
def test_what_was_recorded_repeats_itself(
    tmp_path: Path, command: tuple[str, ...], seed: int, inclinometer: str, compass: str, altimeter: str
) -> None:
    (tmp_path / "fitted.toml").write_text(
        f'[inclinometer]\nchip = "{inclinometer}"\n[compass]\nkind = "{compass}"\n[altimeter]\nkind = "{altimeter}"\n'
    )
    rig = "sim", "run", "--seed", seed, "--scenario", "fitted.toml", "--", "rig", "record", "x.log"
    recorded = ran(tmp_path, *rig, *command, "--json")
    assert recorded.returncode == 0, recorded.stderr
    for _ in range(2):
        again = ran(tmp_path, "sim", "replay", "x.log", "--", "rig", *command, "--json")
        assert again.returncode == 0, again.stderr
        if command[0] == "check":
            then, now = (json.loads(each.stdout)["devices"] for each in (recorded, again))
            for device, played in zip(then[:4], now[:4], strict=True):  # the camera is grey
                for key, value in device["values"].items():
                    if isinstance(value, float) and "noise" not in key and key != "answer_ms":
                        assert played["values"][key] == pytest.approx(value, rel=1e-3, abs=0.3), key
        elif command[0] == "move":
            then, now = (json.loads(each.stdout) for each in (recorded, again))
            assert now["azimuth_deg"] == pytest.approx(then["azimuth_deg"], abs=0.5)
            assert now["ticks"] == pytest.approx(then["ticks"], abs=3)
