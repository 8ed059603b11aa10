"""Odometry, truths, stored tracks: whatever their files hold, they are taken or refused in one line."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from localizer.errors import SkyfixError
from localizer.track.odometry import load_odometry
from localizer.track.tracker import Tracker
from localizer.truth import Truth, load_truth

numbers = st.one_of(
    st.integers(-(10**20), 10**20), st.floats(), st.sampled_from([0, -1, 360, 1e-300, 1e300, 10**400])
)
values = st.recursive(
    st.none() | st.booleans() | numbers | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=6), inner, max_size=3),
    max_leaves=5,
)
FIELDS = [
    *("distance_m", "distance_sigma_m", "heading_deg", "heading_sigma_deg"),
    *("east_m", "north_m", "sigma_m", "covariance_m2", "unknown"),
]
legs = st.dictionaries(st.sampled_from(FIELDS), values, max_size=5).map(json.dumps)
sound_legs = [
    '{"distance_m": 200, "distance_sigma_m": 4, "heading_deg": 90, "heading_sigma_deg": 2}',
    '{"east_m": 200, "north_m": 0, "covariance_m2": [[25, 0], [0, 16]]}',
]
anything = st.one_of(st.binary(max_size=60), values.map(lambda v: json.dumps(v).encode()))
written = settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)


def taken_or_refused(read: Callable[[], Any], says: str = "") -> Any:
    """What was read; None if that was refused, in one printable line that starts with ``says``."""
    try:
        return read()
    except SkyfixError as error:
        refusal = str(error)
    assert refusal.startswith(says)
    assert refusal.isprintable()
    return None


@written
@given(content=st.one_of(anything, st.lists(legs | st.sampled_from(sound_legs), max_size=3).map("\n".join)))
def test_odometry(tmp_path: Path, content: bytes | str) -> None:
    file = tmp_path / "legs.jsonl"
    file.write_bytes(content if isinstance(content, bytes) else content.encode())
    odometry = taken_or_refused(lambda: load_odometry(file, 2), str(file))
    assert odometry is None or len(odometry) == 2


@written
@given(
    content=st.one_of(
        anything,
        st.fixed_dictionaries(
            {"easting_m": numbers, "northing_m": numbers, "crs": values | st.just("EPSG:32610")}
        ).map(lambda fields: json.dumps(fields).encode()),
    )
)
def test_truth(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "truth.json"
    file.write_bytes(content)
    truth = taken_or_refused(lambda: load_truth(file), str(file))
    assert truth is None or isinstance(truth, Truth)


@given(
    content=st.one_of(
        anything,
        st.fixed_dictionaries(
            {
                "schema": st.just("skyfix.tracker/1") | values,
                "now": values,
                "before": values,
                "since_m": values,
            }
        ).map(lambda fields: json.dumps(fields).encode()),
    )
)
def test_a_stored_track(content: bytes) -> None:
    tracker = taken_or_refused(lambda: Tracker.from_json(content), "state of a track")
    assert tracker is None or Tracker.from_json(tracker.to_json()) == tracker


@pytest.mark.parametrize("name", ["legs.jsonl", "truth.json"])
def test_a_folder_in_place_of_a_file(tmp_path: Path, name: str) -> None:
    (tmp_path / name).mkdir()
    read = load_truth if name == "truth.json" else lambda file: load_odometry(file, 1)
    with pytest.raises(SkyfixError, match="directory"):
        read(tmp_path / name)
