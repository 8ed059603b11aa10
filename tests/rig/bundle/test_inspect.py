"""``rig bundle list``, ``show``, ``verify``, ``export``, ``import``."""

import csv
import hashlib
import io
import json
import os
import tarfile
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner, Result
from fakes.bundle import FAULT, write_one

from localizer.bundle import BundleError, load_bundle
from rig.bundle.archive import ArchiveError, write_archive
from rig.commands.bundle import bundle


@pytest.fixture
def written(tmp_path: Path) -> Path:
    return write_one(tmp_path / "bundles")


def run(*arguments: str | Path) -> Result:
    return CliRunner().invoke(bundle, [str(each) for each in arguments], standalone_mode=False)


def refused(*arguments: str | Path) -> str:
    """The message that a command ends with."""
    error = run(*arguments).exception
    assert isinstance(error, BundleError | ArchiveError)
    return str(error)


def test_a_bundle_is_shown_with_how_it_stood_and_the_faults_that_were_overcome(written: Path) -> None:
    out = run("show", written).output
    assert "altitude not measured" in out
    assert "number 7 of series-20261124T150000Z-3f9a" in out
    assert "vehicle: heading 162.25, pitch 1.50, roll -0.50 deg" in out
    assert "N: azimuth 0.10, tilt 5.00, roll -0.30 deg, skyline in 97% of the columns" in out
    assert "servos 12.1/12 V, 31/33 °C" in out
    assert "overcome: camera: was black; tried again (2 times)" in out
    assert json.loads(run("show", written, "--json").output)["faults"] == [FAULT]


def test_a_picture_of_a_bundle_shows_the_skyline_found(written: Path, tmp_path: Path) -> None:
    picture = tmp_path / "look.png"
    assert run("show", written, "--picture", picture).exit_code == 0
    image = cv2.imread(str(picture)).astype(int)
    header, height = image.shape[0] - 480 - 32, 480
    row = header + round((19.5 + 0.5) / 48 * height)
    line = image[row - 12 : row + 12, 40:600]
    reddest = (line[..., 2] - line[..., 1]).max(axis=0)
    assert np.mean(reddest > 100) > 0.9, "the edge between row 19 and row 20 is drawn in red"
    assert "no picture format" in str(run("show", written, "--picture", tmp_path / "x.gif").exception)


def test_bundles_of_other_writers_are_shown(written: Path) -> None:
    file = written / "bundle.json"
    document = json.loads(file.read_text())
    del document["raw"], document["calibration"], document["frames"][0]["raw"]
    file.write_text(json.dumps(document))
    for command in ("show", "list"):
        assert run(command, written).exit_code == 0


def test_bundles_are_numbered_and_a_damaged_one_is_named(written: Path) -> None:
    listed = run("list", written.parent)
    assert listed.return_value == 0
    assert f"   1  {written.name}" in listed.output
    assert "  1 kind of fault overcome" in listed.output
    (written / "frames" / "N.png").write_bytes(b"x")
    listed = run("list", written.parent, "--json")
    assert listed.return_value == 2
    assert "checksum" in json.loads(listed.output)["problem"]
    assert "is no folder" in refused("list", written / "none")


def test_bundles_below_a_folder_are_found_but_not_those_being_written(written: Path) -> None:
    deeper = write_one(written.parent / "series-x" / "bundles")
    write_one(written.parent / ".20261124T150000Z-aaaa.partial")
    listed = run("list", written.parent, "--json").output.splitlines()
    ids = [json.loads(line)["id"] for line in listed]
    assert ids == sorted([written.name, deeper.name])


def test_readings_as_a_table(written: Path) -> None:
    (row,) = csv.DictReader(io.StringIO(run("list", written.parent, "--csv").output))
    assert row["bundle"] == written.name
    assert (row["number"], row["label"], row["tilt_deg"]) == ("7", "N", "5.0")
    assert float(row["heading_deg"]) == 162.25
    assert row["altitude_m"] == ""


def test_verify(written: Path) -> None:
    assert run("verify", written).return_value == 0
    assert json.loads(run("verify", written.parent, "--json").output)["whole"]
    (written / "frames" / "N.png").unlink()
    assert run("verify", written, written).return_value == 2
    result = run("verify", written, "--json")
    assert result.return_value == 2
    assert "N.png is missing" in json.loads(result.output)["problem"]


def test_verify_of_a_folder_without_bundles_is_no_success(tmp_path: Path) -> None:
    result = run("verify", tmp_path)
    assert result.return_value == 2
    assert "holds no bundle" in result.output


