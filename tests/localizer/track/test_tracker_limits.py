"""The tracker's limits, each just on one side of its value and just on the other, with searches whose answer is given."""

import dataclasses

import numpy as np
import pytest
from affine import Affine
from fits import refined
from local_map import LOCAL, local_dem
from pyproj import Geod

from localizer.dem.geodesy import rowcol_to_lonlat
from localizer.dem.horizon import Terrain, prepare_terrain
from localizer.dem.lattice import dem_from_array
from localizer.observation import Observation
from localizer.search.answer import Located
from localizer.search.decide import Decision, no_place
from localizer.search.fit.correlated_errors import ErrorModel
from localizer.search.fit.refine import Refined
from localizer.search.leave_one_out import CheckedAnswer
from localizer.search.reasons import no_skyline
from localizer.search.stage1 import Stage1
from localizer.track import tracker as module
from localizer.track.gaussian_place import gaussian_place
from localizer.track.mixture import Hypothesis, Mixture, Posterior
from localizer.track.odometry import Movement
from localizer.track.tracker import Tracker, follow, stands_out

CELL_M, SIDE = 30.0, 201
HOME = (100.0, 100.0)
BLIND = Observation((), 2.0, None, np.inf, 1.0, 0.02)


@pytest.fixture(scope="module")
def terrain() -> Terrain:
    """Flat ground of 6 km by 6 km."""
    return prepare_terrain(local_dem(np.zeros((SIDE, SIDE)), CELL_M))


def place(row: float = HOME[0], col: float = HOME[1], **changes: object) -> Refined:
    given = {
        "altitude_m": 2.0,
        "frame_errors_deg": np.zeros((1, 3)),
        "covariance_enu_m2": np.array([[25.0, 5.0], [5.0, 16.0]]),
        "mean_column_nll": -5.0,
        "evidence": 60.0,
        "error_model": ErrorModel(0.1, 0.1, 240.0),
    }
    return refined(row, col, **(given | changes))


def located(*places: tuple[Refined, float], status: str = "fix", elsewhere: float = 0.0) -> Located:
    decision = Decision(status, [p for p, _ in places], np.array([q for _, q in places]), elsewhere, None)  # type: ignore[arg-type]
    return Located(decision, places[0][0], Stage1(1, {"altitude": np.zeros((1, 2), np.int64)}, 0), {})


def hypothesis(
    terrain: Terrain,
    at: tuple[float, float] = HOME,
    sigma_m: float = 10.0,
    probability: float = 0.95,
    evidence: float = 60.0,
) -> Hypothesis:
    lon_deg, lat_deg = (float(value) for value in rowcol_to_lonlat(terrain.dem, *at))
    place = gaussian_place(lat_deg, lon_deg, sigma_m**2 * np.eye(2), np.zeros((2, 2)))
    return Hypothesis(place=place, probability=probability, evidence=evidence)


def knowing(*hypotheses: Hypothesis, **changes: object) -> Tracker:
    mixture = Mixture(hypotheses=hypotheses)
    return Tracker(now=mixture, before=mixture, look_evidence=60.0).model_copy(update=changes)


@pytest.fixture
def searched(monkeypatch):
    """Lets the searches answer what is given, one after the other; records the circles that were searched."""

    def of(*answers: Located):
        left, circles = list(answers), []

        def locate(terrain, observation):
            circles.append(observation.prior)
            return left.pop(0)

        monkeypatch.setattr(module, "locate", locate)
        monkeypatch.setattr(
            module, "check_located", lambda terrain, observation, found: CheckedAnswer(found, {})
        )
        return circles

    return of


# ---- bootstrap


