import json

import numpy as np
import pytest
from pydantic import ValidationError

from localizer.fix import Candidate, Fix, Nuisance, Position, Stage1Counts, ellipse, lat_lon

STAGE1 = Stage1Counts(
    cells=153036, after_altitude=4021, after={"N": 473, "E": 61, "S": 14, "W": 8}, points_explored=2149225
)


def a_fix(**changes):
    fields = {
        "bundle": "20261123T043151Z-3f9a",
        "status": "fix",
        "position": Position(
            easting_m=562310.4,
            northing_m=5116402.8,
            crs="EPSG:26910",
            lat_deg=46.199,
            lon_deg=-122.192,
            ground_m=1430.9,
            row=233.4,
            col=101.8,
        ),
        "covariance_m2": ((9.1, 0.4), (0.4, 7.7)),
        "probability": 0.999,
        "candidates": (Candidate(easting_m=562310.4, northing_m=5116402.8, probability=0.999, rms_px=0.8),),
        "stage1": STAGE1,
        "residual": {"N": 0.7},
        "nuisance": Nuisance(azimuth_bias_deg=0.4, tilt_bias_deg=0.01, altitude_bias_m=2.1),
        "timing_s": {"horizon": 0.05},
    }
    return Fix(**{**fields, **changes})


def test_the_json_is_the_contract_s():
    fields = json.loads(a_fix().to_json())
    assert list(fields) == [
        "schema",
        "bundle",
        "status",
        "position",
        "covariance_m2",
        "probability",
        "elsewhere",
        "reason",
        "candidates",
        "stage1",
        "residual",
        "nuisance",
        "timing_s",
    ]
    assert fields["schema"] == "skyfix.fix/1"
    assert fields["covariance_m2"] == [[9.1, 0.4], [0.4, 7.7]]
    assert list(fields["stage1"]["after"]) == ["N", "E", "S", "W"]
    assert Fix.model_validate_json(a_fix().to_json()) == a_fix()


def test_without_a_place_there_is_null_and_not_a_made_up_position():
    fix = a_fix(
        status="none", position=None, covariance_m2=None, probability=0.0, candidates=(), nuisance=None
    )
    assert json.loads(fix.to_json())["position"] is None


@pytest.mark.parametrize(("status", "exit_status"), [("fix", 0), ("ambiguous", 3), ("none", 4)])
def test_exit_statuses_are_the_contract_s(status, exit_status):
    assert a_fix(status=status).exit_status == exit_status


@pytest.mark.parametrize(
    "wrong",
    [
        {"status": "maybe"},
        {"probability": 1.5},
        {"probability": float("nan")},
        {"colour": "red"},
        {"position": None},
    ],
)
def test_a_fix_cannot_say_what_the_contract_does_not_know(wrong):
    with pytest.raises(ValidationError):
        a_fix(**wrong)


# ---- ellipses

TURN = np.array([[0.8, -0.6], [0.6, 0.8]])
"""Rows: axes of a frame whose first axis points 0.8 east and -0.6 north: azimuth 90 + 36.87 deg."""


def covariance(along_m: float, across_m: float):
    return tuple(map(tuple, TURN.T @ np.diag([along_m**2, across_m**2]) @ TURN))


@pytest.mark.parametrize(
    ("variances", "axes", "azimuth_deg"),
    [
        (((25.0, 0.0), (0.0, 4.0)), (5.0, 2.0), 90.0),  # east
        (((4.0, 0.0), (0.0, 25.0)), (5.0, 2.0), 0.0),  # north
        (((1.0, 1.0), (1.0, 1.0)), (np.sqrt(2.0), 0.0), 45.0),
        (((1.0, -1.0), (-1.0, 1.0)), (np.sqrt(2.0), 0.0), 135.0),
        (covariance(10.0, 3.0), (10.0, 3.0), 90.0 + np.degrees(np.arctan(0.75))),
    ],
)
def test_the_axes_of_an_ellipse_and_its_azimuth_from_north(variances, axes, azimuth_deg):
    found = ellipse(variances)
    assert (found.major_m, found.minor_m) == pytest.approx(axes, abs=1e-6)
    assert np.cos(np.radians(2.0 * (found.grid_azimuth_deg - azimuth_deg))) == pytest.approx(1.0)
    assert 0.0 <= found.grid_azimuth_deg < 180.0 + 1e-9


@pytest.mark.parametrize(
    ("confidence", "sigmas"),
    [
        (1.0 - np.exp(-0.5), 1.0),
        (0.95, 2.447747),
        (0.99, 3.034854),
    ],  # roots of chi-square quantiles, two dimensions
)
def test_an_ellipse_of_a_confidence_is_so_many_sigmas_large(confidence, sigmas):
    found = a_fix(covariance_m2=((25.0, 0.0), (0.0, 4.0))).error_ellipse(confidence)
    assert (found.semi_major_m, found.semi_minor_m, found.grid_azimuth_deg) == pytest.approx(
        (5.0 * sigmas, 2.0 * sigmas, 90.0)
    )
    assert a_fix().error_ellipse() == a_fix().error_ellipse(0.95)


@pytest.mark.parametrize("confidence", [0.0, 1.0, -0.1, 95.0])
def test_a_confidence_lies_between_0_and_1(confidence):
    with pytest.raises(ValueError, match=f"confidence: is {confidence:g}; should be between 0 and 1"):
        a_fix().error_ellipse(confidence)


def test_without_a_position_there_is_no_ellipse():
    with pytest.raises(ValueError, match="without a position has no ellipse"):
        a_fix(status="ambiguous", position=None, covariance_m2=None).error_ellipse()


@pytest.mark.parametrize("missing", [{"position": None}, {"covariance_m2": None}])
def test_only_a_fix_needs_place_and_covariance(missing):
    with pytest.raises(ValidationError, match="a fix has a position and its covariance"):
        a_fix(**missing)
    assert a_fix(status="ambiguous", **missing).status == "ambiguous"


@pytest.mark.parametrize(
    ("lat_deg", "lon_deg", "text"),
    [
        (46.199014, -122.192034, "46.19901° N  122.19203° W"),
        (-33.5, 151.25, "33.50000° S  151.25000° E"),
        (0.0, 0.0, "0.00000° N  0.00000° E"),
    ],
)
def test_a_place_is_written_with_hemispheres(lat_deg, lon_deg, text):
    position = a_fix().position.model_copy(update={"lat_deg": lat_deg, "lon_deg": lon_deg})
    assert lat_lon(position) == text
    assert position.easting_northing_m == (562310.4, 5116402.8)


@pytest.mark.parametrize("lon_deg", [237.808, -122.192])
def test_longitudes_are_wrapped(lon_deg):
    fields = {**a_fix().position.model_dump(), "lon_deg": lon_deg}
    assert Position(**fields).lon_deg == pytest.approx(-122.192)
