"""Odometry says how a vehicle moved and how surely, or is refused with the file and the line."""

import json

import numpy as np
import pytest

from localizer.track.odometry import Movement, OdometryError, load_odometry, parse_leg

DISTANCE = {"distance_m": 200, "distance_sigma_m": 4, "heading_deg": 90, "heading_sigma_deg": 2}
VECTOR = {"east_m": 200, "north_m": 0, "sigma_m": 5}


def leg(**fields):
    return parse_leg(json.dumps(fields))


def test_a_heading_of_90_leads_east_and_its_error_lies_across():
    displaced = leg(**DISTANCE)
    assert displaced.step_m == pytest.approx([200.0, 0.0], abs=0.2)
    assert np.sqrt(np.diag(displaced.covariance_m2)) == pytest.approx(
        [4.0, 200.0 * np.radians(2.0)], rel=0.01
    )


@pytest.mark.parametrize("heading_sigma_deg", [3.0, 40.0, 180.0])
def test_mean_and_covariance_are_those_of_many_drives(heading_sigma_deg):
    displaced = leg(
        distance_m=300.0, distance_sigma_m=20.0, heading_deg=30.0, heading_sigma_deg=heading_sigma_deg
    )
    rng = np.random.default_rng(1)
    distance_m = rng.normal(300.0, 20.0, 400_000)
    heading = np.radians(rng.normal(30.0, heading_sigma_deg, 400_000))
    ends = np.stack([distance_m * np.sin(heading), distance_m * np.cos(heading)])
    assert displaced.step_m == pytest.approx(ends.mean(axis=1), abs=1.5)
    assert displaced.covariance_m2 == pytest.approx(np.cov(ends), rel=0.02, abs=0.004 * 300.0**2)


def test_a_vector_has_its_own_covariance():
    displaced = leg(east_m=-20, north_m=7.5, covariance_m2=[[25, 3], [3, 16]])
    assert displaced.step_m == pytest.approx([-20.0, 7.5])
    assert displaced.covariance_m2 == pytest.approx(np.array([[25.0, 3.0], [3.0, 16.0]]))
    assert leg(**VECTOR).covariance_m2 == pytest.approx(25.0 * np.eye(2))


def test_nothing_is_known_of_an_unknown_leg():
    assert leg(unknown=True) is None


def test_a_file_has_one_line_a_leg_with_comments_and_gaps(tmp_path):
    file = tmp_path / "legs.jsonl"
    file.write_text(f"# from the farm\n{json.dumps(DISTANCE)}\n\n{json.dumps({'unknown': True})}\n")
    first, second = load_odometry(file, 2)
    assert first.step_m == pytest.approx([200.0, 0.0], abs=0.2)
    assert second is None


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({**DISTANCE, "distance_sigma_m": 0}, ["distance_sigma_m", "greater than 0", "got 0"]),
        ({**DISTANCE, "heading_sigma_deg": -2}, ["heading_sigma_deg", "greater than 0"]),
        ({**DISTANCE, "heading_sigma_deg": float("nan")}, ["heading_sigma_deg"]),
        ({**DISTANCE, "distance_m": float("inf")}, ["distance_m"]),
        ({**DISTANCE, "distance_m": -5}, ["distance_m", "greater than or equal to 0"]),
        ({**DISTANCE, "heading_deg": "east"}, ["heading_deg", "number"]),
        ({"distance_m": 5}, ["distance_sigma_m", "required"]),
        ({**DISTANCE, "east_m": 5}, ["east_m", "not a field"]),
        ({**VECTOR, "sigma_m": 0.0}, ["sigma_m", "greater than 0"]),
        ({**VECTOR, "sigma_m": True}, ["sigma_m"]),
        ({"east_m": 1, "north_m": 2}, ["sigma_m or covariance_m2"]),
        ({**VECTOR, "covariance_m2": [[1, 0], [0, 1]]}, ["one of both"]),
        ({"east_m": 1, "north_m": 2, "covariance_m2": [[1, 2], [2, 1]]}, ["positive definite"]),
        ({"east_m": 1, "north_m": 2, "covariance_m2": [[1, 2], [0, 5]]}, ["symmetric"]),
        ({"east_m": 1, "north_m": 2, "covariance_m2": [[1, 0]]}, ["covariance_m2"]),
        ({"east_m": 1, "north_m": 2, "covariance_m2": [[float("nan"), 0], [0, 1]]}, ["covariance_m2"]),
        ({"unknown": False}, ["unknown"]),
        ({}, ["says nothing of a movement", "distance_m"]),
    ],
)
def test_bad_legs_are_refused_with_file_line_and_field(tmp_path, fields, words):
    file = tmp_path / "legs.jsonl"
    file.write_text(f"{json.dumps(VECTOR)}\n{json.dumps(fields)}\n")
    with pytest.raises(OdometryError) as refusal:
        load_odometry(file, 2)
    message = str(refusal.value)
    assert message.startswith(f"{file}:2: ")
    assert "\n" not in message
    for word in words:
        assert word in message


@pytest.mark.parametrize("text", ["east 200", "[1, 2]", "3", '{"east_m": 1,'])
def test_what_is_no_json_object_is_refused(tmp_path, text):
    file = tmp_path / "legs.jsonl"
    file.write_text(text)
    with pytest.raises(OdometryError, match=r":1: is no JSON object"):
        load_odometry(file, 1)


def test_the_number_of_legs_must_fit_the_bundles(tmp_path):
    file = tmp_path / "legs.jsonl"
    file.write_text(json.dumps(VECTOR))
    with pytest.raises(OdometryError, match="has 1 legs, but 3 bundles have 2 between them"):
        load_odometry(file, 2)


def test_files_that_cannot_be_read_are_refused(tmp_path):
    with pytest.raises(OdometryError, match="No such file"):
        load_odometry(tmp_path / "none.jsonl", 1)
    (tmp_path / "picture").write_bytes(b"\x89PNG\xff\xfe")
    with pytest.raises(OdometryError, match="is no text"):
        load_odometry(tmp_path / "picture", 1)


def test_a_program_makes_a_movement_of_distance_and_heading(tmp_path):
    file = tmp_path / "legs.jsonl"
    file.write_text('{"distance_m": 200, "distance_sigma_m": 4, "heading_deg": 90, "heading_sigma_deg": 2}\n')
    (leg,) = load_odometry(str(file))
    made = Movement.from_heading(200.0, 90.0, distance_sigma_m=4.0, heading_sigma_deg=2.0)
    assert np.array_equal(made.step_m, leg.step_m)
    assert np.array_equal(made.covariance_m2, leg.covariance_m2)


def test_a_movement_out_of_range_is_refused_in_one_line():
    with pytest.raises(OdometryError, match=r"^heading_sigma_deg: .* \(got 0.0\)$"):
        Movement.from_heading(200.0, 90.0, distance_sigma_m=4.0, heading_sigma_deg=0.0)
