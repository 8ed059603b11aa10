"""Archives from anybody: nothing is written outside, nothing grows without limit, and what is refused leaves nothing."""

import io
import json
import os
import signal
import subprocess
import tarfile
import time
import zipfile
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from fakes.archives import KINDS, members_of, tree, with_sums, write_archive_of
from fakes.bundle import write_one
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from localizer.bundle import BundleError, load_bundle
from localizer.errors import SkyfixError
from rig.bundle import limits, unpack
from rig.bundle.archive import ArchiveError, bundles_of_archive, unpack_archive, write_archive
from rig.commands.bundle import bundle
from sim.launch.child_command import find_command, search_path

BAD_IDS = [
    "../evil", "..", ".", ".hidden", "/etc/evil", "a/b", "a\\b", "C:evil", "", "-x", "_x", "a b", "a\nb", "é", "x" * 129,
]  # fmt: skip


@pytest.fixture
def written(tmp_path: Path) -> Path:
    return write_one(tmp_path / "bundles")


@pytest.fixture
def home(tmp_path: Path) -> Path:
    """A folder for imports, with a secret file next to it."""
    (tmp_path / "field").mkdir()
    (tmp_path / "field" / "secret").write_text("untouched")
    return tmp_path / "field" / "home"


def run(*arguments: str | Path) -> Result:
    return CliRunner().invoke(bundle, [str(each) for each in arguments], standalone_mode=False)


def refused(archive: Path, home: Path) -> str:
    """Why import does not take an archive; what is there is as before, and ``verify`` does not call it whole either."""
    before = tree(home.parent)
    with pytest.raises(SkyfixError) as caught:
        unpack_archive(archive, home)
    assert isinstance(caught.value, ArchiveError | BundleError)
    assert "\n" not in str(caught.value)
    assert tree(home.parent) == before
    assert run("verify", archive).return_value == 2
    return str(caught.value)


@pytest.mark.parametrize("suffix", KINDS)
@pytest.mark.parametrize("bad_id", BAD_IDS)
def test_an_id_that_leads_elsewhere_is_none(
    written: Path, tmp_path: Path, home: Path, bad_id: str, suffix: str
) -> None:
    """With the archive's folder named like it, and with one that is named properly."""
    for folder in (None, written.name):
        archive = write_archive_of(tmp_path / f"x{suffix}", with_sums(members_of(written, folder, id=bad_id)))
        assert refused(archive, home).startswith(f"{archive}: "), (
            "not the folder of ours that is gone by then"
        )
    assert not home.exists()


@pytest.mark.parametrize("suffix", KINDS)
def test_the_folder_in_the_archive_is_named_as_the_bundle(
    written: Path, tmp_path: Path, home: Path, suffix: str
) -> None:
    archive = write_archive_of(tmp_path / f"x{suffix}", with_sums(members_of(written, "another")))
    assert "must have one name" in refused(archive, home)


@pytest.mark.parametrize("suffix", KINDS)
def test_only_what_the_bundle_lists_is_copied_and_verify_tells_of_the_rest(
    written: Path, tmp_path: Path, home: Path, suffix: str
) -> None:
    members = [*members_of(written), (f"{written.name}/.ssh/authorized_keys", b"ssh-ed25519 AAAA evil")]
    archive = write_archive_of(tmp_path / f"x{suffix}", with_sums([*members, ("README", b"read me")]))
    result = run("import", archive, "--out", home)
    assert result.exit_code == 0
    assert "left out" in result.stderr
    assert set(tree(home / written.name)) == set(tree(written))
    assert [path.name for path in home.iterdir()] == [written.name]
    verified = run("verify", archive)
    assert verified.return_value == 2
    assert ".ssh/authorized_keys', which no bundle lists" in verified.output


NAMES = [
    "../x",
    "/x",
    "a/../../x",
    "..\\x",
    "C:/x",
    "C:x",
    "b/x\nrm",
    "b/\x07",
    ".ssh/authorized_keys",
    "b:c/x",
]


@pytest.mark.parametrize("suffix", KINDS)
@pytest.mark.parametrize("name", NAMES)
def test_a_name_that_leads_outside_is_refused(
    written: Path, tmp_path: Path, home: Path, name: str, suffix: str
) -> None:
    archive = write_archive_of(tmp_path / f"x{suffix}", with_sums([*members_of(written), (name, b"x")]))
    why = (
        "is no bundle's"
        if name.startswith(".ssh")
        else "leads outside, or has a name that files here cannot have"
    )
    assert why in refused(archive, home)


