"""Stage 2's rounds: how many azimuths, headings and cells each compares, and which cells go on."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from localizer.observation import Observation
from localizer.search import coarse_to_fine
from localizer.search.coarse_to_fine import Round, likeliest_cells
from localizer.search.contours import BINS, STEP_DEG, MeasuredSkyline
from localizer.search.stage2 import ScoredCells

RELIEF_M, GROUND_M, MAST_M = 4.0, 100.0, 2.0


def skyline(seen_deg: float = 360.0) -> MeasuredSkyline:
    elevation_deg = np.full(BINS, np.nan)
    elevation_deg[: round(seen_deg / STEP_DEG)] = 1.0
    return MeasuredSkyline(elevation_deg, np.full(BINS, 0.1), np.zeros(BINS), {})


@pytest.fixture
def rounds(monkeypatch):
    """The ranking of ``count`` cells whose disparities are given by their row; records what each round was asked."""

    def of(
        count: int, disparity, *, seen_deg: float = 360.0, offsets=(0.0,), altitude_m: float | None = None
    ):
        calls = []

        def search(terrain, seen, cells, eye_m, slack_m, offsets_deg, sigma_deg, dem_error_m, every_deg):
            calls.append(
                SimpleNamespace(
                    cells=len(cells), every_deg=every_deg, eye_m=list(eye_m[:2]), slack_m=slack_m[0],
                    offsets_deg=offsets_deg, sigma_deg=sigma_deg, dem_error_m=dem_error_m,
                )
            )  # fmt: skip
            found = np.array([disparity(int(row)) for row in cells[:, 0]])
            order = np.argsort(found, kind="stable")
            return ScoredCells(cells[order], found[order], cells[order, 0] * 0.25)

        monkeypatch.setattr(coarse_to_fine, "search_stage2", search)
        cells = np.column_stack([np.arange(count), np.zeros(count, np.int64)])
        terrain = SimpleNamespace(
            half_cell_relief_m=np.full((count, 1), RELIEF_M, np.float32),
            height_m=(GROUND_M + 10.0 * np.arange(count)[:, None]).astype(np.float32),
            nominal_error_m=3.0,
        )
        observation = Observation((), MAST_M, altitude_m, 5.0, 1.5, 0.02)
        return likeliest_cells(terrain, observation, skyline(seen_deg), cells, np.array(offsets)), calls  # type: ignore[arg-type]

    return of


def test_few_cells_are_compared_every_6_deg_and_the_best_every_2(rounds):
    ranked, calls = rounds(700, lambda row: 100.0 * row)
    assert [(c.cells, c.every_deg) for c in calls] == [(700, 6.0), (600, 2.0)]
    assert len(ranked.scored.cells) == 150
    assert [cutoff.best_rejected for cutoff in ranked.cutoffs] == [60_000.0, 15_000.0]
    assert list(ranked.scored.azimuth_bias_deg[:3]) == [0.0, 0.25, 0.5]


def test_good_cells_go_on_up_to_a_limit(rounds):
    ranked, calls = rounds(3000, lambda row: 0.0)
    assert [c.cells for c in calls] == [3000, 2000]
    assert len(ranked.scored.cells) == 600


def test_cells_within_six_sigma_of_the_best_go_on(rounds):
    """All round there are 60 sectors of 6 deg: sigma = sqrt(2 / 60) = 0.18257, six of them 1.0954."""
    ranked, calls = rounds(1000, lambda row: 0.0 if row == 0 else (1.095 if row < 800 else 1.096))
    assert calls[1].cells == 800
    assert len(ranked.scored.cells) == 600
    assert ranked.sigma == pytest.approx(math.sqrt(2.0 / 60.0))
    assert [cutoff.sigma for cutoff in ranked.cutoffs] == pytest.approx([ranked.sigma] * 2)


@pytest.mark.parametrize("count", [100, 150])
def test_if_all_cells_go_on_nothing_was_rejected(rounds, count):
    ranked, _ = rounds(count, float)
    assert [cutoff.best_rejected for cutoff in ranked.cutoffs] == [math.inf, math.inf]


@pytest.mark.parametrize(
    ("cells", "expected"),
    [
        (10_000, [Round(6.0, 600, 2000), Round(2.0, 150, 600)]),
        (10_001, [Round(12.0, 3000, 8000), Round(6.0, 600, 2000), Round(2.0, 150, 600)]),
        (30_001, [Round(24.0, 3000, 8000), Round(6.0, 600, 2000), Round(2.0, 150, 600)]),
        (900_000, [Round(30.0, 3000, 8000), Round(6.0, 600, 2000), Round(2.0, 150, 600)]),
    ],
)
def test_many_cells_have_a_round_of_their_own_with_fewer_azimuths(cells, expected):
    assert list(coarse_to_fine._rounds(cells)) == expected


@pytest.mark.parametrize(
    ("seen_deg", "every_deg", "sectors"),
    [
        (40.0, [5.0, 2.0], 40.0 / 6.0),  # eight columns at least
        (10.0, [1.25, 1.25], 10.0 / 6.0),
        (1.0, [0.25, 0.25], 1.0),  # a bin, and one sample
    ],
)
def test_a_narrow_skyline_is_compared_at_a_closer_spacing(rounds, seen_deg, every_deg, sectors):
    ranked, calls = rounds(10, float, seen_deg=seen_deg)
    assert [c.every_deg for c in calls] == every_deg
    assert ranked.sigma == pytest.approx(math.sqrt(2.0 / sectors))


def test_columns_farther_apart_than_a_sector_count_as_one_sample_each(rounds):
    ranked, calls = rounds(10_001, lambda row: 0.0)
    assert calls[0].every_deg == 12.0
    assert ranked.cutoffs[0].sigma == pytest.approx(math.sqrt(2.0 / 30.0))


@pytest.mark.parametrize(
    ("offsets", "step_deg", "count"),
    [((-2.0, 0.0, 2.0), 2.0, 3), ((-9.0, -5.75, -2.5, 0.75, 4.0, 7.25), 2.0, 9)],  # -9 to 7 in steps of 2
)
def test_headings_are_at_most_2_deg_apart(rounds, offsets, step_deg, count):
    _, calls = rounds(10, float, offsets=offsets)
    assert len(calls[0].offsets_deg) == count
    assert np.diff(calls[0].offsets_deg) == pytest.approx(step_deg)
    assert calls[0].offsets_deg[0] == offsets[0]


@pytest.mark.parametrize(
    ("altitude_m", "eye_m"),
    # of two cells at 100 and 110 m: mast of 2 m; relief of 4 m to each side
    [(None, [102.0, 112.0]), (103.0, [103.0, 108.0]), (200.0, [106.0, 116.0]), (0.0, [98.0, 108.0])],
)
def test_the_eye_is_at_the_altimeter_s_height_as_far_as_the_relief_allows(rounds, altitude_m, eye_m):
    _, calls = rounds(10, float, altitude_m=altitude_m)
    assert (calls[0].eye_m, calls[0].slack_m) == (eye_m, RELIEF_M)
    assert (calls[0].sigma_deg, calls[0].dem_error_m) == (1.5, 3.0)
