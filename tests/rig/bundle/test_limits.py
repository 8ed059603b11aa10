"""The limits of an archive, each just within and just beyond: what is beyond is refused by its own message."""

import io
import stat
from pathlib import Path
from types import SimpleNamespace

import pytest
from fakes.archives import members_of, with_sums, write_archive_of
from fakes.located import write_bundle

from localizer.bundle import load_bundle
from rig.bundle import limits
from rig.bundle.archive import unpack_archive, write_archive
from rig.bundle.limits import ArchiveError, Slices, Tally, checked_name, is_plain

KB, MB = 1000, 1_000_000


# ---- names


@pytest.mark.parametrize(
    "name",
    [
        "index.csv",
        "b/bundle.json",
        "b/frames/N.png",
        "20261123T043151Z-3f9a/frames/A222.5.png",
        "b/" + "x" * 1198,
    ],
)
def test_a_name_inside_is_kept(name: str) -> None:
    assert checked_name(name) == name


def test_a_name_is_given_in_its_shortest_form() -> None:
    assert checked_name("./b//frames/./N.png") == "b/frames/N.png"


@pytest.mark.parametrize(
    "name",
    [
        "", ".", "/", "/x", "//x", "/b/bundle.json", "..", "../x", "b/../../x", "b/..", "b\\x", "\\x", "C:x", "b/C:/x",
        "b/\x07", "b/x\n", "b/\u202egnp.N", "b/" + "x" * 1199,
    ],
)  # fmt: skip
def test_a_name_that_leads_outside_or_cannot_be_a_file_is_refused(name: str) -> None:
    with pytest.raises(ArchiveError, match="leads outside, or has a name that files here cannot have"):
        checked_name(name)


@pytest.mark.parametrize("folder", [".ssh", "-x", "a b", "x" * 129])
def test_a_folder_that_no_bundle_can_have_is_refused(folder: str) -> None:
    with pytest.raises(ArchiveError, match="no bundle can have that id"):
        checked_name(f"{folder}/bundle.json")


@pytest.mark.parametrize(
    ("mode", "plain"),
    [
        (0, True), (0o644, True), (stat.S_IFREG | 0o644, True), (stat.S_IFLNK | 0o777, False), (stat.S_IFDIR, False),
        (stat.S_IFIFO, False), (stat.S_IFCHR, False), (stat.S_IFSOCK, False),
    ],
)  # fmt: skip
def test_a_plain_file_by_its_unix_mode(mode: int, plain: bool) -> None:
    assert is_plain(mode) == plain


# ---- how many, how large


def test_the_most_that_may_come_out_is_a_hundred_times_what_went_in() -> None:
    """But 20 MB in any case, and never more than 20 GB."""
    assert [Tally(packed).most_bytes for packed in (0, 200 * KB, 200 * KB + 1, 10 * MB, 300 * MB)] == [
        20 * MB, 20 * MB, 20 * MB + 100, 1000 * MB, 20_000 * MB,
    ]  # fmt: skip


def test_files_add_up_to_the_most_and_no_further() -> None:
    tally = Tally(0)
    tally.file("a", 12 * MB)
    tally.file("b", 8 * MB)
    tally.file("empty", 0)
    with pytest.raises(ArchiveError, match="unpacks to more than 20 MB, far more than its size explains"):
        tally.file("c", 1)


def test_one_file_has_512_mb_at_most() -> None:
    Tally(10 * MB).file("a", 512 * MB)
    with pytest.raises(ArchiveError, match="its file a has 512 MB; 512 is the most"):
        Tally(10 * MB).file("a", 512 * MB + 1)


def test_a_negative_size_does_not_make_room() -> None:
    with pytest.raises(ArchiveError, match="its file a has -1 bytes"):
        Tally(0).file("a", -1)


def test_files_and_folders_are_counted_together() -> None:
    tally = Tally(0)
    for number in range(10_000):
        tally.folder()
        tally.file(f"{number}", 0)
    for one_more in (tally.folder, lambda: tally.file("x", 0)):
        with pytest.raises(ArchiveError, match="holds more than 20000 files"):
            one_more()


@pytest.mark.parametrize("second", ["b/N.png", "B/n.PNG"])
def test_a_name_comes_once_in_any_case(second: str) -> None:
    tally = Tally(0)
    tally.file("b/N.png", 1)
    tally.file("b/E.png", 1)
    with pytest.raises(ArchiveError, match=f"holds {second} twice, or two names that differ in case only"):
        tally.file(second, 1)


