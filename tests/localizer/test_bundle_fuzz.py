"""Whatever is in a bundle's files, the reader takes it or refuses it in one line that names the file."""

import hashlib
import json
from collections.abc import Iterator
from copy import deepcopy
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from localizer.bundle import Bundle, BundleError, load_bundle

# each example writes what it reads
fuzzed = settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)

numbers = st.one_of(
    st.integers(-(10**20), 10**20),
    st.floats(),
    st.sampled_from([0, -1, 180, 360, 1e-300, 1e300, 32768, 10**400]),
)
values = st.recursive(
    st.none() | st.booleans() | numbers | st.text(max_size=12),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=6,
)


def places(tree: Any, at: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The path to every node below the root."""
    items = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    for key, value in items:
        yield (*at, key)
        yield from places(value, (*at, key))


@st.composite
def mutated(draw: st.DrawFn, tree: Any) -> Any:
    """The same with up to three nodes replaced, left out, doubled or exchanged."""
    tree = deepcopy(tree)
    for _ in range(draw(st.integers(1, 3))):
        *above, key = draw(st.sampled_from(sorted(places(tree), key=repr)))
        parent = tree
        for step in above:
            parent = parent[step]
        what = draw(st.sampled_from(["replace", "leave out", "double", "exchange"]))
        if what == "replace":
            parent[key] = draw(values)
        elif what == "leave out":
            del parent[key]
        elif what == "double" and isinstance(parent, list):
            parent.append(deepcopy(parent[key]))
        else:
            other = draw(st.sampled_from(sorted(parent, key=repr))) if isinstance(parent, dict) else 0
            parent[key], parent[other] = parent[other], parent[key]
        if not tree:
            break
    return tree


@st.composite
def damaged(draw: st.DrawFn, content: bytes) -> bytes:
    """The same bytes cut off, overwritten in places, or with some put in."""
    content = content[: draw(st.integers(0, len(content)))] if draw(st.booleans()) else content
    for _ in range(draw(st.integers(0, 4))):
        at = draw(st.integers(0, len(content)))
        new = draw(st.binary(min_size=1, max_size=8))
        content = content[:at] + new + content[at + (len(new) if draw(st.booleans()) else 0) :]
    return content


def is_taken_or_refused_in_one_line(directory: Path) -> None:
    try:
        assert isinstance(load_bundle(directory), Bundle)
    except BundleError as refusal:
        message = str(refusal)
        assert message.startswith(str(directory))
        assert message.isprintable()
        assert len(message) < 2000


@fuzzed
@given(data=st.data())
def test_a_bundle_of_another_structure(bundle_dir, data):
    file = bundle_dir / "bundle.json"
    sound = file.read_text()
    try:
        file.write_text(json.dumps(data.draw(mutated(json.loads(sound)))))
        is_taken_or_refused_in_one_line(bundle_dir)
    finally:
        file.write_text(sound)


@fuzzed
@given(data=st.data())
def test_a_bundle_of_other_bytes(bundle_dir, data):
    file = bundle_dir / "bundle.json"
    sound = file.read_bytes()
    try:
        file.write_bytes(data.draw(damaged(sound)))
        is_taken_or_refused_in_one_line(bundle_dir)
    finally:
        file.write_bytes(sound)


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".webp", ".bmp"])
@settings(fuzzed, max_examples=40)
@given(data=st.data())
def test_a_picture_of_other_bytes_with_the_checksum_that_belongs_to_them(bundle_dir, capfd, suffix, data):
    picture = np.random.default_rng(1).integers(0, 256, (12, 16, 3), np.uint8)
    content = data.draw(damaged(cv2.imencode(suffix, picture)[1].tobytes()))
    fields = json.loads((bundle_dir / "bundle.json").read_text())
    (bundle_dir / fields["frames"][0]["file"]).write_bytes(content)
    fields["frames"][0]["sha256"] = hashlib.sha256(content).hexdigest()
    (bundle_dir / "bundle.json").write_text(json.dumps(fields))
    is_taken_or_refused_in_one_line(bundle_dir)
    assert capfd.readouterr() == ("", "")