@pytest.mark.parametrize("suffix", KINDS)
def test_names_that_are_there_twice_or_differ_in_case_only_are_refused(
    written: Path, tmp_path: Path, home: Path, suffix: str
) -> None:
    members = members_of(written)
    for name in (members[0][0], members[1][0].replace("N.png", "n.PNG")):
        archive = write_archive_of(tmp_path / f"x{suffix}", with_sums([*members, (name, b"x")]))
        assert "twice" in refused(archive, home)


LINKS = (
    tarfile.SYMTYPE,
    tarfile.LNKTYPE,
    tarfile.CHRTYPE,
    tarfile.BLKTYPE,
    tarfile.FIFOTYPE,
    tarfile.GNUTYPE_SPARSE,
)


@pytest.mark.parametrize("kind", LINKS)
def test_what_is_no_plain_file_in_a_tar_is_refused(
    written: Path, tmp_path: Path, home: Path, kind: bytes
) -> None:
    archive = tmp_path / "x.tar"
    with tarfile.open(archive, "w") as tar:
        link = tarfile.TarInfo(f"{written.name}/frames")
        link.type, link.linkname = kind, str(home.parent)
        tar.addfile(link)
        for name, content in with_sums(members_of(written)):
            member = tarfile.TarInfo(name)
            member.size = len(content)
            tar.addfile(member, io.BytesIO(content))
    refused(archive, home)


def test_a_link_in_a_zip_is_refused(written: Path, tmp_path: Path, home: Path) -> None:
    archive = tmp_path / "x.zip"
    with zipfile.ZipFile(archive, "w") as file:
        link = zipfile.ZipInfo(f"{written.name}/frames")
        link.external_attr = 0o120777 << 16
        file.writestr(link, str(home.parent))
    assert "no plain file" in refused(archive, home)


@pytest.mark.parametrize("target", ["nowhere", "there"])
def test_a_link_in_the_way_is_not_followed(written: Path, tmp_path: Path, home: Path, target: str) -> None:
    home.mkdir()
    (home.parent / "there").mkdir()
    (home / written.name).symlink_to(home.parent / target)
    archive = write_archive_of(tmp_path / "x.tar", with_sums(members_of(written)))
    before = tree(home.parent)
    with pytest.raises(ArchiveError, match="is a link"):
        unpack_archive(archive, home)
    assert tree(home.parent) == before


def test_a_frame_file_that_leads_outside_through_a_link_is_not_read(written: Path, tmp_path: Path) -> None:
    frame = next((written / "frames").iterdir())
    (tmp_path / "outside.png").write_bytes(frame.read_bytes())
    frame.unlink()
    frame.symlink_to(tmp_path / "outside.png")
    with pytest.raises(BundleError, match="leads outside the bundle"):
        load_bundle(written)


@pytest.mark.parametrize("suffix", [".tar.gz", ".zip"])
def test_a_bomb_is_refused_before_it_takes_room(
    written: Path, tmp_path: Path, home: Path, suffix: str
) -> None:
    """80 MB of zeros in 80 kB: far past the ratio. Where the size is in a header, nothing is unpacked at all."""
    members = with_sums([*members_of(written), (f"{written.name}/frames/zero.png", bytes(80_000_000))])
    archive = write_archive_of(tmp_path / f"x{suffix}", members)
    assert archive.stat().st_size < 200_000
    begun = time.monotonic()
    assert "more than its size explains" in refused(archive, home)
    assert time.monotonic() - begun < 2.0


