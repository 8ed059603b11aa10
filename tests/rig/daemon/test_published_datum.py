"""What is published for WGS84 holds the accuracy of the way there, and a configuration can say what a DEM does not."""

import math
from pathlib import Path

import pytest
from fakes.answers import an_answer
from pydantic import ValidationError

from localizer.dem_options import DemChoice
from localizer.fix import Position
from rig.daemon.config import RunSection
from rig.daemon.published import published


def position(crs: str, easting_m: float, northing_m: float, lat_deg: float, lon_deg: float) -> Position:
    return Position(
        easting_m=easting_m,
        northing_m=northing_m,
        crs=crs,
        lat_deg=lat_deg,
        lon_deg=lon_deg,
        ground_m=900.0,
        row=1.0,
        col=1.0,
    )


@pytest.mark.parametrize(
    ("crs", "added_m"), [("EPSG:32611", 0.0), ("EPSG:26711", 7.0), ("EPSG:26911", 4.0), ("EPSG:25832", 1.0)]
)
def test_the_sigmas_hold_the_accuracy_of_the_operation_between_the_datums(crs: str, added_m: float) -> None:
    lat_deg, lon_deg = (47.0, 9.0) if crs == "EPSG:25832" else (34.3, -117.0)
    here = position(crs, 500_000.0, 3_795_000.0, lat_deg, lon_deg)
    fix = published(an_answer(position=here, covariance_m2=((9.0, 0.0), (0.0, 4.0))))
    assert fix.sigma_east_m == pytest.approx(math.hypot(3.0, added_m), rel=0.01)
    assert fix.sigma_north_m == pytest.approx(math.hypot(2.0, added_m), rel=0.01)


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
