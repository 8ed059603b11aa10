"""``rig bundle list``, ``show``, ``verify``."""

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from localizer.bundle import BundleError, Camera
from rig.bundle_commands import bundle
from rig.bundle_writer import FrameRecord, Measurement, write_bundle
from rig.clock import utc_now

FAULT = {"device": "camera", "problem": "was black", "action": "tried again", "count": 2}


@pytest.fixture
def written(tmp_path: Path) -> Path:
    image = np.random.default_rng(1).integers(0, 256, (48, 64, 3), np.uint8)
    raw = {"skyline": {"share": 0.97}}
    frame = FrameRecord("N", image, utc_now(), 0.1, 0.1, 5.0, 0.01, -0.3, 0.02, raw)
    camera = Camera(width_px=64, height_px=48, fx_px=50.0, fy_px=50.0, cx_px=31.5, cy_px=23.5)
    return write_bundle(
        tmp_path, Measurement(utc_now(), camera, 2.0, None, 1.0, 0.02, [frame], {"faults": [FAULT]}, {})
    )


def run(*arguments: str | Path) -> Result:
    return CliRunner().invoke(bundle, [str(each) for each in arguments], standalone_mode=False)


def test_a_bundle_is_shown_with_the_faults_that_were_overcome(written: Path) -> None:
    out = run("show", written).output
    assert "altitude not measured" in out
    assert "N: azimuth 0.10, tilt 5.00, roll -0.30 deg, skyline in 97% of the columns" in out
    assert "overcome: camera: was black; tried again (2 times)" in out
    assert json.loads(run("show", written, "--json").output)["faults"] == [FAULT]


def test_bundles_are_numbered_and_a_damaged_one_is_named(written: Path) -> None:
    listed = run("list", written.parent)
    assert listed.return_value == 0
    assert f"   1  {written.name}" in listed.output
    assert "1 kinds of faults overcome" in listed.output
    (written / "frames" / "N.png").write_bytes(b"x")
    listed = run("list", written.parent, "--json")
    assert listed.return_value == 2
    assert "checksum" in json.loads(listed.output)[0]["problem"]
    assert isinstance(run("list", written / "none").exception, BundleError)


def test_verify(written: Path) -> None:
    assert run("verify", written).return_value == 0
    (written / "frames" / "N.png").unlink()
    assert run("verify", written, written).return_value == 2
