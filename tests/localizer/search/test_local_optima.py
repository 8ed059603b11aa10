"""The optima around a fit: which grid points start fits, and how the optima add up, with likelihoods that are written down."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from fits import refined
from local_map import local_dem

from localizer.dem.horizon import Terrain, prepare_terrain
from localizer.search.fit import local_grid, local_optima
from localizer.search.fit.correlated_errors import ErrorModel
from localizer.search.fit.local_grid import grid_optima, grid_second_moment
from localizer.search.fit.local_optima import best_local_optimum, distinct, rescaled_noise
from localizer.search.fit.noise import Noise
from localizer.search.fit.problem import ALTITUDE, EAST, NORTH
from localizer.search.fit.refine import Refined

CELL_M, SIDE = 30.0, 41
HOME = (20.0, 20.0)
NOISE = Noise(3.0, 1.0, ErrorModel(3.0, 0.05, 240.0))


def terrain_of(height_m: np.ndarray, error_m: float | None = None) -> Terrain:
    return prepare_terrain(dataclasses.replace(local_dem(height_m, CELL_M), error_m=error_m))


@pytest.fixture(scope="module")
def terrain() -> Terrain:
    """Ground that rises by 1 m a cell to the east."""
    return terrain_of(np.broadcast_to(500.0 + np.arange(SIDE), (SIDE, SIDE)))


def fit_at(row: float = HOME[0], col: float = HOME[1], **changes: object) -> Refined:
    given = {
        "altitude_m": 522.0,
        "azimuth_bias_deg": 0.1,
        "frame_errors_deg": np.zeros((1, 3)),
        "neg_log_posterior": 100.0,
        "correlation_columns": 8.0,
        "inlier_share": 0.99,
        "mean_column_nll": -5.0,
        "error_model": ErrorModel(0.1, 0.1, 240.0),
    }
    return refined(row, col, **(given | changes))


# ---- the grid


@pytest.fixture
def grid(monkeypatch, terrain):
    """Makes the negative log-posterior of the grid a function of metres east and north; gives the problem."""

    def of(*posteriors):
        def evaluated(problem, start, noises, reach_cells, step_cells):
            ticks = CELL_M * np.arange(-reach_cells, reach_cells + 1e-9, step_cells)
            found = []
            for posterior, _ in zip(posteriors, noises, strict=True):
                points = []
                for east in ticks:
                    for north in ticks:
                        x = np.zeros(8)
                        x[EAST], x[NORTH], x[ALTITUDE] = east, north, 500.0 + east
                        points.append((posterior(east, north), x))
                found.append(points)
            return found

        monkeypatch.setattr(local_grid, "_evaluated_grid", evaluated)
        return SimpleNamespace(terrain=terrain)

    return of


def pits(*pits_m: tuple[float, float, float]):
    """A negative log-posterior with narrow pits at (east, north), of a depth each."""

    def posterior(east: float, north: float) -> float:
        return min(
            -depth * np.exp(-(np.hypot(east - e, north - n) ** 2) / (2.0 * 15.0**2)) for e, n, depth in pits_m
        )

    return posterior


def places(optima) -> list[tuple[float, float]]:
    return [(round(row, 3), round(col, 3)) for row, col, _, _ in optima]


def test_the_best_points_of_the_grid_are_no_neighbours(grid):
    problem = grid(pits((60.0, 0.0, 10.0), (-60.0, 30.0, 5.0)))
    optima = grid_optima(problem, fit_at(), [NOISE], 3.0, 0.5, 2)
    # east is right, north is up
    assert places(optima) == [(20.0, 22.0), (19.0, 18.0)]
    assert [altitude_m for _, _, altitude_m, _ in optima] == pytest.approx([560.0, 440.0])


@pytest.mark.parametrize(("apart_m", "both"), [(22.0, False), (23.0, True)])
def test_points_less_than_one_and_a_half_steps_apart_are_neighbours(monkeypatch, terrain, apart_m, both):
    """Steps of half a cell: 22.5 m."""
    points = []
    for number, east in enumerate((0.0, apart_m)):
        x = np.zeros(8)
        x[EAST] = east
        points.append((float(number), x))
    monkeypatch.setattr(local_grid, "_evaluated_grid", lambda *_: [points])
    problem = SimpleNamespace(terrain=terrain)
    assert len(grid_optima(problem, fit_at(), [NOISE], 1.0, 0.5, 2)) == (2 if both else 1)


@pytest.mark.parametrize(("apart_m", "both"), [(7.4, False), (7.6, True)])
def test_points_of_two_noises_half_a_step_apart_are_one(monkeypatch, terrain, apart_m, both):
    """Half a step of half a cell: 7.5 m."""
    grids = []
    for east in (0.0, apart_m):
        x = np.zeros(8)
        x[EAST] = east
        grids.append([(0.0, x)])
    monkeypatch.setattr(local_grid, "_evaluated_grid", lambda *_: grids)
    other = dataclasses.replace(NOISE, robust_sigma_m=9.0)
    optima = grid_optima(SimpleNamespace(terrain=terrain), fit_at(), [NOISE, other], 1.0, 0.5, 3)
    assert [noise for *_, noise in optima] == ([NOISE, other] if both else [NOISE])


def test_each_noise_has_its_own_points(grid):
    problem = grid(pits((60.0, 0.0, 10.0)), pits((0.0, 60.0, 10.0)))
    other = dataclasses.replace(NOISE, robust_sigma_m=9.0)
    optima = grid_optima(problem, fit_at(), [NOISE, other], 3.0, 0.5, 1)
    assert places(optima) == [(20.0, 22.0), (18.0, 20.0)]
    assert [noise for *_, noise in optima] == [NOISE, other]


def test_the_points_of_the_grid_are_evaluated_at_the_height_of_the_ground(monkeypatch, terrain):
    """2.4 cells to each side in steps of 0.4: 13 x 13 points; 1 m higher in each cell to the east."""
    seen = []

    def evaluate(problem, x, origin, coefficients, guess_m=None):
        return SimpleNamespace(ground_m=float(terrain.dem.ground_m(*origin)), guess_m=None, x=x)

    monkeypatch.setattr(local_grid, "evaluate", evaluate)
    monkeypatch.setattr(
        local_grid, "_conditional_optimum", lambda problem, x, evaluation, noise: seen.append(x) or (0.0, x)
    )
    problem = SimpleNamespace(terrain=terrain, size=8)
    (evaluated,) = local_grid._evaluated_grid(problem, fit_at(), [NOISE], 2.4, 0.4)  # type: ignore[arg-type]
    assert len(evaluated) == len(seen) == 169
    x = np.array(seen)
    assert sorted({round(value, 6) for value in x[:, EAST]}) == pytest.approx(12.0 * np.arange(-6, 7))
    assert sorted({round(value, 6) for value in x[:, NORTH]}) == pytest.approx(12.0 * np.arange(-6, 7))
    assert x[:, ALTITUDE] == pytest.approx(522.0 + x[:, EAST] / CELL_M, abs=1e-3)
    corner = fit_at(row=0.0, col=0.0)
    (inside,) = local_grid._evaluated_grid(problem, corner, [NOISE], 1.0, 1.0)  # type: ignore[arg-type]
    assert len(inside) == 4, "the DEM ends to the north and the west"


def gaussian(sigma_m: float):
    return lambda east, north: 0.5 * (east**2 + north**2) / sigma_m**2


def test_the_second_moment_is_that_of_the_tempered_posterior(grid):
    """A Gaussian of 20 m at the temperature 2.25 has 30 m."""
    moment = grid_second_moment(grid(gaussian(20.0)), fit_at(), NOISE, 6.0, 0.25, 2.25, lambda *_: True)
    assert moment == pytest.approx(900.0 * np.eye(2), rel=0.01, abs=0.01)


def test_a_narrow_optimum_between_the_points_adds_nothing(grid):
    moment = grid_second_moment(grid(gaussian(2.0)), fit_at(), NOISE, 3.0, 0.5, 1.0, lambda *_: True)
    assert np.abs(moment).max() < 1e-6


def test_far_points_count_only_if_they_are_plausible(grid):
    """Two equal optima, here and 60 m east; the one in the east is asked for, with the height of the ground there."""
    problem = grid(pits((0.0, 0.0, 40.0), (60.0, 0.0, 40.0)))
    asked = []

    def plausible(row: float, col: float, altitude_m: float) -> bool:
        asked.append((round(row, 6), round(col, 6), altitude_m))
        return True

    moment = grid_second_moment(problem, fit_at(), NOISE, 3.0, 1.0, 1.0, plausible)
    assert moment == pytest.approx(np.diag([0.5 * 60.0**2, 0.0]), rel=0.02, abs=1.0)
    assert asked == [(20.0, 22.0, 560.0)]
    alone = grid_second_moment(problem, fit_at(), NOISE, 3.0, 1.0, 1.0, lambda *_: False)
    assert np.abs(alone).max() < 1.0


def test_points_within_a_cell_or_of_less_than_a_hundredth_are_not_asked_for(grid):
    near = grid(pits((0.0, 0.0, 40.0), (27.0, 0.0, 40.0)))
    grid_second_moment(near, fit_at(), NOISE, 2.7, 0.9, 1.0, lambda *_: pytest.fail("was asked for"))
    far = grid(pits((0.0, 0.0, 40.0), (60.0, 0.0, 35.0)))  # exp(-5) = 0.0067
    grid_second_moment(far, fit_at(), NOISE, 3.0, 1.0, 1.0, lambda *_: pytest.fail("was asked for"))


def test_no_more_than_40_points_are_asked_for(grid):
    asked = []
    grid_second_moment(
        grid(lambda east, north: 0.0), fit_at(), NOISE, 4.0, 1.0, 1.0, lambda *at: asked.append(at) or True
    )
    assert len(asked) == len(set(asked)) == 40


# ---- optima and their average


@pytest.fixture
def averaged(monkeypatch, terrain):
    """The average over fits, where refits end where they begin and the grid adds a moment of 1 m^2."""

    def of(best: Refined, fine: list[Refined], coarse: list[Refined] = [], of_terrain: Terrain = terrain):  # noqa: B006
        temperatures = []

        def second_moment(problem, start, noise, reach, step, temperature, plausible):
            temperatures.append(temperature)
            return np.eye(2)

        monkeypatch.setattr(local_optima, "refit", lambda problem, start, largest, **_: start)
        monkeypatch.setattr(local_optima, "grid_second_moment", second_moment)
        coarse_problem = SimpleNamespace(stride=4, sigma_rad=np.zeros(25))
        full = SimpleNamespace(terrain=of_terrain, sigma_rad=np.zeros(100))
        problems = SimpleNamespace(coarse=coarse_problem, full=full)
        found = local_optima._averaged_over_optima(problems, best, fine, coarse, 12.0)  # type: ignore[arg-type]
        return found, temperatures[0]

    return of


@pytest.mark.parametrize(("smooth_m", "temperature"), [(0.0, 1.0), (0.1, 2.0), (0.3, 4.0)])
def test_optima_are_averaged_at_a_temperature_of_1_and_10_for_each_metre_of_smooth_error(
    averaged, smooth_m, temperature
):
    """Two optima 15 m apart, the second 2 nats worse: its weight is exp(-2 / T)."""
    model = ErrorModel(0.1, smooth_m, 240.0)
    best = fit_at(error_model=model)
    other = fit_at(col=HOME[1] + 0.5, neg_log_posterior=102.0, error_model=model)
    found, of_grid = averaged(best, [best, other])
    share = np.exp(-2.0 / temperature) / (1.0 + np.exp(-2.0 / temperature))
    assert found.col - HOME[1] == pytest.approx(0.5 * share)
    assert found.row == HOME[0]
    assert found.altitude_m == pytest.approx(522.0 + 0.5 * share, abs=1e-3), "at the same height above ground"
    # of the fit, of the grid, and of the optima about their mean
    assert found.covariance_enu_m2 == pytest.approx(
        np.diag([2.0 + share * (1.0 - share) * 15.0**2, 2.0]), rel=1e-3, abs=1e-3
    )
    assert of_grid == pytest.approx(temperature / 4.0), "a quarter of the columns"


def test_the_offset_of_the_optima_is_east_and_north(averaged):
    best = fit_at()
    north_east = fit_at(row=HOME[0] - 1.0, col=HOME[1] + 1.0)
    found, _ = averaged(best, [best, north_east])
    assert found.covariance_enu_m2 == pytest.approx(np.array([[227.0, 225.0], [225.0, 227.0]]), rel=1e-3)


def test_an_exact_dem_has_the_temperature_1(averaged):
    exact = terrain_of(np.full((SIDE, SIDE), 500.0), error_m=0.0)
    best = fit_at(error_model=ErrorModel(0.1, 0.5, 240.0))
    _, of_grid = averaged(best, [best], of_terrain=exact)
    assert of_grid == pytest.approx(0.25)


def test_coarse_fits_widen_the_place_and_do_not_move_it(averaged):
    best = fit_at()
    far = fit_at(col=HOME[1] + 1.0, neg_log_posterior=50.0)
    found, _ = averaged(best, [best], [far])
    assert (found.row, found.col) == HOME
    assert found.covariance_enu_m2 == pytest.approx(np.diag([2.0 + 0.5 * 900.0, 2.0]), rel=1e-3)


def test_the_evidence_is_the_largest_of_the_likely_optima_nearby(averaged):
    best = fit_at(evidence=80.0)
    likely = fit_at(col=HOME[1] + 0.5, neg_log_posterior=105.0, evidence=85.0)  # exp(-5 / 2) = 0.08
    unlikely = fit_at(col=HOME[1] + 0.5, neg_log_posterior=107.0, evidence=95.0)  # exp(-7 / 2) = 0.03
    far = fit_at(col=HOME[1] + 2.1, neg_log_posterior=100.0, evidence=99.0)
    assert averaged(best, [best, likely, unlikely, far])[0].evidence == 85.0
    assert averaged(best, [best, unlikely, far])[0].evidence == 80.0


def test_of_fits_close_together_the_first_is_kept():
    fits = [fit_at(col=20.0), fit_at(col=21.9), fit_at(col=22.1), fit_at(row=18.0, col=18.0)]
    assert distinct(fits, 2.0) == [fits[0], fits[2], fits[3]]


def test_fewer_columns_are_less_correlated():
    model = ErrorModel(0.3, 0.2, 100.0)
    fit = fit_at(correlation_columns=8.0, dem_error_m=1.5, error_model=model)
    assert rescaled_noise(2.0, fit) == Noise(1.5, 4.0, model)
    assert rescaled_noise(20.0, fit) == Noise(1.5, 1.0, model)


@pytest.fixture
def refits(monkeypatch, terrain):
    """Records the refits of ``best_local_optimum``; each fit gets what ``answer`` makes of its start."""

    def of(answer, optima=()):
        calls = []

        def refit(problem, start, largest, **options):
            calls.append((problem.name, start, options))
            return answer(problem.name, start, options)

        problems = SimpleNamespace(
            **{
                name: SimpleNamespace(
                    name=name, sigma_rad=np.zeros(count), nominal_error_m=3.0, terrain=terrain
                )
                for name, count in (("coarse", 120), ("middle", 480), ("fine", 1000), ("full", 2000))
            }
        )
        monkeypatch.setattr(local_optima, "refit", refit)
        monkeypatch.setattr(local_optima, "without_edge_columns", lambda problems, place: problems)
        monkeypatch.setattr(
            local_optima,
            "_averaged_over_optima",
            lambda problems, best, fine, coarse, largest: (best, fine, coarse),
        )
        asked = []

        def grid(problem, start, noises, reach, step, keep):
            asked.append((problem.name, list(noises), reach, step, keep))
            return [(row, col, 500.0, noises[0]) for row, col in optima]

        monkeypatch.setattr(local_optima, "grid_optima", grid)
        return calls, asked, lambda start: best_local_optimum(problems, start, 12.0)  # type: ignore[arg-type]

    return of


def test_the_grid_is_searched_under_the_fit_s_error_and_a_small_and_a_large_one(refits):
    _, asked, run = refits(lambda name, start, options: start)
    start = fit_at(dem_error_m=2.0, correlation_columns=5.0)
    run(start)
    name, noises, reach, step, keep = asked[0]
    assert (name, reach, step, keep) == ("coarse", 2.4, 0.4, 3)
    assert noises[0] == Noise(2.0, 5.0, start.error_model)
    for noise, size_m in zip(noises[1:], (0.6, 4.5), strict=True):  # 0.2 and 1.5 times the nominal 3 m
        model = noise.model
        assert (noise.robust_sigma_m, noise.correlation_columns) == pytest.approx((size_m, 5.0))
        assert (model.rough_m, model.smooth_m, model.length_m) == pytest.approx((0.1 * size_m, size_m, 240.0))


def test_a_place_without_evidence_is_not_refined_further(refits):
    calls, _, run = refits(lambda name, start, options: start, [(21.0, 20.0)])
    found = run(fit_at(evidence=-0.1, correlation_columns=3.0))
    assert [name for name, *_ in calls] == ["middle", "middle"]
    assert found.correlation_columns == pytest.approx(3.0 * 2000 / 480)
    calls.clear()
    run(fit_at(evidence=0.1))
    assert [name for name, *_ in calls][-1] == "full"


@pytest.mark.parametrize(("inlier_share", "strict"), [(0.979, True), (0.981, False)])
def test_with_outliers_among_the_columns_strict_fits_are_tried(refits, inlier_share, strict):
    calls, asked, run = refits(lambda name, start, options: start)
    run(fit_at(inlier_share=inlier_share))
    factors = [options.get("sigma_factor", 1.0) for name, _, options in calls if name == "fine"]
    assert factors == ([1.0, 0.3] if strict else [1.0])
    assert [(name, reach, step) for name, _, reach, step, _ in asked[1:]] == (
        [("middle", 0.6, 0.15)] if strict else []
    )


def test_the_optimum_of_the_best_posterior_is_fitted_with_all_columns(refits):
    """The third grid point is the best; the fits of the first grid keep their place."""
    posterior = {20.0: 100.0, 21.0: 99.0, 22.0: 101.0, 23.0: 50.0}

    def answer(name, start, options):
        return dataclasses.replace(start, neg_log_posterior=posterior[start.row])

    calls, _, run = refits(answer, [(21.0, 20.0), (22.0, 20.0), (23.0, 20.0)])
    best, fine, coarse = run(fit_at())
    assert best.row == 23.0
    assert [fit.row for fit in coarse] == [21.0, 22.0, 23.0]
    costs = [fit.neg_log_posterior for fit in fine]
    assert costs == sorted(costs)
    starts = [start.row for name, start, _ in calls if name == "fine"]
    assert starts[:4] == [20.0, 23.0, 21.0, 22.0], "the fit that there was, then the best ones"
    assert calls[-1][0] == "full"
    assert calls[-1][1].row == 23.0


def test_a_fit_whose_strict_version_wins_stays_strict_with_all_columns(refits):
    def answer(name, start, options):
        strict = options.get("sigma_factor", 1.0) < 1.0
        return dataclasses.replace(start, neg_log_posterior=10.0 if strict else 100.0)

    calls, _, run = refits(answer)
    run(fit_at(inlier_share=0.9))
    assert calls[-1][2]["sigma_factor"] == 0.3


def test_the_other_unknowns_are_fitted_in_one_step_and_all_terms_count(monkeypatch):
    """For H = diag(2, 4) and g = (6, -8) of the other unknowns the step is (3, -2) and the gain 0.5 (18 + 16) = 17."""
    size = 4  # east, north, altitude, and a bias
    hessian, gradient = np.diag([1e3, 1e3, 2.0, 4.0]), np.array([7.0, 7.0, 6.0, -8.0])
    for name, answer in (
        ("residual_sigma", np.ones(3)),
        ("informative_columns", np.ones(3, bool)),
        ("ordered_columns", None),
        ("normal_equations", SimpleNamespace(hessian=hessian, gradient=gradient, nll=0.0)),
        ("visible_nll", 100.0),
        ("prior_nll", 20.0),
        ("outlier_penalty", 3.0),
        ("normalisation_term", 0.5),
    ):
        monkeypatch.setattr(local_grid, name, lambda *_, answer=answer: answer)
    x = np.array([1.0, 2.0, 500.0, 0.0])
    nll, fitted = local_grid._conditional_optimum(
        SimpleNamespace(size=size),  # type: ignore[arg-type]
        x,
        SimpleNamespace(residual=np.zeros(3)),  # type: ignore[arg-type]
        NOISE,
    )
    assert nll == pytest.approx(100.0 + 20.0 + 3.0 + 0.5 - 17.0)
    assert list(fitted) == [1.0, 2.0, 497.0, 2.0]
    assert list(x) == [1.0, 2.0, 500.0, 0.0]


@pytest.mark.parametrize(
    ("ends_at", "evidence", "is_plausible"),
    [
        ((20.0, 21.6), 75.0, True),  # 15 nats less than the fit's 90
        ((20.0, 21.6), 74.9, False),
        ((20.0, 20.9), 90.0, False),  # nearer to the fit than to the point at column 22
        ((20.0, 21.1), 90.0, True),
        ((22.5, 22.0), 90.0, True),
    ],
)
def test_a_point_is_plausible_if_a_fit_from_it_stays_there_and_explains_as_much(
    monkeypatch, averaged, ends_at, evidence, is_plausible
):
    kept = []

    def second_moment(problem, start, noise, reach, step, temperature, plausible):
        monkeypatch.setattr(local_optima, "refit", lambda *_, **__: fit_at(*ends_at, evidence=evidence))
        kept.append(plausible(20.0, 22.0, 522.0))
        return np.eye(2)

    best = fit_at()
    monkeypatch.setattr(local_optima, "refit", lambda problem, start, largest, **_: start)
    monkeypatch.setattr(local_optima, "grid_second_moment", second_moment)
    problems = SimpleNamespace(
        coarse=SimpleNamespace(stride=4, sigma_rad=np.zeros(25)),
        full=SimpleNamespace(terrain=terrain_of(np.full((SIDE, SIDE), 500.0)), sigma_rad=np.zeros(100)),
    )
    local_optima._averaged_over_optima(problems, best, [best], [], 12.0)  # type: ignore[arg-type]
    assert kept == [is_plausible]


def test_of_many_optima_four_are_refitted_and_two_of_them_strictly(refits):
    """Five points of each grid, all of them better than the fit that there was."""

    def answer(name, start, options):
        return dataclasses.replace(start, neg_log_posterior=100.0 - start.row, inlier_share=0.9)

    calls, _, run = refits(answer, [(row, 20.0) for row in (21.0, 22.0, 23.0, 24.0, 25.0)])
    run(fit_at(inlier_share=0.9))
    fine = [(start.row, options.get("sigma_factor", 1.0)) for name, start, options in calls if name == "fine"]
    assert [row for row, factor in fine[:4]] == [20.0, 25.0, 24.0, 23.0]
    assert [row for row, factor in fine if factor == 0.3] == [25.0, 25.0]
    assert all(options["estimate_noise"] for _, _, options in calls), "each fit finds its own noise"


@pytest.mark.parametrize(("apart", "strict"), [(0.049, False), (0.051, True)])
def test_fits_that_end_at_different_optima_are_searched_more_finely(refits, apart, strict):
    def answer(name, start, options):
        ends = (
            HOME[0] + apart
            if name == "fine" and start.row == 21.0
            else HOME[0]
            if name == "fine"
            else start.row
        )
        return dataclasses.replace(start, row=ends)

    _, asked, run = refits(answer, [(21.0, 20.0)])
    run(fit_at())
    assert len(asked) == (2 if strict else 1)


@pytest.mark.parametrize(("col", "rise_m"), [(25.0, 5.0), (60.0, 0.0)])
def test_beside_the_dem_a_fit_keeps_its_altitude(terrain, col, rise_m):
    moved = local_optima._at(fit_at(), HOME[0], col, terrain)
    assert (moved.row, moved.col, moved.altitude_m) == pytest.approx((HOME[0], col, 522.0 + rise_m))