@pytest.mark.parametrize("suffix", KINDS)
def test_thousands_of_empty_members_are_refused(
    written: Path, tmp_path: Path, home: Path, suffix: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(limits, "MAX_MEMBERS", 300)
    members = [(f"{written.name}/x{number}", b"") for number in range(400)]
    assert "more than 300 files" in refused(write_archive_of(tmp_path / f"x{suffix}", members), home)
    folders = [(f"{written.name}/x{number}/", b"") for number in range(400)]
    if suffix == ".zip":
        assert "more than 300 files" in refused(write_archive_of(tmp_path / "y.zip", folders), home)


def test_a_folder_with_more_files_than_a_bundle_is_refused_without_waiting_for_the_rest(
    written: Path, tmp_path: Path, home: Path
) -> None:
    members = [(f"{written.name}/x{number}", b"") for number in range(unpack.MAX_IN_FOLDER + 10)]
    assert "more files than any bundle" in refused(write_archive_of(tmp_path / "x.tar", members), home)


def test_a_header_that_asks_for_megabytes_is_refused(written: Path, tmp_path: Path, home: Path) -> None:
    """A tar's extended headers and a zip's directory are read at once by the libraries, as large as they say they are."""
    archive = tmp_path / "x.tar.gz"
    with tarfile.open(archive, "w:gz", format=tarfile.PAX_FORMAT) as tar:
        member = tarfile.TarInfo(f"{written.name}/bundle.json")
        member.pax_headers = {"comment": "x" * 6_000_000}
        tar.addfile(member)
    assert "headers ask for megabytes" in refused(archive, home)


def test_headers_that_announce_headers_without_end_are_refused(tmp_path: Path, home: Path) -> None:
    name = tarfile.TarInfo("././@LongLink")
    name.type, name.size = tarfile.GNUTYPE_LONGNAME, 2
    (tmp_path / "x.tar").write_bytes((name.tobuf() + b"a\0".ljust(512, b"\0")) * 2000)
    refused(tmp_path / "x.tar", home)


def pax_header(kind: bytes, content: bytes) -> bytes:
    header = tarfile.TarInfo("pax")
    header.type, header.size = kind, len(content)
    return header.tobuf(tarfile.USTAR_FORMAT) + content.ljust(-(-len(content) // 512) * 512, b"\0")


SPARSE = b"22 GNU.sparse.major=1\n22 GNU.sparse.minor=0\n"


@pytest.mark.parametrize(
    ("headers", "rest"),
    [
        (pax_header(tarfile.XHDTYPE, b"1" * 3_900_000), b""),
        (pax_header(tarfile.XHDTYPE, b"1" * 60_000) * 60, b""),
        (pax_header(tarfile.XGLTYPE, b"".join(b"9 %04x=\n" % i for i in range(60_000))), b""),
        (pax_header(tarfile.XHDTYPE, SPARSE), b"9" * 200_000 + b"\n" + bytes(10_000_000)),
        (pax_header(tarfile.XHDTYPE, SPARSE), b"\n" + bytes(15_000_000)),
    ],
    ids=["digits", "digits often", "global", "sparse digits", "sparse without end"],
)
def test_headers_over_which_tarfile_would_ponder_are_refused_at_once(
    written: Path, tmp_path: Path, home: Path, headers: bytes, rest: bytes
) -> None:
    """Within each single limit, and for hours: the time goes with the square of what is there (CVE-2024-6232)."""
    member = tarfile.TarInfo(f"{written.name}/x")
    member.size = len(rest)
    (tmp_path / "x.tar").write_bytes(headers + member.tobuf() + rest.ljust(-(-len(rest) // 512) * 512, b"\0"))
    begun_s = time.monotonic()
    refused(tmp_path / "x.tar", home)
    assert time.monotonic() - begun_s < 5.0


def test_a_file_of_less_than_no_bytes_is_refused(written: Path, tmp_path: Path, home: Path) -> None:
    archive = write_archive_of(tmp_path / "x.tar", with_sums(members_of(written)))
    size = pax_header(tarfile.XHDTYPE, b"12 size=-99\n")
    archive.write_bytes(size + tarfile.TarInfo(f"{written.name}/x").tobuf() + archive.read_bytes())
    assert "has -99 bytes" in refused(archive, home)


@pytest.mark.parametrize("suffix", KINDS)
def test_frames_that_share_a_picture_or_name_it_in_another_way_come_through(
    written: Path, tmp_path: Path, suffix: str
) -> None:
    fields = json.loads((written / "bundle.json").read_text())
    first = fields["frames"][0]
    aside = {**first, "label": "aside", "file": first["file"].replace("/", "/./")}
    fields["frames"] = [*fields["frames"], {**first, "label": "again"}, aside]
    (written / "bundle.json").write_text(json.dumps(fields))
    write_archive(tmp_path / f"x{suffix}", [load_bundle(written)])
    ((place, is_new),) = unpack_archive(tmp_path / f"x{suffix}", tmp_path / "home")
    assert is_new
    assert load_bundle(place).to_json() == load_bundle(written).to_json()


def test_other_packings_than_export_writes_are_refused(written: Path, tmp_path: Path, home: Path) -> None:
    """The dictionaries of xz and bzip2 are memory that the archive chooses; what is encrypted waits for a password."""
    for mode in ("xz", "bz2"):
        with tarfile.open(tmp_path / f"{mode}.tar", f"w:{mode}") as tar:  # type: ignore[call-overload]
            tar.add(written, written.name)
        refused(tmp_path / f"{mode}.tar", home)
    with zipfile.ZipFile(tmp_path / "x.zip", "w", zipfile.ZIP_LZMA) as archive:
        archive.writestr(f"{written.name}/bundle.json", b"{}")
    assert "packed in a way" in refused(tmp_path / "x.zip", home)
    plain = write_archive_of(tmp_path / "e.zip", with_sums(members_of(written)))
    content = bytearray(plain.read_bytes())
    for mark, at in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        content[content.index(mark) + at] |= 1
    plain.write_bytes(content)
    assert "encrypted" in refused(plain, home)


@pytest.mark.parametrize("suffix", KINDS)
def test_sums_are_checked_before_anything_is_in_its_place(
    written: Path, tmp_path: Path, home: Path, suffix: str
) -> None:
    """The second of two bundles is changed: the first does not stay either."""
    other = write_one(written.parent)
    members = with_sums([*members_of(written), *members_of(other, mast_height_m=3.0)])
    changed = [*members_of(written), *members_of(other), members[-1]]
    assert "has changed" in refused(write_archive_of(tmp_path / f"x{suffix}", changed), home)
    assert "SHA256SUMS" in refused(write_archive_of(tmp_path / f"y{suffix}", changed[:-1]), home)


def test_huge_sums_are_refused(
    written: Path, tmp_path: Path, home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(unpack, "MAX_SUMS_BYTES", 1000)
    archive = write_archive_of(tmp_path / "x.tar", [*members_of(written), ("SHA256SUMS", b"0" * 5000)])
    assert "SHA256SUMS is larger" in refused(archive, home)


def test_a_full_disk_leaves_nothing(
    written: Path, tmp_path: Path, home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    archive = write_archive_of(tmp_path / "x.tar", with_sums(members_of(written)))

    def full(path: Path) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(unpack, "sync", full)
    before = tree(home.parent)
    with pytest.raises(ArchiveError, match="No space left on device"):
        unpack_archive(archive, home)
    assert tree(home.parent) == before
    monkeypatch.undo()
    monkeypatch.setattr(unpack, "MIN_FREE_BYTES", 1 << 60)
    assert "no room" in refused(archive, home)


def test_an_import_interrupted_between_two_bundles_takes_the_first_back(
    written: Path, tmp_path: Path, home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = write_one(written.parent)
    archive = write_archive_of(tmp_path / "x.tar", with_sums([*members_of(written), *members_of(other)]))
    rename, calls = Path.rename, []

    def interrupted(self: Path, target: Path) -> Path:
        calls.append(target)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", interrupted)
    with pytest.raises(KeyboardInterrupt):
        unpack_archive(archive, home)
    assert len(calls) > 2
    assert not home.exists()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_in_the_middle_of_an_import_leaves_nothing(
    written: Path, tmp_path: Path, home: Path, number: signal.Signals
) -> None:
    members = [*members_of(written), *((f"{written.name}/{n}", os.urandom(1_000_000)) for n in range(150))]
    archive = write_archive_of(tmp_path / "x.tar", with_sums(members))
    home.mkdir()
    process = subprocess.Popen(
        [find_command("rig"), "bundle", "import", str(archive), "--out", str(home)],
        env={**os.environ, "PATH": search_path()},
        stderr=subprocess.PIPE,
        text=True,
    )
    until = time.monotonic() + 60.0
    while not any(home.rglob("*.json")) and time.monotonic() < until and process.poll() is None:
        time.sleep(0.001)
    process.send_signal(number)
    _, said = process.communicate(timeout=60.0)
    assert process.returncode == 128 + number
    assert len(said.strip().splitlines()) == 1
    assert list(home.iterdir()) == []


def test_what_a_killed_import_left_is_taken_away_by_the_next_one(
    written: Path, tmp_path: Path, home: Path
) -> None:
    (home / ".import-abc" / "x").mkdir(parents=True)
    archive = write_archive_of(tmp_path / "x.tar", with_sums(members_of(written)))
    assert unpack_archive(archive, home) == [(home / written.name, True)]
    assert [path.name for path in home.iterdir()] == [written.name]


@pytest.mark.parametrize("suffix", KINDS)
@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_an_archive_of_other_bytes_is_taken_or_refused_in_one_line(
    written: Path, tmp_path: Path, suffix: str, data: st.DataObject
) -> None:
    archive = tmp_path / f"x{suffix}"
    if not archive.exists():
        write_archive_of(archive, with_sums(members_of(written)))
        (tmp_path / "sound").write_bytes(archive.read_bytes())
    content = bytearray((tmp_path / "sound").read_bytes())
    for _ in range(data.draw(st.integers(1, 6))):
        at = data.draw(st.integers(0, len(content)))
        content[at : at + data.draw(st.integers(0, 4))] = data.draw(st.binary(max_size=6))
    archive.write_bytes(content)
    try:
        assert all(load_bundle(found.directory) for found in bundles_of_archive(archive))
    except (ArchiveError, BundleError) as refusal:
        assert str(refusal).isprintable()  # noqa: PT017