@pytest.mark.parametrize(
    ("changes", "is_searched"),
    [
        ({"probability": 0.9}, True),
        ({"probability": 0.899}, False),
        ({"evidence": 25.0}, True),
        ({"evidence": 24.9}, False),
        ({"sigma_m": 271.0}, True),  # 5 * 271 + 5 * 30 = 1505, of a quarter of 6.03 km = 1507.5
        ({"sigma_m": 272.0}, False),
    ],
)
def test_only_a_sure_and_narrow_place_is_searched_around(terrain, changes, is_searched):
    circle = module._bootstrap_circle(knowing(hypothesis(terrain, **changes)), terrain)
    assert (circle is not None) == is_searched


def test_the_circle_is_five_sigma_and_five_cells_about_the_likeliest_place(terrain):
    first = hypothesis(terrain, sigma_m=10.0)
    circle = module._bootstrap_circle(
        knowing(first, hypothesis(terrain, (50.0, 50.0), probability=0.04)), terrain
    )
    assert circle.radius_m == pytest.approx(50.0 + 150.0)
    assert (circle.lat_deg, circle.lon_deg) == (first.place.lat_deg, first.place.lon_deg)
    assert module._bootstrap_circle(Tracker(), terrain) is None


@pytest.mark.parametrize(
    ("found", "mode"),
    [
        (located((place(), 0.99)), "bootstrap"),
        (located((place(col=HOME[1] + 179.0 / CELL_M), 0.99)), "bootstrap"),  # 0.9 of 200 m
        (located((place(col=HOME[1] + 181.0 / CELL_M), 0.99)), "whole DEM after bootstrap failed"),
        (located((place(row=HOME[0] - 181.0 / CELL_M), 0.99)), "whole DEM after bootstrap failed"),
        (located((place(evidence=57.0), 0.99)), "bootstrap"),  # 0.95 of the last one's 60
        (located((place(evidence=56.9), 0.99)), "whole DEM after bootstrap failed"),
        (located((place(), 0.99), status="ambiguous"), "whole DEM after bootstrap failed"),
    ],
)
def test_what_is_found_around_a_place_counts_if_it_convinces(terrain, searched, found, mode):
    circles = searched(found, located((place(), 0.99)))
    start = knowing(hypothesis(terrain), since_m=(0.0, 0.0))
    step = follow(start, Movement(np.zeros(2), 1e-6 * np.eye(2)), terrain, BLIND, "a look")
    assert step.mode == mode
    assert [circle is not None for circle in circles] == ([True] if mode == "bootstrap" else [True, False])


def test_where_nothing_is_known_the_whole_dem_is_searched(terrain, searched):
    circles = searched(located((place(), 0.99)))
    assert follow(Tracker(), None, terrain, BLIND, "a look").mode == "whole DEM"
    assert circles == [None]


# ---- what a search measured


def test_a_measurement_has_half_its_covariance_in_common_and_a_quarter_cell_of_model_error(terrain):
    found = located((place(evidence=23.0), 0.7), (place(col=150.0, evidence=80.0), 0.2))
    measurement = module._measurement(
        terrain, found, list(zip(found.decision.candidates, (0.7, 0.2), strict=True)), 9e6
    )
    first, second = measurement.measured
    assert first.place.covariance == pytest.approx(np.array([[25.0, 5.0], [5.0, 16.0]]))
    assert first.place.common == pytest.approx(np.array([[12.5, 2.5], [2.5, 8.0]]))
    assert (first.number, first.probability, first.evidence) == (0, 0.7, 23.0)
    assert (second.number, second.probability, second.evidence) == (1, 0.2, 80.0)
    assert measurement.outlier_probability == pytest.approx(
        1.0 / (1.0 + np.e)
    )  # by the best place's evidence
    assert measurement.model_error_m == pytest.approx(7.5)
    assert measurement.same_m == pytest.approx(60.0)  # two cells
    assert measurement.area_m2 == 9e6
    azimuth_deg, _, off_m = Geod(ellps="WGS84").inv(
        first.place.lon_deg, first.place.lat_deg, second.place.lon_deg, second.place.lat_deg
    )
    assert (azimuth_deg, off_m) == pytest.approx((90.0, 1500.0), abs=0.1)


