"""JSON and TOML from anywhere: what is sound is read, all else is refused in one line, in little time and memory."""

import json
import os
import subprocess
import sys
import threading
import time
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from fakes.attacks import BOM, JSON_ATTACKS, TOML_ATTACKS
from hypothesis import given, settings
from hypothesis import strategies as st

from localizer import documents
from localizer.bundle import BundleError, is_bundle_id, load_bundle
from localizer.documents import (
    DEEPEST,
    DocumentError,
    json_values,
    read_file,
    read_json,
    read_toml,
    toml_values,
)
from localizer.predict.lens import load_camera
from localizer.track.odometry import load_odometry
from localizer.track.tracker import Tracker, TrackerError
from localizer.truth import load_truth


@pytest.mark.parametrize("attack", JSON_ATTACKS)
def test_json_that_is_an_attack_is_refused_in_one_line_at_once(attack: str) -> None:
    begun = time.monotonic()
    with pytest.raises(DocumentError) as refusal:
        json_values(JSON_ATTACKS[attack])
    assert str(refusal.value).isprintable()
    assert len(str(refusal.value)) < 300
    assert time.monotonic() - begun < 1.0


@pytest.mark.parametrize("attack", TOML_ATTACKS)
def test_toml_that_is_an_attack_is_refused_in_one_line_at_once(attack: str) -> None:
    begun = time.monotonic()
    with pytest.raises(DocumentError) as refusal:
        toml_values(TOML_ATTACKS[attack])
    assert str(refusal.value).isprintable()
    assert len(str(refusal.value)) < 300
    assert time.monotonic() - begun < 1.0


def test_the_place_of_what_is_wrong_is_named() -> None:
    with pytest.raises(DocumentError, match=r"^frames\[1\]\.tilt_deg: input should be a finite number"):
        json_values('{"frames": [{}, {"tilt_deg": NaN}]}')
    with pytest.raises(DocumentError, match=r"^\[run\.http\] token_file: should have no control characters"):
        toml_values('[run.http]\ntoken_file = "a\\u0000"')


def test_what_is_as_deep_as_may_be_is_read() -> None:
    assert json_values("[" * DEEPEST + "]" * DEEPEST)
    assert toml_values(f"a = {'[' * (DEEPEST - 1)}{']' * (DEEPEST - 1)}")
    assert toml_values("# " + "." * 300 + " this is 1.2.3\na = '" + "1.2 " * 100 + "'")


def test_a_byte_order_mark_is_no_part_of_the_text(tmp_path: Path) -> None:
    assert json_values(BOM + b'{"a": 1}') == {"a": 1}
    assert toml_values(BOM + b"a = 1") == {"a": 1}
    (tmp_path / "x.toml").write_bytes(BOM + b"a = 'gr\xc3\xbcn'\r\n")
    assert read_toml(tmp_path / "x.toml") == {"a": "grün"}


def test_files_too_large_and_files_that_are_none_are_not_read(tmp_path: Path) -> None:
    with (tmp_path / "sparse.json").open("wb") as file:
        file.truncate(5_000_000_000)
    with pytest.raises(DocumentError, match=r"larger than 8 MB"):
        read_json(tmp_path / "sparse.json")
    with pytest.raises(DocumentError, match=r"larger than 1 MB"):
        read_toml(Path("/dev/zero"))
    with pytest.raises(IsADirectoryError):
        read_json(tmp_path)
    with pytest.raises(DocumentError, match="no name that a file can have"):
        read_json(Path("a\0b"))


def test_a_pipe_is_read_and_one_that_nobody_writes_to_is_not_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    os.mkfifo(tmp_path / "pipe")
    holding = os.open(tmp_path / "pipe", os.O_RDWR)
    try:
        monkeypatch.setattr(documents, "PIPE_S", 0.1)
        with pytest.raises(DocumentError, match="nothing has come from it"):
            read_file(tmp_path / "pipe", 10)
        monkeypatch.undo()
        done: list[Any] = []
        reader = threading.Thread(target=lambda: done.append(read_file(tmp_path / "pipe", 5)), daemon=True)
        reader.start()
        os.write(holding, b"12345")
        time.sleep(0.2)  # it has opened the pipe by now
    finally:
        os.close(holding)
    reader.join(5.0)
    assert done == [b"12345"]


