"""The mixture filter against numbers worked out by hand, and against samples."""

import numpy as np
import pytest

from localizer.track.gaussian_place import (
    GaussianPlace,
    displaced,
    fuse,
    gaussian_place,
    log_density,
    matrix,
    merged,
    offset_m,
)
from localizer.track.mixture import (
    Hypothesis,
    MeasuredPlace,
    Measurement,
    Mixture,
    outlier_probability,
    predict,
    update,
)
from localizer.track.odometry import Movement

HOME = gaussian_place(46.2, -122.2, np.eye(2), np.zeros((2, 2)))
AREA_M2 = 10_000.0**2
NOTHING = np.zeros((2, 2))


def at_m(
    east_m: float,
    north_m: float = 0.0,
    covariance: np.ndarray | float = 25.0,
    common: np.ndarray | float = 0.0,
) -> GaussianPlace:
    """A place so far from HOME; a number for a covariance is the variance in each direction."""
    there = displaced(HOME, np.array([east_m, north_m]), NOTHING)
    whole, shared = (np.asarray(c) if np.ndim(c) else c * np.eye(2) for c in (covariance, common))
    return gaussian_place(there.lat_deg, there.lon_deg, whole, shared)


def believing(*hypotheses: tuple[GaussianPlace, float], evidence: float = 40.0) -> Mixture:
    return Mixture(
        hypotheses=tuple(Hypothesis(place=p, probability=q, evidence=evidence) for p, q in hypotheses)
    )


def measured(
    *candidates: tuple[GaussianPlace, float],
    outlier: float = 0.2,
    model_error_m: float = 0.0,
    same_m: float = 60.0,
    evidence: float = 30.0,
) -> Measurement:
    return Measurement(
        tuple(MeasuredPlace(n, p, q, evidence) for n, (p, q) in enumerate(candidates)),
        outlier,
        AREA_M2,
        model_error_m,
        same_m,
    )


# ---- places


def test_merged_places_have_the_mean_and_the_covariance_of_the_mixture():
    """0.75 at 0 and 0.25 at (60, 20) m: mean (15, 5); 0.75 * 15^2 + 0.25 * 45^2 = 675 east, a third of that and a ninth."""
    one = merged([at_m(0.0, covariance=100.0), at_m(60.0, 20.0, covariance=400.0)], [3.0, 1.0])
    assert offset_m(HOME, one) == pytest.approx([15.0, 5.0], abs=1e-3)
    within = 0.75 * 100.0 + 0.25 * 400.0
    assert one.covariance == pytest.approx(
        np.array([[within + 675.0, 225.0], [225.0, within + 75.0]]), rel=1e-4
    )


def test_merged_places_have_the_moments_of_samples():
    places = [
        at_m(0.0, covariance=np.array([[90.0, 30.0], [30.0, 50.0]])),
        at_m(25.0, -30.0, covariance=60.0),
        at_m(-10.0, 12.0, covariance=np.array([[20.0, -5.0], [-5.0, 10.0]])),
    ]
    share = np.array([0.5, 0.2, 0.3])
    rng = np.random.default_rng(1)
    counts = (400_000 * share).astype(int)
    samples = np.vstack(
        [
            rng.multivariate_normal(offset_m(HOME, p), p.covariance, n)
            for p, n in zip(places, counts, strict=True)
        ]
    )
    one = merged(places, list(10.0 * share))
    assert offset_m(HOME, one) == pytest.approx(samples.mean(axis=0), abs=0.15)
    assert one.covariance == pytest.approx(np.cov(samples.T), rel=0.02, abs=2.0)


def test_the_common_part_of_merged_places_is_the_mean_of_theirs_without_their_spread():
    one = merged([at_m(0.0, common=4.0), at_m(60.0, common=20.0)], [1.0, 3.0])
    assert one.common == pytest.approx(16.0 * np.eye(2), abs=1e-6)


def test_a_place_after_a_leg_has_its_covariance_and_the_leg_s():
    start = at_m(0.0, covariance=100.0, common=36.0)
    there = displaced(start, np.array([300.0, -400.0]), np.array([[9.0, 2.0], [2.0, 4.0]]))
    assert offset_m(start, there) == pytest.approx([300.0, -400.0], abs=1e-3)
    assert there.covariance == pytest.approx(np.array([[109.0, 2.0], [2.0, 104.0]]))
    assert there.common == pytest.approx(36.0 * np.eye(2), abs=1e-6)