def test_the_area_is_that_of_the_cells_that_are_no_voids(terrain):
    z_m = terrain.dem.z_m.copy()
    z_m[:, :101] = np.nan
    half = dataclasses.replace(terrain, dem=dataclasses.replace(terrain.dem, z_m=z_m))
    assert module._area_m2(half) == pytest.approx(201 * 100 * 900.0)


@pytest.mark.parametrize(
    ("changes", "is_fix"),
    [
        ({"probability": 0.99}, True),
        ({"probability": 0.9899}, False),
        ({"evidence": 25.0}, True),
        ({"evidence": 24.99}, False),
        ({"sigma_m": 149.99}, True),  # five cells
        ({"sigma_m": 150.01}, False),
    ],
)
def test_a_hypothesis_is_a_fix_by_the_criteria_of_a_search(terrain, changes, is_fix):
    assert stands_out(hypothesis(terrain, **{"probability": 0.995, **changes}), CELL_M) == is_fix


def combined(terrain: Terrain, *posteriors: tuple[Hypothesis, int | None]) -> Located:
    found = located((place(evidence=30.0), 0.6), (place(col=150.0), 0.4), status="ambiguous")
    candidates = list(zip(found.decision.candidates, (0.6, 0.4), strict=True))
    return module._combined(terrain, found, candidates, tuple(Posterior(h, n) for h, n in posteriors))


def test_the_answer_is_the_measured_hypotheses_and_their_places(terrain):
    one = hypothesis(terrain, (99.0, 149.0), sigma_m=7.0, probability=0.7)
    unseen = hypothesis(terrain, (20.0, 20.0), probability=0.2)
    two = hypothesis(terrain, (100.0, 100.0), probability=0.05)
    answer = combined(terrain, (one, 1), (unseen, None), (two, 0))
    assert answer.decision.status == "ambiguous"
    assert answer.decision.reason.code == "several_places"
    assert list(answer.decision.probabilities) == [0.7, 0.05]
    assert answer.decision.elsewhere == pytest.approx(0.25)
    assert (answer.best.row, answer.best.col) == pytest.approx((99.0, 149.0), abs=1e-4)
    assert answer.best.covariance_enu_m2 == pytest.approx(49.0 * np.eye(2))
    assert [c.evidence for c in answer.decision.candidates] == [60.0, 30.0]


def test_a_hypothesis_that_stands_out_is_a_fix_without_a_reason(terrain):
    answer = combined(terrain, (hypothesis(terrain, probability=0.995), 0))
    assert (answer.decision.status, answer.decision.reason) == ("fix", None)


@pytest.mark.parametrize(("probability", "count"), [(1.01e-4, 2), (0.99e-4, 1)])
def test_negligible_hypotheses_are_not_listed(terrain, probability, count):
    small = hypothesis(terrain, (50.0, 50.0), probability=probability)
    answer = combined(terrain, (hypothesis(terrain, probability=0.9), 0), (small, 1))
    assert len(answer.decision.candidates) == count


def test_a_search_that_fits_only_what_the_track_excludes_is_no_answer(terrain):
    answer = combined(terrain, (hypothesis(terrain), None))
    assert (answer.decision.status, answer.best) == ("none", None)
    assert answer.decision.reason.code == "contradicted"


# ---- steps


def step_after(terrain, searched, moved_m: float, evidence: float):
    """A look that agrees with the track, after a movement since the last one that counted."""
    found = located((place(evidence=evidence), 1.0))
    searched(*[found] * 2)
    start = knowing(hypothesis(terrain, probability=0.5, evidence=20.0), since_m=(0.0, moved_m - 10.0))
    before = Mixture(hypotheses=(hypothesis(terrain, probability=0.3, evidence=20.0),))
    start = start.model_copy(update={"before": before})
    return follow(start, Movement(np.array([0.0, 10.0]), 1e-6 * np.eye(2)), terrain, BLIND, "a look")


