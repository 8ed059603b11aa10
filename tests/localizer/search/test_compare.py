"""Places are compared from each other's offsets; a stretch that one explains and another misses grossly counts against it."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from fits import refined

from localizer.search import compare
from localizer.search.fit.refine import Refined

PER_SECTOR = 12
SECTORS = 10
SIGMA_RAD = 1e-3


def place(row: float = 0.0, **changes: object) -> Refined:
    few = {"frame_errors_deg": np.zeros((1, 3)), "correlation_columns": 4.0}
    return refined(row, **(few | changes))


# ---- gross errors


@pytest.fixture
def gross(monkeypatch):
    """Lengths of horizon, in sectors, that count against places whose residuals (columns,) in radians are given."""
    problem = SimpleNamespace(
        sectors=np.split(np.arange(SECTORS * PER_SECTOR), SECTORS),
        sector_columns=PER_SECTOR,
        terrain=SimpleNamespace(geodesics=SimpleNamespace(at=lambda row, col: [None])),
    )

    def of(*residuals_rad: np.ndarray, sigma_rad: float = SIGMA_RAD, informative: np.ndarray | None = None):
        columns = SECTORS * PER_SECTOR
        monkeypatch.setattr(
            compare,
            "evaluate",
            lambda problem, x, origin, coefficients: SimpleNamespace(residual=residuals_rad[int(origin[0])]),
        )
        monkeypatch.setattr(compare, "residual_sigma", lambda *_: np.full(columns, sigma_rad))
        used = np.ones(columns, bool) if informative is None else informative
        monkeypatch.setattr(compare, "informative_columns", lambda *_: used)
        return compare._gross_errors(problem, [place(float(i)) for i in range(len(residuals_rad))])  # type: ignore[arg-type]

    return of


FITS = np.zeros(SECTORS * PER_SECTOR)


def off(off_rad: float, columns: slice) -> np.ndarray:
    residual = FITS.copy()
    residual[columns] = off_rad
    return residual


ONE_DEG = np.radians(1.0)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_sector_that_another_place_explains_counts_by_its_length(gross, sign):
    assert gross(FITS, off(sign * 0.02, slice(24, 36))) == pytest.approx([0.0, 1.0])
    assert gross(FITS, off(sign * 0.02, slice(24, 28))) == pytest.approx([0.0, 1.0 / 3.0])
    assert gross(FITS, off(sign * 0.02, slice(24, 60))) == pytest.approx([0.0, 3.0])


@pytest.mark.parametrize(
    ("off_rad", "sigma_rad", "counts"),
    [
        (1.001 * ONE_DEG, 1e-3, True),  # a degree, although 6 sigma are a third of it
        (0.999 * ONE_DEG, 1e-3, False),
        (0.0601, 1e-2, True),  # six sigma, although a degree is a third of that
        (0.0599, 1e-2, False),
    ],
)
def test_an_error_is_gross_beyond_a_degree_and_six_sigma(gross, off_rad, sigma_rad, counts):
    found = gross(FITS, off(off_rad, slice(0, 12)), sigma_rad=sigma_rad)
    assert found == pytest.approx([0.0, 1.0 if counts else 0.0])


@pytest.mark.parametrize(("sigmas", "explained"), [(2.9, True), (3.1, False)])
def test_a_stretch_is_explained_within_three_sigma(gross, sigmas, explained):
    stretch = slice(0, 12)
    found = gross(off(sigmas * SIGMA_RAD, stretch), off(0.02, stretch))
    assert found == pytest.approx([0.0, 1.0 if explained else 0.0])


def test_what_no_place_explains_is_a_tree_or_a_cloud(gross):
    assert gross(off(0.03, slice(0, 12)), off(0.02, slice(0, 12))) == pytest.approx([0.0, 0.0])


@pytest.mark.parametrize(("columns", "counts"), [(3, 1.0), (2, 0.0)])
def test_a_stretch_with_fewer_than_seven_tenths_of_informative_columns_is_not_judged(gross, columns, counts):
    """Three of four columns of a stretch, or two."""
    used = np.zeros((SECTORS * 3, 4), bool)
    used[:, :columns] = True
    found = gross(FITS, off(0.02, slice(0, 12)), informative=used.ravel())
    assert found == pytest.approx([0.0, counts])


@pytest.mark.parametrize(("columns", "counts"), [([0], 0.0), ([1, 2], 0.0), ([0, 1, 3], 1.0 / 3.0)])
def test_most_columns_of_a_stretch_have_to_be_off(gross, columns, counts):
    """The median of four is the mean of the middle two: 10 mrad of 20, less than a degree."""
    residual = FITS.copy()
    residual[columns] = 0.02
    assert gross(FITS, residual) == pytest.approx([0.0, counts])
    found = gross(residual, off(0.03, slice(0, 4)))
    assert found[1] == pytest.approx(1.0 / 3.0 if columns == [0] else 0.0), (
        "nor does one column keep it from being explained"
    )


# ---- the comparison


def test_a_place_takes_the_offset_of_another_one_in_its_own_cell_at_the_same_height_above_the_ground():
    ground_m = {(100.25, 49.6): 500.0, (10.25, 79.6): 650.0, (8.25, 81.6): np.nan}
    terrain = SimpleNamespace(
        dem=SimpleNamespace(ground_m=lambda row, col: ground_m[round(row, 2), round(col, 2)])
    )
    other = place(100.25, altitude_m=502.5)
    other = dataclasses.replace(other, col=49.6)
    moved = compare.with_offset_of(dataclasses.replace(place(9.9), col=80.1), other, terrain)  # type: ignore[arg-type]
    assert (moved.row, moved.col, moved.altitude_m) == pytest.approx((10.25, 79.6, 652.5))
    void = compare.with_offset_of(dataclasses.replace(place(8.1), col=81.9), other, terrain)  # type: ignore[arg-type]
    assert (void.row, void.col, void.altitude_m) == pytest.approx((8.25, 81.6, 800.0))


@pytest.fixture
def compared(monkeypatch):
    """The comparison, where a refit with noise n of a place gives what ``answer(place, noise, problem)`` says."""

    def of(places, answer, *, gross=None, edge=False):
        calls = []

        def refit(problem, start, largest, *, noise):
            calls.append((problem.name, start.row, noise))
            return answer(problem.name, start, noise)

        middle = SimpleNamespace(name="middle", stride=2.0, terrain=None)
        full = SimpleNamespace(
            terrain=SimpleNamespace(cell_m=30.0), observation=None, contours=[], name="full"
        )
        problems = SimpleNamespace(middle=middle, full=full)
        with_edge = SimpleNamespace(middle=SimpleNamespace(name="with edge", stride=2.0, terrain=None))
        monkeypatch.setattr(compare, "refit", refit)
        monkeypatch.setattr(compare, "with_offset_of", lambda place, other, terrain: place)
        monkeypatch.setattr(compare, "has_edge_columns", lambda problem, place: edge and place is places[0])
        monkeypatch.setattr(
            compare, "problems_of", lambda *_, uses_edge_columns: with_edge if uses_edge_columns else problems
        )
        monkeypatch.setattr(
            compare, "_gross_errors", lambda problem, fits: np.zeros(len(fits)) if gross is None else gross
        )
        return compare.compare_on_same_columns(problems, places, 12.0), calls  # type: ignore[arg-type]

    return of


def test_a_single_place_is_not_compared(compared):
    found, calls = compared([place(3.0)], None)
    assert [(c.place.row, c.log_mass) for c in found] == [(3.0, 0.0)]
    assert calls == []


def test_each_place_is_fitted_under_the_noise_of_every_one_and_its_best_fit_counts(compared):
    """The second place gains under the first one's noise, and overtakes it."""
    one, other = place(0.0), place(100.0, evidence=80.0, dem_error_m=2.0)

    def answer(problem, start, noise):
        gains = 16.0 if start.row == 100.0 and noise.robust_sigma_m == 1.0 else -2.0
        return dataclasses.replace(start, evidence=start.evidence + gains)

    found, calls = compared([one, other], answer)
    assert [c.place.row for c in found] == [100.0, 0.0]
    assert found[0].place is other, "the place itself stays that of all columns"
    first_round = calls[:4]
    assert [(row, noise.robust_sigma_m) for _, row, noise in first_round] == [
        (0.0, 1.0), (0.0, 2.0), (100.0, 1.0), (100.0, 2.0),
    ]  # fmt: skip
    assert {noise.correlation_columns for _, _, noise in first_round} == {2.0}, "every second of the columns"
    assert {noise.correlation_columns for _, _, noise in calls[4:]} == {4.0}, "of the fits of the first round"
    assert len(calls) == 8, "two rounds"