def test_the_density_has_both_covariances_and_the_model_s_error():
    """30 m east and 40 m north, variances 300 + 500 + 10^2 = 900 in each direction: exp(-0.5 * 2500 / 900) / (2 pi 900)."""
    found = log_density(at_m(0.0, covariance=300.0), at_m(30.0, 40.0, covariance=500.0), 10.0)
    assert found == pytest.approx(-2500.0 / 1800.0 - np.log(2.0 * np.pi * 900.0), rel=1e-5)


def test_independent_places_are_fused_by_their_information():
    one, two = np.diag([100.0, 25.0]), np.array([[50.0, 20.0], [20.0, 100.0]])
    fused = fuse(at_m(0.0, covariance=one), at_m(20.0, -10.0, covariance=two))
    covariance = np.linalg.inv(np.linalg.inv(one) + np.linalg.inv(two))
    assert fused.covariance == pytest.approx(covariance, rel=1e-3)
    assert fused.common == pytest.approx(NOTHING, abs=0.05)
    assert offset_m(HOME, fused) == pytest.approx(covariance @ np.linalg.solve(two, [20.0, -10.0]), abs=0.01)


def test_half_of_the_error_in_common_leaves_three_quarters():
    """Both count as 50 / 0.5 + 50 = 150; together 75, of which 2 * 50 / 4 is independent."""
    fused = fuse(at_m(0.0, covariance=100.0, common=50.0), at_m(10.0, covariance=100.0, common=50.0))
    assert fused.covariance == pytest.approx(75.0 * np.eye(2), rel=1e-3, abs=1e-6)
    assert fused.common == pytest.approx(50.0 * np.eye(2), rel=1e-3, abs=1e-6)
    assert offset_m(HOME, fused) == pytest.approx([5.0, 0.0], abs=0.01)


def test_the_surer_of_two_places_stands_if_the_other_adds_nothing():
    sure = at_m(0.0, covariance=1.0, common=1.0)
    unsure = at_m(3.0, covariance=100.0, common=100.0)
    assert fuse(sure, unsure) == fuse(unsure, sure) == sure


@pytest.mark.parametrize(
    ("covariance", "common"),
    [
        (((1.0, 0.5), (0.4, 1.0)), ((0.0, 0.0), (0.0, 0.0))),  # not symmetric
        (((1.0, 2.0), (2.0, 1.0)), ((0.0, 0.0), (0.0, 0.0))),  # not positive
        (((1.0, 0.0), (0.0, 1.0)), ((1.1, 0.0), (0.0, 0.5))),  # more in common than there is
        (((1.0, 0.0), (0.0, 1.0)), ((-0.1, 0.0), (0.0, 0.5))),
    ],
)
def test_what_is_no_covariance_is_refused(covariance, common):
    with pytest.raises(ValueError, match="a covariance is symmetric and positive, and holds its common part"):
        GaussianPlace(lat_deg=0.0, lon_deg=0.0, covariance_enu_m2=covariance, common_enu_m2=common)


def test_the_widest_direction_of_a_turned_ellipse():
    turn = np.array([[0.8, -0.6], [0.6, 0.8]])
    assert at_m(0.0, covariance=turn @ np.diag([900.0, 4.0]) @ turn.T).widest_m == pytest.approx(30.0)


def test_a_matrix_is_made_symmetric():
    assert matrix(np.array([[1.0, 2.0], [4.0, 5.0]])) == ((1.0, 3.0), (3.0, 5.0))


# ---- movements


def test_odometry_fails_in_one_leg_of_a_hundred():
    leg = Movement(np.array([200.0, 0.0]), 4.0 * np.eye(2))
    mixture = believing((at_m(0.0), 0.75), (at_m(900.0), 0.25))
    after = predict(mixture, leg, AREA_M2)
    assert [h.probability for h in after.hypotheses] == pytest.approx([0.99 * 0.75, 0.99 * 0.25])
    assert after.elsewhere == pytest.approx(0.01)
    for _ in range(9):
        after = predict(after, leg, AREA_M2)
    assert after.elsewhere == pytest.approx(1.0 - 0.904382, abs=1e-6)  # 0.99^10
    assert offset_m(HOME, after.hypotheses[0].place) == pytest.approx([2000.0, 0.0], abs=0.5)
    assert [h.evidence for h in after.hypotheses] == [40.0, 40.0]