# ---- reads of libraries that trust sizes


def slices(size: int, most_bytes: int = 10 * MB) -> Slices:
    return Slices(io.BytesIO(bytes(size)), most_bytes)


def test_one_read_is_4_mb_at_most() -> None:
    assert len(slices(5 * MB).read(4 * MB)) == 4 * MB
    with pytest.raises(ArchiveError, match="its headers ask for megabytes"):
        slices(5 * MB).read(4 * MB + 1)
    assert len(slices(5 * MB).read()) == 4 * MB, "to the end: only if little is left"
    assert len(slices(3 * MB).read(-1)) == 3 * MB
    assert slices(3).read(0) == b""


def test_no_more_is_read_or_skipped_than_may_come_out() -> None:
    file = slices(100, most_bytes=50)
    assert len(file.read(50)) == 50
    with pytest.raises(ArchiveError, match="unpacks to more than"):
        file.read(1)
    assert file.seek(50) == 50
    assert file.tell() == 50
    assert file.seekable()
    assert file.seek(0, io.SEEK_END) == 100, "zip looks for its directory there"
    with pytest.raises(ArchiveError, match="unpacks to more than"):
        file.seek(51)


def test_the_headers_of_one_file_are_64_kb_at_most() -> None:
    file = slices(1 * MB)
    for _ in range(2):
        with file.header():
            file.read(512)
            file.read(65_024)  # 65536 together
    with file.header():
        file.read(512)
        with pytest.raises(ArchiveError, match="its headers are longer than any"):
            file.read(65_025)
    assert len(file.read(100_000)) == 100_000, "contents are no headers"


def test_extended_headers_are_2_mb_at_most_in_all_and_plain_ones_are_not_counted() -> None:
    file = slices(9 * MB)
    for _ in range(5000):
        with file.header():
            file.read(512)
    for _ in range(40):
        with file.header():
            file.read(512)
            file.read(50_000)
    with file.header():
        file.read(512)
        with pytest.raises(ArchiveError, match="its headers are longer than any"):
            file.read(1)


def test_a_number_of_more_than_255_digits_is_in_no_header() -> None:
    for digits, refused in ((255, False), (256, True)):
        file = Slices(io.BytesIO(b"x" + b"7" * digits + b"x"), MB)
        with file.header():
            if refused:
                with pytest.raises(ArchiveError, match="its headers are longer than any"):
                    file.read(512)
            else:
                assert len(file.read(512)) == digits + 2


def test_the_limits_are_those_documented() -> None:
    assert (limits.MAX_MEMBERS, limits.MAX_TOTAL_BYTES, limits.RATIO_FROM_BYTES) == (
        20_000,
        20_000 * MB,
        20 * MB,
    )


# ---- a full disk is looked at before anything is written


def test_an_export_needs_its_files_a_kilobyte_for_each_and_20_mb_free(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bundle = load_bundle(write_bundle(tmp_path / "from", "b"))
    size = sum(path.stat().st_size + 1024 for path in bundle.directory.rglob("*") if path.is_file())
    asked: list[Path] = []

    def usage(path: Path) -> SimpleNamespace:
        asked.append(path)
        return SimpleNamespace(free=size + 20 * MB - short)

    monkeypatch.setattr("shutil.disk_usage", usage)
    short = 1
    with pytest.raises(
        ArchiveError, match=r"x\.tar: needs 20 MB, 20 MB are free; make room, or choose another --out"
    ):
        write_archive(tmp_path / "not" / "yet" / "x.tar", [bundle])
    assert asked == [tmp_path]
    assert not (tmp_path / "not").exists()
    short = 0
    write_archive(tmp_path / "x.tar", [bundle])


def test_an_import_needs_each_file_and_20_mb_free(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bundle = write_bundle(tmp_path / "from", "b")
    members = members_of(bundle)
    archive = write_archive_of(tmp_path / "x.tar", with_sums(members))
    largest = max(len(content) for _, content in members)
    free = largest + 20 * MB - 1
    monkeypatch.setattr("shutil.disk_usage", lambda path: SimpleNamespace(free=free))
    with pytest.raises(ArchiveError, match=r"there is no room in .* to unpack it"):
        unpack_archive(archive, tmp_path / "home")
    assert not (tmp_path / "home").exists()
    free += 1
    assert unpack_archive(archive, tmp_path / "home") == [(tmp_path / "home" / "b", True)]