@pytest.mark.parametrize(("moved_m", "same_spot"), [(59.9, True), (60.1, False)])
def test_two_cells_farther_on_a_look_counts_anew(terrain, searched, moved_m, same_spot):
    step = step_after(terrain, searched, moved_m, 70.0)
    # of the same spot the second look replaces the first: the belief before both is kept
    carried = step.tracker.before.hypotheses[0].probability
    assert carried == pytest.approx(0.99 * (0.3 if same_spot else 0.5))
    assert step.tracker.since_m == (0.0, 0.0)
    assert step.tracker.look_evidence == 70.0


@pytest.mark.parametrize(("evidence", "counts"), [(59.9, False), (60.0, True)])
def test_a_second_look_from_the_same_spot_counts_if_it_shows_more(terrain, searched, evidence, counts):
    step = step_after(terrain, searched, 10.0, evidence)
    assert step.tracker.look_evidence == (evidence if counts else 60.0)
    assert step.tracker.since_m == ((0.0, 0.0) if counts else (0.0, 10.0))
    assert step.fix.status == "fix"


@pytest.mark.parametrize(("cell_m", "spot_m"), [(20.0, 50.0), (25.0, 50.0), (30.0, 60.0)])
def test_the_same_spot_is_two_cells_or_50_m(cell_m, spot_m):
    corner = Affine.scale(cell_m, -cell_m)
    terrain = prepare_terrain(dem_from_array(np.zeros((9, 9), np.float32), corner, LOCAL))
    assert module._same_spot_m(terrain) == pytest.approx(spot_m)


def test_movements_add_up_until_a_look_counts_and_are_lost_with_an_unknown_one(terrain):
    start = knowing(hypothesis(terrain, probability=0.5), since_m=(10.0, 20.0))
    leg = Movement(np.array([5.0, -50.0]), np.eye(2))
    moved = module._predicted(start, leg, 3.6e7)
    assert moved.since_m == (15.0, -30.0)
    assert (
        moved.now.hypotheses[0].probability == moved.before.hypotheses[0].probability == pytest.approx(0.495)
    )
    lost = module._predicted(start, None, 3.6e7)
    assert (lost.since_m, lost.now, lost.before) == (None, Mixture(), Mixture())
    assert module._predicted(Tracker(), leg, 3.6e7).since_m is None


def test_without_a_place_the_track_goes_on_with_what_it_knew(terrain, searched):
    nothing = Located(
        no_place(no_skyline()), None, Stage1(1, {"altitude": np.zeros((0, 2), np.int64)}, 0), {}
    )
    searched(nothing)
    start = knowing(hypothesis(terrain, probability=0.5), since_m=(0.0, 0.0))
    step = follow(start, Movement(np.array([90.0, 0.0]), np.eye(2)), terrain, BLIND, "in fog")
    assert step.fix.status == "none"
    assert [p.number for p in step.posteriors] == [None]
    assert step.tracker.since_m == (90.0, 0.0)
    assert step.tracker.look_evidence == 60.0
    assert step.tracker.now.hypotheses[0].probability == pytest.approx(0.495)


def test_the_answer_without_a_frame_that_contradicts_the_others_is_followed(terrain, monkeypatch):
    right = located((place(col=120.0), 1.0))
    monkeypatch.setattr(
        module, "locate", lambda terrain, observation: located((place(), 1.0), status="ambiguous")
    )
    monkeypatch.setattr(module, "check_located", lambda *_: CheckedAnswer(right, {"E": 0.1}, "E"))
    step = follow(Tracker(), None, terrain, BLIND, "a look")
    assert (step.left_out, step.fix.status) == ("E", "fix")
    assert step.fix.position.col == pytest.approx(120.0)
    assert len(step.tracker.now.hypotheses) == 1
