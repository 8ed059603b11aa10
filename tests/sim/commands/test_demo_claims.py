"""Output of ``sim demo``: the stated uncertainty with the true error, both in metres of the ground."""

import json

import numpy as np
import pytest
from fakes.answers import STAGE1
from pyproj import Geod, Transformer

from localizer.fix import Candidate, Fix, Position
from sim.commands.demo import _fields, claim_of, judge, summary
from sim.evaluate.case_result import CaseResult

GEOD = Geod(ellps="WGS84")


def a_place(crs, lat_deg, lon_deg):
    x, y = Transformer.from_crs("EPSG:4326", crs, always_xy=True).transform(lon_deg, lat_deg)
    return {"easting_m": float(x), "northing_m": float(y), "crs": crs, "lat_deg": lat_deg, "lon_deg": lon_deg}


def a_fix(crs, lat_deg, lon_deg, covariance_m2=((9.0, 0.0), (0.0, 4.0)), status="fix"):
    place = a_place(crs, lat_deg, lon_deg)
    return Fix(
        bundle="a",
        status=status,
        position=Position(**place, ground_m=500.0, row=1.0, col=1.0),
        covariance_m2=covariance_m2,
        probability=0.99,
        candidates=(
            Candidate(
                easting_m=place["easting_m"], northing_m=place["northing_m"], probability=0.99, rms_px=0.5
            ),
        ),
        stage1=STAGE1,
        residual={},
        nuisance=None,
        timing_s={"stage1": 0.1},
    )


@pytest.mark.parametrize("crs", ["EPSG:3857", "EPSG:32633"])
def test_the_error_and_the_claim_are_of_the_ground(crs):
    fix = a_fix(crs, 68.3, 15.1)
    lon_deg, lat_deg, _ = GEOD.fwd(15.1, 68.3, 90.0, 12.0)
    truth = {**a_place(crs, lat_deg, lon_deg), "ground_m": 500.0}
    outcome = judge(fix, truth)
    assert outcome.error_m == pytest.approx(12.0, abs=0.01)
    assert outcome.error_sigmas == pytest.approx(4.0, abs=0.02)
    assert not outcome.wrong  # within a cell
    assert "claimed     1 sigma 3.0 m x 2.0 m, the longer towards 90° true; 95 % within 7.3 m" in summary(
        outcome, truth
    )
    assert "true error  12.0 m (4.0 sigma)" in summary(outcome, truth)
    told = json.loads(json.dumps(_fields(outcome, truth, "bundle", "picture"), default=str))
    assert told["claimed"]["major_m"] == pytest.approx(3.0)
    assert told["error_m"] == pytest.approx(12.0, abs=0.01)


def test_a_truth_in_the_next_zone_is_the_same_place():
    fix = a_fix("EPSG:32633", 68.3, 12.1)
    truth = {**a_place("EPSG:32632", 68.3, 12.1), "ground_m": 500.0}
    assert judge(fix, truth).error_m == pytest.approx(0.0, abs=1e-3)


def test_without_a_position_nothing_is_claimed():
    none = a_fix("EPSG:32633", 68.3, 15.1).model_copy(
        update={"status": "none", "position": None, "covariance_m2": None, "candidates": ()}
    )
    assert claim_of(none) is None
    truth = {**a_place("EPSG:32633", 68.3, 15.1), "ground_m": 500.0}
    assert "claimed" not in summary(judge(none, truth), truth)


def test_an_evaluation_measures_on_the_ground():
    fix = a_fix("EPSG:3857", 68.3, 15.1)
    answer = CaseResult(fix=fix, covariances_m2=np.array([fix.covariance_m2]), errors=None, contours_px=())
    lon_deg, lat_deg, _ = GEOD.fwd(15.1, 68.3, 0.0, 6.0)
    there = a_place("EPSG:3857", lat_deg, lon_deg)
    off_m, mahalanobis2 = answer.off_by(there["easting_m"], there["northing_m"])
    assert off_m == pytest.approx(6.0, abs=0.01)
    assert mahalanobis2 == pytest.approx(9.0, abs=0.05)
    assert answer.probability_of(there["easting_m"], there["northing_m"], 6.5) == 0.99
    away = a_place("EPSG:3857", 68.31, 15.1)  # a kilometre
    assert answer.probability_of(away["easting_m"], away["northing_m"], 6.5) is None