@pytest.mark.parametrize(("sigma_m", "kept"), [(4999.0, 1), (5001.0, 0)])
def test_a_place_wider_than_half_the_dem_s_side_is_lost(sigma_m, kept):
    after = predict(
        believing((at_m(0.0, covariance=0.0), 1.0)), Movement(np.zeros(2), sigma_m**2 * np.eye(2)), AREA_M2
    )
    assert len(after.hypotheses) == kept


# ---- measurements


@pytest.mark.parametrize(
    ("evidence", "probability"),
    [(15.0, 0.5), (23.0, 1.0 / (1.0 + np.e)), (7.0, np.e / (1.0 + np.e)), (39.0, 1.0 / (1.0 + np.e**3))],
)
def test_a_measurement_s_odds_rise_by_e_every_8_of_evidence(evidence, probability):
    assert outlier_probability(evidence) == pytest.approx(probability)


def test_extreme_evidence_is_a_certainty_and_no_overflow():
    assert outlier_probability(1e6) == pytest.approx(0.0, abs=1e-200)
    assert outlier_probability(-1e6) == 1.0


def test_the_weights_of_a_measurement_that_agrees_are_worked_out_by_hand():
    """Believed 0.9 at 0, 0.1 elsewhere; one candidate 30 m east, in error by 0.2.

    Elsewhere and in error 0.1 * 0.2; the candidate alone 0.1 * 0.8; the believed place alone 0.9 * 0.2; both one place
    0.9 * 0.8 * area * density, with variances 400 + 400 + 10^2 = 900: 1e8 exp(-0.5) / (2 pi 900) = 10725.8.
    """
    posteriors = update(
        believing((at_m(0.0, covariance=400.0), 0.9)),
        measured((at_m(30.0, covariance=400.0), 1.0), model_error_m=10.0, same_m=1.0),
    )
    agree = 1e8 * np.exp(-0.5) / (2.0 * np.pi * 900.0)
    weights = {"neither": 0.1 * 0.2, "new": 0.1 * 0.8, "old": 0.9 * 0.2, "both": 0.9 * 0.8 * agree}
    total = sum(weights.values())
    # the candidate lies within a sigma of the fused place, and is merged with it
    seen, unseen = posteriors
    assert (seen.number, unseen.number) == (0, None)
    assert seen.hypothesis.probability == pytest.approx((weights["both"] + weights["new"]) / total, abs=1e-6)
    assert unseen.hypothesis.probability == pytest.approx(weights["old"] / total, rel=1e-3)
    assert seen.hypothesis.evidence == 70.0  # both measurements
    assert unseen.hypothesis.evidence == 40.0
    assert offset_m(HOME, seen.hypothesis.place) == pytest.approx([15.0, 0.0], abs=0.01)
    assert seen.hypothesis.place.covariance == pytest.approx(200.0 * np.eye(2), rel=1e-3, abs=1e-6)


def test_the_weights_of_a_measurement_that_disagrees_are_worked_out_by_hand():
    """2 km away the density vanishes: 0.05 * 0.2 for neither, 0.05 * 0.8 q for each candidate, 0.95 * 0.2 for the old place."""
    posteriors = update(believing((at_m(0.0), 0.95)), measured((at_m(2000.0), 0.75), (at_m(4000.0), 0.25)))
    assert [(p.number, round(p.hypothesis.evidence)) for p in posteriors] == [(None, 40), (0, 30), (1, 30)]
    assert [p.hypothesis.probability for p in posteriors] == pytest.approx(
        [0.19 / 0.24, 0.03 / 0.24, 0.01 / 0.24], rel=1e-6
    )


def test_without_any_belief_a_measurement_is_believed_as_far_as_it_is_no_outlier():
    posteriors = update(Mixture(), measured((at_m(0.0), 0.6), (at_m(3000.0), 0.4)))
    assert [p.hypothesis.probability for p in posteriors] == pytest.approx([0.48, 0.32])