def test_the_whole_document_is_refused_without_much_memory() -> None:
    """In a process with half a gigabyte of address space more than it has: brackets and values by the millions."""
    program = """
import resource, sys
from localizer.documents import DocumentError, json_values
used = int(open("/proc/self/statm").read().split()[0]) * 4096
resource.setrlimit(resource.RLIMIT_AS, (used + 500_000_000,) * 2)
for text in (b"[" * 7_900_000, b"[" + b"[]," * 2_600_000 + b"0]", b'{"a":' * 1_500_000, b"[" + b'{"a":1},' * 900_000 + b"0]"):
    try:
        json_values(text)
    except DocumentError as error:
        print(error)
"""
    done = subprocess.run(
        [sys.executable, "-c", program], check=False, capture_output=True, text=True, timeout=60
    )
    assert len(done.stdout.splitlines()) == 4, done.stderr


READERS: dict[str, Callable[[Path], object]] = {
    "bundle": lambda file: load_bundle(file.parent),
    "camera": load_camera,
    "truth": load_truth,
    "odometry": lambda file: load_odometry(file, 1),
    "tracker": lambda file: Tracker.from_json(file.read_bytes()),
}


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("attack", JSON_ATTACKS)
def test_each_reader_of_json_refuses_it_with_its_own_error(tmp_path: Path, reader: str, attack: str) -> None:
    file = tmp_path / "bundle.json"
    file.write_bytes(JSON_ATTACKS[attack])
    with pytest.raises(documents.SkyfixError) as refusal:
        READERS[reader](file)
    assert not isinstance(refusal.value, DocumentError)
    assert str(refusal.value).isprintable()
    assert str(file) in str(refusal.value) or isinstance(refusal.value, TrackerError)


@pytest.mark.parametrize(
    "crs", ['{"type":' * 3000, "PROJCS[" * 3000, "x" * 1_000_000, "EPSG:4326\n", "EPSG:4326 \x1b[2J"]
)
def test_a_truth_whose_coordinate_reference_system_is_an_attack_is_refused_in_one_line(
    tmp_path: Path, crs: str
) -> None:
    """What it says is a document, too: PROJ's JSON or WKT."""
    file = tmp_path / "truth.json"
    file.write_text(json.dumps({"easting_m": 1.0, "northing_m": 2.0, "crs": crs}))
    with pytest.raises(documents.SkyfixError) as refusal:
        load_truth(file)
    assert str(refusal.value).isprintable()
    assert len(str(refusal.value)) < 500


def test_a_bundle_with_a_byte_order_mark_is_read(bundle_dir: Path) -> None:
    file = bundle_dir / "bundle.json"
    file.write_bytes(BOM + file.read_bytes())
    assert load_bundle(bundle_dir)


def test_a_bundle_json_of_a_gigabyte_is_not_read(bundle_dir: Path) -> None:
    with (bundle_dir / "bundle.json").open("wb") as file:
        file.truncate(1_000_000_000)
    begun = time.monotonic()
    with pytest.raises(BundleError, match=r"bundle\.json: is larger than 8 MB"):
        load_bundle(bundle_dir)
    assert time.monotonic() - begun < 1.0


@pytest.mark.parametrize("good", ["a", "0", "20261123T043151Z-3f9a", "a.b_c-d", "a..b", "x" * 128])
def test_ids_of_bundles(good: str) -> None:
    assert is_bundle_id(good)


@pytest.mark.parametrize(
    "bad", ["", ".", "..", ".a", "-a", "_a", "a/b", "a\\b", "a b", "a\n", "ä", "٣", "x" * 129, "a\0"]
)
def test_what_is_no_id_of_a_bundle(bad: str) -> None:
    assert not is_bundle_id(bad)


leaves = (
    st.none()
    | st.booleans()
    | st.integers(-(2**60), 2**60)
    | st.floats(allow_nan=False, allow_infinity=False)
)
texts = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=10)
trees = st.recursive(
    leaves | texts, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(texts, inner, max_size=4)
)


@settings(deadline=None)
@given(trees)
def test_sound_json_is_read_as_the_library_reads_it(tree: Any) -> None:
    assert json_values(json.dumps(tree)) == tree


@settings(deadline=None)
@given(st.binary(max_size=200) | st.text(alphabet="[]{}=.\"'\n#a1-+e_ \\u,:T", max_size=80).map(str.encode))
def test_any_bytes_are_read_as_the_libraries_read_them_or_refused(content: bytes) -> None:
    for ours, theirs in ((json_values, json.loads), (toml_values, tomllib.loads)):
        try:
            values = ours(content)
        except DocumentError as refusal:
            assert str(refusal).isprintable()  # noqa: PT017
            continue
        assert values == theirs(content.decode("utf-8-sig"))  # type: ignore[operator]
