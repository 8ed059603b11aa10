"""Bundles are complete or absent."""

import json
import os
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from localizer.bundle import Altitude, BundleError, Camera, frame_image, load_bundle
from rig.bundle import writer
from rig.bundle.writer import BundleWriteError, FrameRecord, Measurement, require_writable, write_bundle

CREATED = datetime(2026, 11, 23, 4, 31, 51, 250000, tzinfo=UTC)
CAMERA = Camera(width_px=64, height_px=48, fx_px=50.0, fy_px=50.0, cx_px=31.5, cy_px=23.5)


def frame(label: str, azimuth_deg: float = 0.12) -> FrameRecord:
    image = np.random.default_rng(1).integers(0, 256, (48, 64, 3), np.uint8)
    return FrameRecord(
        label,
        image,
        CREATED,
        azimuth_deg,
        0.1,
        4.98,
        0.01,
        -0.31,
        0.02,
        {"ticks": [2048, 2100], "note": None},
    )


def measurement(*frames: FrameRecord, altitude: Altitude | None = None) -> Measurement:
    return Measurement(
        created=CREATED,
        camera=CAMERA,
        mast_height_m=2.0,
        altitude=altitude,
        azimuth_bias_sigma_deg=0.5,
        tilt_bias_sigma_deg=0.02,
        frames=frames,
        raw={"pressure_hpa": 853.2},
        calibration={"declination_deg": 13.1},
    )


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    north, corner = frame("N"), frame("A222.5", 222.5)
    written = write_bundle(
        tmp_path, measurement(north, corner, altitude=Altitude(value_m=1432.6, sigma_m=5.0))
    )
    bundle = load_bundle(written)
    assert written.parent == tmp_path
    assert bundle.id == written.name
    assert written.name.startswith("20261123T043151Z-")
    assert len(written.name) == len("20261123T043151Z-3f9a")
    assert [f.file for f in bundle.frames] == ["frames/N.png", "frames/A222.5.png"]
    np.testing.assert_array_equal(frame_image(bundle, bundle.frames[0]), north.image_bgr)
    content = json.loads((written / "bundle.json").read_text())
    assert content["schema"] == "skyfix.bundle/1"
    assert content["created"] == "2026-11-23T04:31:51Z"
    assert content["raw"] == {"pressure_hpa": 853.2}
    assert content["calibration"] == {"declination_deg": 13.1}
    assert content["frames"][0]["raw"]["ticks"] == [2048, 2100]
    assert content["altitude"] == {"value_m": 1432.6, "sigma_m": 5.0}
    assert "prior" not in content


def test_no_altimeter(tmp_path: Path) -> None:
    assert load_bundle(write_bundle(tmp_path, measurement(frame("N")))).altitude is None


@pytest.mark.parametrize("azimuth_deg", [-1e-15, 360.0, 359.99999999, -0.0])
def test_north_is_zero(tmp_path: Path, azimuth_deg: float) -> None:
    assert (
        load_bundle(write_bundle(tmp_path, measurement(frame("N", azimuth_deg)))).frames[0].azimuth_deg == 0.0
    )


def test_the_folder_is_made(tmp_path: Path) -> None:
    assert write_bundle(tmp_path / "a" / "b", measurement(frame("N"))).is_dir()


def test_nothing_is_left_when_interrupted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(path: Path) -> None:
        assert (path / "bundle.json").exists()
        raise KeyboardInterrupt

    monkeypatch.setattr(writer, "load_bundle", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_bundle(tmp_path, measurement(frame("N")))
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_left_when_the_disk_is_full(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(
        BundleWriteError, match=r"cannot be written: No space left on device; choose another with --out"
    ):
        write_bundle(tmp_path, measurement(frame("N")))
    assert list(tmp_path.iterdir()) == []


def test_an_invalid_bundle_does_not_appear(tmp_path: Path) -> None:
    wrong_size = Measurement(
        **{**vars(measurement(frame("N"))), "camera": CAMERA.model_copy(update={"width_px": 65})}
    )
    with pytest.raises(BundleError, match="64 x 48 px"):
        write_bundle(tmp_path, wrong_size)
    assert list(tmp_path.iterdir()) == []


def test_where_bundles_cannot_go(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("")
    with pytest.raises(
        BundleWriteError, match=r"file/bundles: .*/file is not a directory; choose another with --out"
    ):
        require_writable(file / "bundles")
    with pytest.raises(BundleWriteError, match="cannot be written: Not a directory"):
        write_bundle(file / "bundles", measurement(frame("N")))
    require_writable(tmp_path / "not" / "yet")
    assert not (tmp_path / "not").exists()


def test_no_permission(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    with pytest.raises(BundleWriteError, match="no permission to write in"):
        require_writable(tmp_path)


def test_a_disk_that_is_nearly_full_is_told_before_anything_is_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("shutil.disk_usage", lambda path: SimpleNamespace(free=3_000_000))
    with pytest.raises(BundleWriteError, match=r"only 3\.0 MB are free, a bundle may need 20; make room"):
        require_writable(tmp_path / "bundles")
    assert not list(tmp_path.iterdir())


IN_A_SMALL_DISK = """
set -e
mount -t tmpfs -o size={size},mode=700 none {folder}
cd {root}
exec {python} -c '
import sys; sys.path[:0] = ["tests/rig", "tests/rig/bundle"]
import pathlib, test_writer as t
try:
    t.write_bundle(pathlib.Path("{folder}"), t.measurement(t.frame("N"), t.frame("E", 90.0)))
except t.BundleWriteError as error:
    print(error)
print(sorted(path.name for path in pathlib.Path("{folder}").iterdir()))
'
"""


def test_a_disk_that_is_full_leaves_nothing_half_written(tmp_path: Path) -> None:
    script = IN_A_SMALL_DISK.format(
        size="8k", folder=tmp_path, root=Path(__file__).parents[3], python=sys.executable
    )
    done = subprocess.run(["unshare", "-rm", "sh", "-c", script], capture_output=True, text=True, check=False)
    if "unshare" in done.stderr or "mount" in done.stderr:
        pytest.skip("this machine lets nobody mount a file system of his own")
    assert done.returncode == 0, done.stderr
    assert "No space left on device" in done.stdout
    assert done.stdout.splitlines()[-1] == "[]"
