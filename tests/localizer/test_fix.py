import json

import pytest
from pydantic import ValidationError

from localizer.fix import Candidate, Fix, Nuisance, Position, Stage1Counts

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
