"""Which places are compared, and in which order: what stage 2 ranks first need not be the right one."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from craters import CRATERS, SIDE, WEST_SPOT, Scene, make_scene
from fits import refined

from localizer.observation import Observation
from localizer.search import selection
from localizer.search.coarse_to_fine import Cutoff, RankedCells
from localizer.search.contours import frame_contour
from localizer.search.fit.refine import Refined
from localizer.search.selection import select_place
from localizer.search.stage2 import ScoredCells


@pytest.fixture(scope="module")
def scene(tmp_path_factory) -> Scene:
    return make_scene(tmp_path_factory.mktemp("craters"))


def thinned(observation: Observation, every: int) -> Observation:
    frames = tuple(
        dataclasses.replace(f, u_px=f.u_px[::every], v_px=f.v_px[::every], sigma_px=f.sigma_px[::every])
        for f in observation.frames
    )
    return dataclasses.replace(observation, frames=frames)


def ranked(cells: list[tuple[float, float]], disparity: list[float], sigma: float = 0.2) -> RankedCells:
    scored = ScoredCells(np.array(cells, np.int64), np.array(disparity), np.zeros(len(cells)))
    return RankedCells(scored, (), sigma)


@pytest.fixture
def quick(monkeypatch):
    """One fit of each mode instead of many around it, which is the affair of ``test_local_optima``."""
    monkeypatch.setattr(
        selection,
        "best_local_optimum",
        lambda problems, mode, largest: selection.refit(problems.middle, mode, largest),
    )


def test_the_right_one_of_three_valleys_is_found_although_stage_2_ranks_it_third(scene, quick):
    """Of three craters only the last has the hillock that is seen; stage 2 takes the others for slightly better."""
    observation = thinned(scene.look(2, WEST_SPOT), 4)
    contours = tuple(frame_contour(frame) for frame in observation.frames)
    cells = [(WEST_SPOT[0], WEST_SPOT[1] + number * SIDE) for number in range(CRATERS)]
    decision, best = select_place(scene.terrain, observation, contours, ranked(cells, [1.0, 1.05, 1.1]))
    assert decision.status == "fix"
    assert (best.row, best.col) == pytest.approx(cells[2], abs=0.2)
    assert decision.candidates[0] is best
    without, _ = select_place(scene.terrain, observation, contours, ranked(cells[:2], [1.0, 1.05]))
    assert without.status != "fix", "the hillock is missing there"


# ---- each step, with fits whose likelihoods are given


def fit(row: float = 0.0, *, nll: float = 0.0, log_odds: float = 88.0, **changes: object) -> Refined:
    given = {"correlation_columns": 1.0, "mean_column_nll": nll, "evidence": log_odds + 2.0}
    return refined(row, **(given | changes))


def rows(fits) -> list[float]:
    return [f.row for f in fits]


PROBLEMS = SimpleNamespace(
    coarse=SimpleNamespace(sigma_rad=np.zeros(120)), middle=SimpleNamespace(name="middle", terrain=None)
)


@pytest.mark.parametrize(
    ("column_nll", "correlation_columns", "stays"),
    [
        (0.499, 1.0, True),  # half a nat a column
        (0.501, 1.0, False),
        (0.999, 10.0, True),  # 12 nats over 12 independent columns
        (1.001, 10.0, False),
    ],
)
def test_places_nearly_as_likely_are_short_listed(column_nll, correlation_columns, stays):
    best = fit(correlation_columns=correlation_columns)
    other = fit(100.0, nll=column_nll, log_odds=5.0 if best.log_odds < 0 else -10.0)
    found = selection._within([best, other], 0.5, PROBLEMS, 12)
    assert rows(found.fits) == ([0.0, 100.0] if stays else [0.0])
    assert rows(found.rejected) == ([] if stays else [100.0])


@pytest.mark.parametrize(
    ("best_odds", "odds", "stays"),
    [
        (88.0, 26.41, True),
        (88.0, 26.39, False),
        (10.0, 5.0, True),
        (10.0, 4.99, False),
    ],  # 0.3 * 88; 5 at least
)
def test_places_of_large_log_odds_are_short_listed_whatever_their_columns_say(best_odds, odds, stays):
    found = selection._within(
        [fit(log_odds=best_odds), fit(100.0, nll=9.0, log_odds=odds)], 0.5, PROBLEMS, 12
    )
    assert len(found.fits) == (2 if stays else 1)


def test_the_short_list_has_a_least_and_a_most_and_rejects_the_rest():
    bad = [fit(100.0 * i, nll=9.0 * (i > 0), log_odds=88.0 if i == 0 else -1.0) for i in range(8)]
    found = selection._within(bad, 0.5, PROBLEMS, 12, 5)
    assert (len(found.fits), len(found.rejected)) == (5, 3)
    good = [fit(100.0 * i) for i in range(20)]
    found = selection._within(good, 0.5, PROBLEMS, 12)
    assert rows(found.fits) == rows(good[:12])
    assert rows(found.rejected) == rows(good[12:])


@pytest.fixture
def refits(monkeypatch):
    """Refits end where ``answers`` says, by the row of their start; records each start and problem."""

    def of(answers: dict[float, Refined]):
        calls = []

        def refit(problem, start, largest, **options):
            calls.append((start.row, options.get("noise")))
            return answers.get(start.row, start)

        monkeypatch.setattr(selection, "refit", refit)
        monkeypatch.setattr(
            selection,
            "with_offset_of",
            lambda place, other, terrain: dataclasses.replace(place, row=place.row + 0.25),
        )
        return calls

    return of


def test_continued_fits_are_ordered_anew_and_those_that_meet_are_one_place(refits):
    """The third of the coarse fits becomes the best; the second ends where the first is."""
    refits({0.0: fit(0.0, nll=0.3), 100.0: fit(1.9, nll=0.4), 200.0: fit(200.0, nll=0.1)})
    found = selection._shortlist(PROBLEMS, [fit(0.0), fit(100.0, nll=0.1), fit(200.0, nll=0.2)], 12.0)
    assert rows(found.fits) == [200.0, 0.0]
    assert found.rejected == []


def test_what_either_short_list_leaves_out_is_kept_as_rejected(refits):
    many = [fit(100.0 * i, nll=(0.0 if i == 0 else 1.5), log_odds=88.0 if i == 0 else -1.0) for i in range(7)]
    refits({})
    found = selection._shortlist(PROBLEMS, many, 12.0)
    assert rows(found.fits) == [0.0]
    # the first list takes five; two are left out there, four after they were continued
    assert sorted(rows(found.rejected)) == [100.0, 200.0, 300.0, 400.0, 500.0, 600.0]


@pytest.mark.parametrize(
    ("odds", "modes"),
    [
        ([88.0, 58.01, 57.99], 2),  # 30 nats behind
        ([20.0, 5.01, 4.99], 2),  # 5 at least
        ([-3.0, -4.0, -5.0], 1),
        ([88.0, 87.0, 86.0, 85.0, 84.0, 83.0], 4),
    ],
)
def test_modes_are_the_places_that_could_still_be_the_most_probable(refits, odds, modes):
    refits({})
    listed = [fit(100.0 * i, log_odds=value) for i, value in enumerate(odds)]
    found = selection._remaining_modes(PROBLEMS, listed[::-1], 12.0)
    assert rows(found.fits) == rows(listed[:modes]), "the best first, whatever their order was"
    assert rows(found.rejected) == rows(listed[modes:])


def test_each_place_but_the_best_is_fitted_again_from_the_best_one_s_offset(refits):
    best, other, worse = fit(0.0, log_odds=60.0), fit(100.0, log_odds=40.0), fit(200.0, log_odds=41.0)
    calls = refits({100.25: fit(100.3, log_odds=55.0), 200.25: fit(200.3, log_odds=30.0)})
    found = selection._remaining_modes(PROBLEMS, [best, other, worse], 12.0)
    assert [row for row, _ in calls] == [0.0, 100.0, 200.0, 100.25, 200.25]
    assert calls[3][1].model == best.error_model
    assert rows(found.fits) == [0.0, 100.3, 200.0], "the better of both"


def test_a_single_place_is_not_fitted_again(refits):
    calls = refits({})
    assert rows(selection._remaining_modes(PROBLEMS, [fit(3.0)], 12.0).fits) == [3.0]
    assert calls == []


# ---- the starts


@pytest.fixture
def starts(monkeypatch):
    """How many cells start a fit, when the fit from cell number n has the likelihood ``nll(n)``."""

    def of(disparity, nll=float, sigma: float = 0.2):
        cells = [(10 * number, 0) for number in range(len(disparity))]
        monkeypatch.setattr(
            selection,
            "_coarse_fit",
            lambda terrain, observation, problems, cell, bias: fit(float(cell[0]), nll=nll(cell[0] // 10)),
        )
        return selection._coarse_fits(None, None, None, ranked(cells, list(disparity), sigma))  # type: ignore[arg-type]

    return of


def test_at_least_12_cells_start_a_fit_and_at_most_64(starts):
    fits, (cutoff,) = starts(np.arange(100.0))
    assert len(fits) == len(cutoff.cells) == 12
    assert cutoff.best_rejected == 12.0
    fits, (cutoff,) = starts(np.linspace(1.0, 1.1, 100))
    assert len(fits) == 64
    assert cutoff.best_rejected == pytest.approx(1.0 + 0.1 * 64 / 99)


def test_cells_within_four_sigma_of_the_best_cell_start_a_fit(starts):
    disparity = np.concatenate([np.linspace(1.0, 1.79, 20), [1.81, 1.82]])  # sigma 0.2
    fits, (cutoff,) = starts(disparity)
    assert len(fits) == 20
    assert cutoff.best_rejected == 1.81


def test_cells_are_added_up_to_four_sigma_from_the_best_fit_s_own_cell(starts):
    """The best fit is that of the 11th cell, whose disparity is 1.5: cells up to 2.3 follow."""
    disparity = np.concatenate([np.full(10, 1.0), [1.5, 1.6], np.linspace(2.0, 2.29, 10), [2.31, 2.32]])
    fits, (cutoff,) = starts(disparity, nll=lambda number: 0.0 if number == 10 else 1.0)
    assert len(fits) == 22
    assert fits[0].row == 100.0
    assert cutoff.best_rejected == 2.31


def test_the_best_fit_is_first_whatever_its_cell_was(starts):
    fits, (cutoff,) = starts(np.arange(5.0), nll=lambda number: -float(number))
    assert rows(fits) == [40.0, 30.0, 20.0, 10.0, 0.0]
    assert cutoff.best_rejected == np.inf
    assert list(cutoff.disparity) == [0.0, 1.0, 2.0, 3.0, 4.0]


def test_no_two_starts_lie_closer_than_a_cell_and_a_half():
    cells = [(0, 0), (0, 1), (1, 1), (0, 2), (5, 5)]
    scored = ScoredCells(np.array(cells), np.arange(5.0), np.zeros(5))
    assert [cells[i] for i in selection.suppress_neighbours(scored, 5, 1.5)] == [(0, 0), (0, 2), (5, 5)]
    assert len(selection.suppress_neighbours(scored, 2, 1.5)) == 2


def test_a_cutoff_counts_the_best_cell_within_two_cells_of_the_place():
    cells, disparity = np.array([[10, 10], [10, 12], [10, 13]]), np.array([1.6, 1.2, 1.0])
    cutoff = Cutoff(cells, disparity, 1.4, 0.2)
    assert cutoff.miss_probability(10.0, 10.0) == pytest.approx(
        0.158655, abs=1e-6
    )  # one sigma below the cutoff
    assert cutoff.miss_probability(10.0, 7.0) == pytest.approx(0.841345, abs=1e-6), (
        "the nearest cell, a sigma above"
    )
    assert Cutoff(np.zeros((0, 2), np.int64), np.zeros(0), 1.0, 0.2).miss_probability(0.0, 0.0) == 0.0


# ---- what the decision gets


@pytest.fixture
def selected(monkeypatch):
    """``select_place`` with contenders that are given: modes, rejected places, cutoffs and masses."""

    def of(modes, *, rejected=(), cutoffs=(), masses=None, covers: bool = True):
        problems = SimpleNamespace(full=SimpleNamespace(sectors=[0] * 40))
        monkeypatch.setattr(selection, "problems_of", lambda *_: problems)
        monkeypatch.setattr(selection, "_coarse_fits", lambda *_: ([], list(cutoffs)))
        monkeypatch.setattr(selection, "_shortlist", lambda *_: selection._Selection([], list(rejected[:1])))
        monkeypatch.setattr(
            selection, "_remaining_modes", lambda *_: selection._Selection(modes, list(rejected[1:]))
        )
        monkeypatch.setattr(selection, "best_local_optimum", lambda problems, mode, largest: mode)
        order = []

        def compare(problems, optima, largest):
            order.extend(rows(optima))
            by_mass = masses or {f.row: -float(i) * 100.0 for i, f in enumerate(optima)}
            compared = [SimpleNamespace(place=f, log_mass=by_mass[f.row]) for f in optima]
            return sorted(compared, key=lambda c: -c.log_mass)

        monkeypatch.setattr(selection, "compare_on_same_columns", compare)
        terrain = SimpleNamespace(
            largest_error_m=12.0, cell_m=30.0, dem=SimpleNamespace(covers=lambda row, col: covers)
        )
        frames = (None,) * 4
        return *select_place(terrain, None, frames, None), order  # type: ignore[arg-type]

    return of


def test_places_are_compared_by_their_likelihood_and_those_that_meet_are_one(selected):
    decision, best, order = selected([fit(0.0, nll=0.3), fit(100.0, nll=0.1), fit(101.0, nll=0.2)])
    assert order == [100.0, 0.0]
    assert (decision.status, best.row) == ("fix", 100.0)


def test_the_place_of_the_largest_mass_is_the_answer_wherever_it_came_from(selected):
    decision, best, _ = selected(
        [fit(0.0), fit(100.0), fit(200.0)], masses={0.0: 1.0, 100.0: 2.0, 200.0: 12.0}
    )
    assert best.row == 200.0
    assert decision.status == "fix"


def test_that_place_has_to_be_believed_and_no_other(selected):
    likelier_columns = fit(0.0, nll=-1.0, log_odds=10.0)
    decision, best, _ = selected([likelier_columns, fit(100.0)], masses={0.0: 0.0, 100.0: 20.0})
    assert (decision.status, best.row) == ("fix", 100.0)
    decision, best, _ = selected([likelier_columns, fit(100.0)], masses={0.0: 20.0, 100.0: 0.0})
    assert (decision.status, best) == ("none", None)


def test_what_limits_left_out_adds_up_to_elsewhere(selected):
    """Two rejected places 12 nats behind, 2 more than refinement may gain; and a cutoff one sigma above the place."""
    rejected = [fit(300.0, log_odds=76.0), fit(400.0, log_odds=76.0)]
    cutoff = Cutoff(np.array([[0, 50]]), np.array([1.2]), 1.4, 0.2)
    decision, _, _ = selected([fit(0.0)], rejected=rejected, cutoffs=[cutoff, cutoff])
    weight = 1.0 - (1.0 - 0.158655) ** 2 + 2.0 * np.exp(-1.0)
    assert decision.probabilities[0] == pytest.approx(1.0 / (1.0 + weight), rel=1e-5)
    assert decision.status == "ambiguous"


def test_a_best_place_that_is_not_believed_or_lies_beyond_the_dem_is_none(selected):
    decision, best, _ = selected([fit(0.0, log_odds=10.0)])
    assert (decision.status, best, decision.reason.code) == ("none", None, "outside")
    decision, best, _ = selected([fit(0.0)], covers=False)
    assert (decision.status, best) == ("none", None)
    assert "beyond the end of the DEM" in decision.reason.text


@pytest.mark.parametrize(("chi2", "status"), [(64.9, "fix"), (65.1, "none")])
def test_four_frames_have_16_readings(selected, chi2, status):
    decision, _, _ = selected([fit(0.0, prior_chi2=chi2, evidence=90.0)])
    assert decision.status == status


@pytest.mark.parametrize(
    ("altitude_m", "sigma_m", "expected_m"),
    [
        (None, np.inf, 102.0),
        (112.0, 3.0, 107.0),
        (112.0, 1.0, 111.0),
    ],  # the DEM's 3 m: half each; a tenth and nine
)
def test_the_first_altitude_weighs_ground_and_altimeter_by_their_sigmas(altitude_m, sigma_m, expected_m):
    terrain = SimpleNamespace(dem=SimpleNamespace(ground_m=lambda row, col: 100.0), nominal_error_m=3.0)
    observation = Observation((), 2.0, altitude_m, sigma_m, 1.0, 0.02)
    assert selection._first_altitude(terrain, observation, 0.0, 0.0) == pytest.approx(expected_m)  # type: ignore[arg-type]
