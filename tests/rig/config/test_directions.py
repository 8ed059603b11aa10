"""Directions as an operator names them."""

import pytest

from rig.config.directions import parse_direction, parse_directions


@pytest.mark.parametrize(
    ("name", "label", "azimuth_deg"),
    [
        ("N", "N", 0.0),
        ("e", "E", 90.0),
        (" sw ", "SW", 225.0),
        ("NNW", "NNW", 337.5),
        ("45", "A045", 45.0),
        ("0", "A000", 0.0),
        ("222.5", "A222.5", 222.5),
        ("359.9", "A359.9", 359.9),
    ],
)
def test_letters_and_degrees(name: str, label: str, azimuth_deg: float) -> None:
    direction = parse_direction(name)
    assert (direction.label, direction.azimuth_deg) == (label, azimuth_deg)


@pytest.mark.parametrize("name", ["", "Q", "NORTH", "360", "-1", "nan", "inf", "N;E", "1e9"])
def test_nonsense_is_named(name: str) -> None:
    with pytest.raises(ValueError, match="is no direction"):
        parse_direction(name)


def test_the_order_is_kept() -> None:
    assert [d.label for d in parse_directions(["W", "10", "N"])] == ["W", "A010", "N"]


def test_the_same_direction_twice_is_refused() -> None:
    with pytest.raises(ValueError, match="'90' is given twice"):
        parse_directions(["N", "E", "90"])
    with pytest.raises(ValueError, match="twice"):
        parse_directions(["359.6", "N"])


def test_no_directions_at_all() -> None:
    with pytest.raises(ValueError, match="no directions"):
        parse_directions([])
