"""What is published for WGS84 holds the accuracy of the way there, and a configuration can say what a DEM does not."""

import dataclasses
import json
import math
from pathlib import Path

import pytest
from fakes.answers import an_answer
from pydantic import ValidationError

from localizer.dem.choice import DemChoice
from rig.config.run import RunSection
from rig.daemon.publish.published import published
from rig.daemon.spool.index import ANSWER


@pytest.mark.parametrize("added_m", [0.0, 1.0, 7.0, 15.0])
def test_the_sigmas_hold_the_accuracy_of_the_operation_between_the_datums(added_m: float) -> None:
    plain = published(an_answer(covariance_m2=((9.0, 0.0), (0.0, 4.0))))
    answer = dataclasses.replace(an_answer(covariance_m2=((9.0, 0.0), (0.0, 4.0))), wgs84_accuracy_m=added_m)
    fix = published(answer)
    assert fix.sigma_east_m == pytest.approx(math.hypot(plain.sigma_east_m, added_m))
    assert fix.sigma_north_m == pytest.approx(math.hypot(plain.sigma_north_m, added_m))
    assert fix.sigma_minor_m == pytest.approx(math.hypot(plain.sigma_minor_m, added_m))


def test_the_accuracy_outlives_a_restart_and_an_index_without_it_is_read() -> None:
    answer = dataclasses.replace(an_answer(), wgs84_accuracy_m=7.0)
    stored = json.loads(ANSWER.dump_json(answer, by_alias=True))
    assert ANSWER.validate_json(json.dumps(stored)).wgs84_accuracy_m == 7.0
    del stored["wgs84_accuracy_m"]
    assert ANSWER.validate_json(json.dumps(stored)).wgs84_accuracy_m == 0.0


def test_a_configuration_says_of_a_dem_what_the_options_say() -> None:
    run = RunSection.model_validate(
        {
            "dem": ["NETCDF:terrain.nc:dem"],
            "dem_vertical_unit": "dm",
            "dem_crs": "EPSG:4326",
            "dem_nodata": -9999.0,
            "dem_band": 2,
            "dem_scale": 0.1,
            "dem_geoid_offset_m": -33.5,
        }
    )
    choice = run.chosen_dem
    assert choice == DemChoice(
        (Path("NETCDF:terrain.nc:dem"),), "dm", "EPSG:4326", -9999.0, None, 2, 0.1, -33.5
    )
    assert DemChoice.from_fields(choice.to_fields()) == choice


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("dem_vertical_unit", "furlong"),
        ("dem_band", 0),
        ("dem_scale", float("nan")),
        ("dem_geoid_offset_m", 500.0),
        ("dem_geoid_offset_m", float("inf")),
        ("dem_crs", ""),
    ],
)
def test_nonsense_of_a_dem_is_refused(key: str, value: object) -> None:
    with pytest.raises(ValidationError, match=key):
        RunSection.model_validate({"dem": ["a.tif"], key: value})
