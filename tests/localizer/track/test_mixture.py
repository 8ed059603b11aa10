"""The mixture filter: properties of prediction and update."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from localizer.track.gaussian_place import displaced, fuse, gaussian_place, log_density, offset_m
from localizer.track.mixture import (
    Hypothesis,
    MeasuredPlace,
    Measurement,
    Mixture,
    mixture_of,
    outlier_probability,
    predict,
    update,
)
from localizer.track.odometry import Movement
from localizer.track.tracker import stands_out

AREA_M2 = 20_000.0**2
CELL_M = 30.0
HOME = gaussian_place(46.2, -122.2, np.eye(2), np.zeros((2, 2)))

metres = st.floats(-8000.0, 8000.0)
sigmas = st.floats(0.5, 60.0)


@st.composite
def covariances(draw):
    """Ellipses from round to long, in any direction."""
    major, minor, turn = draw(sigmas), draw(sigmas), draw(st.floats(0.0, np.pi))
    axes = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    return axes @ np.diag([major**2, minor**2]) @ axes.T


@st.composite
def places(draw, within_m=8000.0):
    step = np.array([draw(st.floats(-within_m, within_m)), draw(st.floats(-within_m, within_m))])
    at = displaced(HOME, step, np.zeros((2, 2)))
    covariance = draw(covariances())
    return gaussian_place(at.lat_deg, at.lon_deg, covariance, draw(st.floats(0.0, 1.0)) * covariance)


def shares(count):
    return st.lists(st.floats(0.01, 1.0), min_size=count, max_size=count)


@st.composite
def mixtures(draw, most=4):
    at = draw(st.lists(places(), min_size=1, max_size=most))
    weights = np.array(draw(shares(len(at))))
    weights *= draw(st.floats(0.05, 1.0)) / weights.sum()
    return Mixture(
        hypotheses=tuple(
            Hypothesis(place=p, probability=float(w), evidence=20.0) for p, w in zip(at, weights, strict=True)
        )
    )


@st.composite
def looks(draw, most=4):
    at = draw(st.lists(places(), min_size=1, max_size=most))
    weights = np.array(draw(shares(len(at))))
    return look(at, weights / weights.sum(), evidence=draw(st.floats(15.0, 60.0)))


def look(at, probabilities, evidence=40.0) -> Measurement:
    return Measurement(
        measured=tuple(
            MeasuredPlace(n, p, float(q), evidence)
            for n, (p, q) in enumerate(zip(at, probabilities, strict=True))
        ),
        outlier_probability=outlier_probability(evidence),
        area_m2=AREA_M2,
        model_error_m=0.25 * CELL_M,
        same_m=2.0 * CELL_M,
    )


def at_m(east_m: float, north_m: float, sigma_m: float = 5.0):
    at = displaced(HOME, np.array([east_m, north_m]), np.zeros((2, 2)))
    return gaussian_place(at.lat_deg, at.lon_deg, sigma_m**2 * np.eye(2), 0.5 * sigma_m**2 * np.eye(2))


def believing(*hypotheses, evidence: float = 40.0) -> Mixture:
    return Mixture(
        hypotheses=tuple(Hypothesis(place=p, probability=q, evidence=evidence) for p, q in hypotheses)
    )


def total(posteriors) -> float:
    return sum(p.hypothesis.probability for p in posteriors)


# ---- places


@given(places(), metres, metres)
def test_a_place_moved_lies_where_the_step_leads(start, east_m, north_m):
    step = np.array([east_m, north_m])
    assert offset_m(start, displaced(start, step, np.zeros((2, 2)))) == pytest.approx(step, abs=1e-3)


@given(places(40.0), places(40.0))
def test_two_views_of_one_place_fused_cover_no_larger_area_than_either(one, two):
    both = np.linalg.det(fuse(one, two).covariance)
    assert both <= min(np.linalg.det(one.covariance), np.linalg.det(two.covariance)) * (1.0 + 1e-5)


@given(places(40.0), places(40.0))
def test_it_does_not_matter_which_of_two_views_is_first(one, two):
    there, back = fuse(one, two), fuse(two, one)
    assert np.abs(offset_m(there, back)).max() < 0.5
    assert there.covariance == pytest.approx(back.covariance, rel=0.02, abs=0.02)


def test_independent_views_share_the_error_and_a_common_one_stays():
    independent = gaussian_place(46.2, -122.2, 100.0 * np.eye(2), np.zeros((2, 2)))
    common = gaussian_place(46.2, -122.2, 100.0 * np.eye(2), 100.0 * np.eye(2))
    assert fuse(independent, independent).covariance == pytest.approx(50.0 * np.eye(2), rel=1e-3)
    assert fuse(common, common).covariance == pytest.approx(100.0 * np.eye(2), rel=1e-3)
    half = gaussian_place(46.2, -122.2, 100.0 * np.eye(2), 50.0 * np.eye(2))
    for _ in range(50):
        half = fuse(half, gaussian_place(46.2, -122.2, 100.0 * np.eye(2), 50.0 * np.eye(2)))
    assert half.covariance[0, 0] > 49.0  # any number of looks leaves what they all share


def test_the_density_of_one_place_is_the_gaussians():
    one, two = at_m(0.0, 0.0, 30.0), at_m(50.0, 0.0, 40.0)
    expected = np.exp(-0.5 * 1.0) / (2.0 * np.pi * 50.0**2)
    assert np.exp(log_density(one, two, 0.0)) == pytest.approx(expected, rel=1e-3)


# ---- movements


@given(mixtures(), covariances())
def test_a_movement_keeps_the_hypotheses_and_widens_them(mixture, covariance_m2):
    after = predict(mixture, Movement(np.array([200.0, 0.0]), covariance_m2), AREA_M2)
    assert len(after.hypotheses) == len(mixture.hypotheses)
    for was, now in zip(mixture.hypotheses, after.hypotheses, strict=True):
        assert now.probability == pytest.approx(0.99 * was.probability)
        assert now.place.covariance == pytest.approx(was.place.covariance + covariance_m2)


@given(mixtures())
def test_an_unknown_movement_or_one_without_bounds_leaves_nothing_known(mixture):
    assert predict(mixture, None, AREA_M2).elsewhere == 1.0
    anywhere = Movement(np.zeros(2), 1e10 * np.eye(2))
    assert predict(mixture, anywhere, AREA_M2).elsewhere == 1.0


# ---- looks


@given(mixtures(), looks())
def test_probabilities_stay_probabilities(mixture, seen):
    posteriors = update(mixture, seen)
    assert all(0.0 <= p.hypothesis.probability <= 1.0 for p in posteriors)
    assert total(posteriors) <= 1.0 + 1e-9
    falling = [p.hypothesis.probability for p in posteriors]
    assert falling == sorted(falling, reverse=True)


@given(mixtures(), looks(), st.randoms(use_true_random=False))
def test_the_order_of_the_hypotheses_does_not_matter(mixture, seen, random):
    turned = list(mixture.hypotheses)
    random.shuffle(turned)
    one, two = update(mixture, seen), update(Mixture(hypotheses=tuple(turned)), seen)
    assert [p.hypothesis.probability for p in one] == pytest.approx([p.hypothesis.probability for p in two])


@given(looks())
def test_without_a_history_the_posterior_is_that_of_the_measurement(seen):
    posteriors = update(Mixture(), seen)
    assert total(posteriors) == pytest.approx(1.0 - seen.outlier_probability, abs=1e-5)
    for p in posteriors:
        assert p.number is not None
        alike = [s for s in seen.measured if np.hypot(*offset_m(s.place, p.hypothesis.place)) < 3000.0]
        assert p.hypothesis.probability <= sum(s.probability for s in alike) + 1e-9


@given(mixtures(), looks())
def test_odometry_that_says_nothing_changes_nothing(mixture, seen):
    lost = predict(mixture, Movement(np.zeros(2), 1e10 * np.eye(2)), AREA_M2)
    assert update(lost, seen) == update(Mixture(), seen)


def test_a_measurement_that_agrees_with_one_of_two_hypotheses_selects_it():
    believed = predict(
        believing((at_m(0, 0), 0.5), (at_m(4000, 0), 0.5)),
        Movement(np.array([200.0, 0.0]), 16 * np.eye(2)),
        AREA_M2,
    )
    first, *_ = update(believed, look([at_m(200, 0), at_m(-3000, 1000)], [0.5, 0.5]))
    assert first.hypothesis.probability > 0.999
    assert first.number == 0
    assert stands_out(first.hypothesis, CELL_M)
    assert first.hypothesis.place.widest_m < 5.0


def test_a_measurement_that_agrees_with_no_hypothesis_replaces_the_history():
    believed = predict(
        believing((at_m(0, 0), 0.999)), Movement(np.array([200.0, 0.0]), 16 * np.eye(2)), AREA_M2
    )
    first, *_ = update(believed, look([at_m(5000, 0)], [1.0], evidence=150.0))
    assert first.hypothesis.probability > 0.999
    assert np.abs(offset_m(first.hypothesis.place, at_m(5000, 0))).max() < 1.0


@pytest.mark.parametrize("evidence", [20.0, 30.0, 40.0])
def test_one_weak_measurement_does_not_replace_the_history(evidence):
    believed = predict(
        believing((at_m(0, 0), 0.999)), Movement(np.array([200.0, 0.0]), 16 * np.eye(2)), AREA_M2
    )
    posteriors = update(believed, look([at_m(5000, 0)], [1.0], evidence=evidence))
    assert not any(stands_out(p.hypothesis, CELL_M) for p in posteriors if p.number is not None)
    assert posteriors[0].number is None


def test_two_weak_measurements_joined_by_odometry_are_a_fix_and_either_alone_is_not():
    alone = update(Mixture(), look([at_m(0, 0)], [1.0], evidence=17.0))
    assert not stands_out(alone[0].hypothesis, CELL_M)
    believed = predict(mixture_of(alone), Movement(np.array([200.0, 0.0]), 16 * np.eye(2)), AREA_M2)
    joined = update(believed, look([at_m(203, 2)], [1.0], evidence=17.0))
    assert stands_out(joined[0].hypothesis, CELL_M)
    apart = update(believed, look([at_m(3000, 2)], [1.0], evidence=17.0))
    assert not any(stands_out(p.hypothesis, CELL_M) for p in apart)


def test_two_long_ellipses_that_cross_become_one_small_one():
    def long(east_sigma_m, north_sigma_m):
        return gaussian_place(46.2, -122.2, np.diag([east_sigma_m**2, north_sigma_m**2]), np.zeros((2, 2)))

    known = update(Mixture(), look([long(300.0, 10.0)], [1.0]))
    assert not stands_out(known[0].hypothesis, CELL_M)
    crossed = update(mixture_of(known), look([long(10.0, 300.0)], [1.0]))
    assert stands_out(crossed[0].hypothesis, CELL_M)
    assert crossed[0].hypothesis.place.widest_m < 11.0


def test_a_hypothesis_that_a_weak_measurement_lacks_is_kept_but_marked_as_not_seen():
    believed = believing((at_m(0, 0), 0.99))
    posteriors = update(believed, look([at_m(5000, 0)], [1.0], evidence=15.0))
    old = [p for p in posteriors if p.number is None]
    assert len(old) == 1
    assert old[0].hypothesis.probability > 0.5