@pytest.mark.parametrize(("apart_m", "count"), [(59.0, 1), (61.0, 2)])
def test_candidates_within_the_distance_of_one_place_are_merged_with_their_spread(apart_m, count):
    posteriors = update(Mixture(), measured((at_m(0.0), 0.75), (at_m(apart_m), 0.25), outlier=0.0))
    assert len(posteriors) == count
    if count == 1:
        place = posteriors[0].hypothesis.place
        assert offset_m(HOME, place) == pytest.approx([apart_m / 4.0, 0.0], abs=1e-3)
        assert place.covariance == pytest.approx(
            np.diag([25.0 + 3.0 / 16.0 * apart_m**2, 25.0]), rel=1e-4, abs=1e-6
        )
        assert posteriors[0].hypothesis.probability == pytest.approx(1.0)
        assert posteriors[0].number == 0


@pytest.mark.parametrize(("apart_m", "count"), [(99.0, 1), (101.0, 2)])
def test_candidates_within_one_sigma_of_their_difference_are_merged(apart_m, count):
    """Variances of 3600 + 6400 = 100^2."""
    seen = measured((at_m(0.0, covariance=3600.0), 0.75), (at_m(apart_m, covariance=6400.0), 0.25))
    assert len(update(Mixture(), seen)) == count


def test_a_place_that_was_not_seen_is_not_merged_with_one_that_was():
    """The search found a place 30 m off, which the old one's covariance all but excludes."""
    believed = believing((at_m(0.0, covariance=1.0), 0.5))
    posteriors = update(believed, measured((at_m(40.0, covariance=1.0), 1.0)))
    assert [p.number for p in posteriors] == [0, None]
    # 0.5 * 0.8 for the new place, 0.5 * 0.2 for the old one and for neither
    assert [p.hypothesis.probability for p in posteriors] == pytest.approx([0.4 / 0.6, 0.1 / 0.6])


@pytest.mark.parametrize(("share", "kept"), [(2e-7, 2), (0.5e-7, 1)])
def test_hypotheses_of_less_than_a_ten_millionth_are_dropped(share, kept):
    seen = measured((at_m(0.0), 1.0 - share), (at_m(3000.0), share), outlier=0.0)
    assert len(update(Mixture(), seen)) == kept


def test_no_more_than_64_hypotheses_are_carried_on():
    many = [(at_m(200.0 * i), (100.0 - i) / 5020.0) for i in range(80)]
    posteriors = update(Mixture(), measured(*many, outlier=0.0))
    assert [p.number for p in posteriors] == list(range(64))


# ---- what a place may be


def test_of_two_places_with_all_their_errors_in_common_the_middle_is_taken():
    """Each is as good as any mean of both: neither is preferred."""
    one, two = at_m(0.0, covariance=100.0, common=100.0), at_m(10.0, covariance=100.0, common=100.0)
    fused = fuse(one, two)
    assert offset_m(HOME, fused) == pytest.approx([5.0, 0.0], abs=0.05)
    assert fused.covariance == pytest.approx(100.0 * np.eye(2), rel=1e-3, abs=1e-3)


def test_without_more_said_nothing_is_in_common():
    place = GaussianPlace(lat_deg=46.2, lon_deg=-122.2, covariance_enu_m2=((4.0, 1.0), (1.0, 3.0)))
    assert place.common == pytest.approx(np.zeros((2, 2)))


def test_rounding_of_a_billionth_of_a_covariance_is_forgiven_and_no_more():
    for off, refused in ((0.9e-3, False), (1.1e-3, True)):
        fields = {"lat_deg": 0.0, "lon_deg": 0.0, "covariance_enu_m2": ((1e6, -off), (0.0, 2.0))}
        if refused:
            with pytest.raises(ValueError, match="a covariance is symmetric"):
                GaussianPlace(**fields)
        else:
            GaussianPlace(**fields)
    with pytest.raises(ValueError, match="a covariance is symmetric"):
        GaussianPlace(lat_deg=0.0, lon_deg=0.0, covariance_enu_m2=((1e-3, 1.1e-9), (0.0, 1e-3)))
    GaussianPlace(lat_deg=0.0, lon_deg=0.0, covariance_enu_m2=((1e-3, 0.9e-9), (0.0, 1e-3)))


def test_a_place_is_finite_and_does_not_change():
    with pytest.raises(ValueError, match="finite"):
        GaussianPlace(lat_deg=0.0, lon_deg=0.0, covariance_enu_m2=((np.inf, 0.0), (0.0, 1.0)))
    with pytest.raises(ValueError, match="frozen"):
        HOME.lat_deg = 1.0
