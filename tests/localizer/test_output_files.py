"""Where a command's output goes is checked before the work: what cannot be written is refused by its own message."""

from pathlib import Path

import pytest

from localizer import output_files
from localizer.durable import make_folder, write_synced
from localizer.errors import SkyfixError
from localizer.output_files import check_picture_path, prepare_folder, writing


def refused(call: object, *arguments: object) -> str:
    with pytest.raises(SkyfixError) as caught:
        call(*arguments)  # type: ignore[operator]
    return str(caught.value)


def test_a_folder_is_made_with_its_parents_and_nothing_is_left_in_it(tmp_path: Path) -> None:
    for _ in range(2):  # one that is there is taken
        prepare_folder("--out", tmp_path / "a" / "b")
        assert list((tmp_path / "a" / "b").iterdir()) == []


def test_a_file_is_no_folder(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("kept")
    assert refused(prepare_folder, "--out", file) == f"--out: {file}: is a file; name a folder"
    below = file / "below"
    assert refused(prepare_folder, "--out", below).startswith(
        f"--out: {below}: cannot be written: Not a directory"
    )
    assert file.read_text() == "kept"


def test_a_folder_that_takes_no_file_is_refused_before_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_room(**_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(output_files.tempfile, "TemporaryFile", no_room)
    why = refused(prepare_folder, "--out", tmp_path / "new")
    assert why.startswith(f"--out: {tmp_path / 'new'}: ")
    assert "No space left on device" in why


@pytest.mark.parametrize("name", ["fix.png", "fix.jpg", "fix.svg", "fix.pdf", "FIX.PNG", "a.b.png"])
def test_a_picture_is_named_by_its_format(tmp_path: Path, name: str) -> None:
    check_picture_path("--plot", tmp_path / name)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["fix", "fix.gif", "png", ".png", "fix.png.txt"])
def test_another_suffix_is_no_picture(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    assert refused(check_picture_path, "--plot", path) == (
        f"--plot: {path}: no picture format; name it .png, .jpg, .svg, .pdf"
    )


def test_the_folder_of_a_picture_must_be_there_and_its_name_free_of_folders(tmp_path: Path) -> None:
    path = tmp_path / "none" / "fix.png"
    assert (
        refused(check_picture_path, "--plot", path) == f"--plot: {path}: no such folder: {tmp_path / 'none'}"
    )
    assert not path.parent.exists()
    folder = tmp_path / "folder.png"
    folder.mkdir()
    assert refused(check_picture_path, "--plot", folder) == f"--plot: {folder}: is a folder; name a file"


def test_a_refusal_while_writing_is_one_line_and_other_errors_pass(tmp_path: Path) -> None:
    def write(error: Exception) -> None:
        with writing("--plot", tmp_path / "fix.png"):
            raise error

    full = OSError(28, "No space left on device")
    assert (
        refused(write, full) == f"--plot: {tmp_path / 'fix.png'}: cannot be written: No space left on device"
    )
    with pytest.raises(ZeroDivisionError):
        write(ZeroDivisionError())
    with writing("--plot", tmp_path / "fix.png"):
        pass


def test_a_synced_file_is_a_new_one(tmp_path: Path) -> None:
    write_synced(tmp_path / "a", b"first")
    with pytest.raises(FileExistsError):
        write_synced(tmp_path / "a", b"second")
    assert (tmp_path / "a").read_bytes() == b"first"


def test_a_folder_may_be_there_and_named_from_where_one_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for _ in range(2):
        make_folder(Path("a") / "b")
    assert (tmp_path / "a" / "b").is_dir()
