"""The true place, read from a file and carried into other maps."""

import json
from pathlib import Path

import numpy as np
import pytest
from affine import Affine

from localizer.dem.lattice import dem_from_array
from localizer.errors import SkyfixError
from localizer.fix import Position
from localizer.truth import Truth, load_truth

SOUND = {"easting_m": 562_310.4, "northing_m": 5_116_402.8, "crs": "EPSG:32610"}
# of that place, as PROJ 9 has it (cs2cs EPSG:32610 EPSG:4326)
LON_LAT = (-122.192400, 46.198349)


@pytest.fixture
def truth_file(tmp_path: Path):
    def write(**changes: object) -> Path:
        path = tmp_path / "truth.json"
        path.write_text(json.dumps({**SOUND, **changes}))
        return path

    return write


def test_what_else_the_simulator_writes_is_ignored(truth_file) -> None:
    assert load_truth(truth_file(altitude_m=1432.6, base={"roll_deg": 1.0})) == Truth(**SOUND)
    assert load_truth(str(truth_file())) == Truth(**SOUND)


def test_a_truth_on_another_datum_s_map_is_moved_to_where_it_lies(truth_file) -> None:
    """The same place in Web Mercator, whose x is the longitude times the equator's radius, and in the next UTM zone."""
    truth = Truth(**SOUND)
    x, y = truth.within("EPSG:3857")
    assert x == pytest.approx(6378137.0 * np.radians(LON_LAT[0]), abs=1.0)
    assert y == pytest.approx(6378137.0 * np.arctanh(np.sin(np.radians(LON_LAT[1]))), abs=1.5)
    there = truth.within("EPSG:32611")
    assert Truth(easting_m=there[0], northing_m=there[1], crs="EPSG:32611").within(
        "EPSG:32610"
    ) == pytest.approx((SOUND["easting_m"], SOUND["northing_m"]), abs=1e-3)


def test_the_distance_is_along_the_ground() -> None:
    """30 m east and 40 m north in a map whose scale is 0.99966 there: 50.02 m."""
    dem = dem_from_array(
        np.zeros((9, 9)), Affine(30.0, 0.0, 562_200.0, 0.0, -30.0, 5_116_500.0), "EPSG:32610"
    )
    position = Position(
        easting_m=SOUND["easting_m"] + 30.0,
        northing_m=SOUND["northing_m"] + 40.0,
        crs="EPSG:32610",
        lat_deg=LON_LAT[1],
        lon_deg=LON_LAT[0],
        ground_m=0.0,
        row=3.0,
        col=4.0,
    )
    assert Truth(**SOUND).distance_m(position, dem) == pytest.approx(50.0 / 0.99965, abs=2e-3)


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        (
            {"easting_m": None},
            "easting_m: Input should be a valid number; a truth has easting_m, northing_m and crs",
        ),
        ({"easting_m": 1.1e8}, "easting_m: Input should be less than or equal to"),
        ({"northing_m": -1.1e8}, "northing_m: Input should be greater than or equal to"),
        ({"northing_m": 1.1e8}, "northing_m: Input should be less than or equal to"),
        ({"easting_m": -1.1e8}, "easting_m: Input should be greater than or equal to"),
        ({"crs": ""}, "crs: String should have at least 1 character"),
        ({"crs": "EPSG:nothing"}, "crs: EPSG:nothing is not a coordinate reference system"),
        ({"crs": "EPSG:4326"}, "crs: EPSG:4326 has no eastings and northings; name a projected one"),
        ({"easting_m": 9e7, "northing_m": 9e7}, "lie where EPSG:32610 is not defined"),
    ],
)
def test_what_is_no_true_place_is_refused_with_file_and_field(truth_file, changes, complaint: str) -> None:
    path = truth_file(**changes)
    with pytest.raises(SkyfixError) as refusal:
        load_truth(path)
    assert str(refusal.value).startswith(f"{path}: ")
    assert complaint in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_a_file_that_is_not_there_and_one_that_is_no_json_are_told_apart(tmp_path: Path) -> None:
    with pytest.raises(
        SkyfixError, match=r"nowhere\.json: cannot be read: No such file or directory; correct the name"
    ):
        load_truth(tmp_path / "nowhere.json")
    (tmp_path / "truth.json").write_text("easting_m = 3")
    with pytest.raises(SkyfixError, match=r"truth\.json: .*(JSON|line 1)"):
        load_truth(tmp_path / "truth.json")
