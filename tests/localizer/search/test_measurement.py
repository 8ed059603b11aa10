"""`localizer.locate` with contours of one's own."""

import dataclasses

import numpy as np
import pytest
from seen_from import PLACE, observe

import localizer
from localizer.dem.prepared import prepared
from localizer.skyline.find import Skyline


@pytest.fixture(scope="module")
def dem(request: pytest.FixtureRequest) -> localizer.Dem:
    return localizer.load_dem(request.config.rootpath / "sim" / "terrain" / "santa_cruz_srtm_1s.tif")


@pytest.fixture(scope="module")
def observation(dem: localizer.Dem) -> localizer.Observation:
    return observe(prepared(dem))


@pytest.fixture(scope="module")
def result(dem: localizer.Dem, observation: localizer.Observation) -> localizer.LocateResult:
    return localizer.locate(observation, dem, name="mine")


def test_contours_are_located(result: localizer.LocateResult) -> None:
    fix = result.fix
    assert (fix.status, fix.bundle) == ("fix", "mine")
    assert (fix.position.row, fix.position.col) == pytest.approx(PLACE, abs=0.2)


def test_the_details_have_the_contours_and_the_skyline_from_the_fix_beside_them(
    result: localizer.LocateResult, observation: localizer.Observation
) -> None:
    for detail, frame in zip(result.details.frames, observation.frames, strict=True):
        assert detail.label == frame.label
        assert np.array_equal(detail.found_v_px, frame.v_px)
        predicted = np.interp(frame.u_px, detail.predicted_u_px, detail.predicted_v_px)
        assert np.sqrt(np.mean((predicted - frame.v_px) ** 2)) < 0.5
        assert detail.predicted_u_px[[0, -1]] == pytest.approx(frame.u_px[[0, -1]], abs=2.0)


def test_the_ellipse_of_39_percent_has_the_standard_deviations(result: localizer.LocateResult) -> None:
    ellipse = result.fix.error_ellipse(1.0 - np.exp(-0.5))
    variances = np.linalg.eigvalsh(np.array(result.fix.covariance_m2))
    assert (ellipse.semi_minor_m, ellipse.semi_major_m) == pytest.approx(np.sqrt(variances))
    assert result.fix.error_ellipse().semi_major_m == pytest.approx(2.4477 * ellipse.semi_major_m, rel=1e-4)


def test_a_prior_circle_elsewhere_leaves_no_place(
    dem: localizer.Dem, observation: localizer.Observation
) -> None:
    blind = dataclasses.replace(observation, altitude_m=None, altitude_sigma_m=np.inf)
    nearby = localizer.PriorCircle(37.15, -122.10, 60.0)
    fix = localizer.locate(blind, dem, prior=nearby).fix
    assert fix.status == "none"
    assert fix.stage1.after_altitude < 30
    with pytest.raises(ValueError, match="without a position"):
        fix.error_ellipse()


def test_a_confidence_out_of_range_is_refused(result: localizer.LocateResult) -> None:
    with pytest.raises(ValueError, match="confidence"):
        result.fix.error_ellipse(95.0)


def test_skylines_of_a_finder_of_ones_own_replace_those_found(bundle_dir) -> None:
    bundle = localizer.load_bundle(str(bundle_dir))
    width = bundle.camera.width_px
    mine = Skyline(np.full(width, 6.0), np.full(width, 0.5), np.ones(width), np.zeros(width, np.uint8))
    observation = localizer.observation_from_bundle(bundle, [mine, mine])
    assert [frame.v_px.tolist() for frame in observation.frames] == [[6.0] * width] * 2
    with pytest.raises(ValueError, match="are 1 for 2 frames"):
        localizer.observation_from_bundle(bundle, [mine])


def test_the_name_of_a_bundle_is_no_measurement(dem: localizer.Dem) -> None:
    with pytest.raises(
        TypeError, match=r"is a str; give a Bundle, as load_bundle reads it, or an Observation"
    ):
        localizer.locate("bundles/first", dem)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "circle", [(91.0, 0.0, 1.0), (0.0, np.nan, 1.0), (0.0, 0.0, 0.0), (0.0, 0.0, np.inf)]
)
def test_a_circle_that_is_none_is_refused(circle: tuple[float, float, float]) -> None:
    with pytest.raises(ValueError, match="circle of"):
        localizer.PriorCircle(*circle)