@pytest.mark.parametrize(("behind", "fits"), [(30.2, 0), (29.8, 8)])
def test_a_place_that_leads_by_15_nats_of_mass_needs_no_comparison(compared, behind, fits):
    """Half of the evidence counts."""
    places = [place(0.0), place(100.0, evidence=90.0 - behind)]
    _, calls = compared(places, lambda problem, start, noise: start)
    assert len(calls) == fits


def test_a_gross_error_over_a_sector_costs_10_nats(compared):
    places = [place(0.0), place(100.0)]
    found, _ = compared(places, lambda problem, start, noise: start, gross=np.array([1.5, 0.5]))
    assert [c.place.row for c in found] == [100.0, 0.0]
    assert found[0].log_mass - found[1].log_mass == pytest.approx(10.0)
    # 0.5 * 88, ln(1 + 9) for the width, 10 nats over half a sector
    assert found[0].log_mass == pytest.approx(44.0 + np.log(10.0) - 5.0)


def test_columns_at_the_dem_s_edge_are_used_if_that_is_likelier(compared):
    def answer(problem, start, noise):
        return dataclasses.replace(start, evidence=95.0 if problem == "with edge" else 85.0)

    found, calls = compared([place(0.0), place(100.0)], answer, edge=True)
    assert {name for name, *_ in calls} == {"middle", "with edge"}
    assert found[0].log_mass == pytest.approx(0.5 * 93.0 + np.log(10.0))


def test_equal_places_are_ordered_by_position(compared):
    found, _ = compared([place(100.0), place(0.0)], lambda problem, start, noise: start)
    assert [c.place.row for c in found] == [0.0, 100.0]