@pytest.mark.parametrize("name", ["trip.tar", "trip.tar.gz", "trip.zip"])
def test_an_archive_is_what_went_in(written: Path, tmp_path: Path, name: str) -> None:
    other = write_one(written.parent)
    archive = tmp_path / "out" / name
    assert run("export", written.parent, "--out", archive).output.splitlines()[0] == str(archive)
    assert run("verify", archive).return_value == 0
    imported = run("import", archive, "--out", tmp_path / "home", "--json").output.splitlines()
    assert [json.loads(line)["new"] for line in imported] == [True, True]
    for path in (written, other):
        assert load_bundle(tmp_path / "home" / path.name).to_json() == load_bundle(path).to_json()
    again = run("import", archive, "--out", tmp_path / "home", "--json").output.splitlines()
    assert [json.loads(line)["new"] for line in again] == [False, False]
    assert [path.name for path in archive.parent.iterdir()] == [name]


def test_an_archive_can_be_checked_without_this_program(written: Path, tmp_path: Path) -> None:
    archive = tmp_path / "trip.tar"
    run("export", written, "--out", archive)
    with tarfile.open(archive) as tar:
        tar.extractall(tmp_path / "plain", filter="data")
    lines = (tmp_path / "plain" / "SHA256SUMS").read_text().splitlines()
    assert len(lines) == 3
    for line in lines:
        digest, name = line.split("  ")
        assert hashlib.sha256((tmp_path / "plain" / name).read_bytes()).hexdigest() == digest
    assert load_bundle(tmp_path / "plain" / written.name)


@pytest.mark.parametrize("kept", [0.2, 0.7, 0.99])
@pytest.mark.parametrize("name", ["trip.tar", "trip.tar.gz", "trip.zip"])
def test_a_cut_off_archive_is_found_out(written: Path, tmp_path: Path, name: str, kept: float) -> None:
    archive = tmp_path / name
    run("export", written, "--out", archive)
    content = archive.read_bytes()
    if name == "trip.tar":
        content = content.rstrip(b"\0")  # what tar fills its last block with says nothing
    archive.write_bytes(content[: int(len(content) * kept)])
    result = run("verify", archive)
    assert result.return_value == 2
    assert name in result.output


def test_a_changed_byte_in_an_archive_is_found_out(written: Path, tmp_path: Path) -> None:
    archive = tmp_path / "trip.tar"
    run("export", written, "--out", archive)
    content = bytearray(archive.read_bytes())
    content[content.index(b'"tilt_deg": 5.0') + 12] ^= 1
    archive.write_bytes(content)
    result = run("verify", archive)
    assert result.return_value == 2
    assert "bundle.json is missing, was added or has changed" in result.output


@pytest.mark.parametrize("command", ["verify", "import"])
def test_a_pipe_named_as_an_archive_is_not_waited_for(tmp_path: Path, command: str) -> None:
    archive = tmp_path / "trip.tar"
    os.mkfifo(archive)
    where = ["--out", tmp_path / "home"] if command == "import" else []
    result = run(command, archive, *where)
    assert "is not a file but a directory or a pipe" in f"{result.output}{result.exception}"


def test_an_archive_that_leads_outside_is_refused(tmp_path: Path) -> None:
    archive = tmp_path / "evil.tar"
    with tarfile.open(archive, "w") as tar:
        member = tarfile.TarInfo("../evil/bundle.json")
        tar.addfile(member, io.BytesIO(b""))
    assert "leads outside" in refused("import", archive, "--out", tmp_path / "home")
    assert not (tmp_path / "evil").exists()


def test_what_cannot_be_exported(written: Path, tmp_path: Path) -> None:
    assert "no archive format" in refused("export", written, "--out", tmp_path / "x.rar")
    assert "among them twice" in refused("export", written, written, "--out", tmp_path / "x.tar")
    (tmp_path / "x.tar").write_bytes(b"")
    assert "is there already" in refused("export", written, "--out", tmp_path / "x.tar")
    (written / "frames" / "N.png").unlink()
    assert "N.png is missing" in refused("export", written, "--out", tmp_path / "y.tar")
    assert not (tmp_path / "y.tar").exists()


def test_a_disk_that_refuses_leaves_nothing(
    written: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(ArchiveError, match="No space left on device"):
        write_archive(tmp_path / "out" / "x.tar", [load_bundle(written)])
    assert list((tmp_path / "out").iterdir()) == []
