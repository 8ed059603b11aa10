"""Drawn cases: their errors are those of the scenario."""

from pathlib import Path

import numpy as np
import pytest

from sim.evaluate.case import true_surface
from sim.evaluate.disturb import contour_noise, disturb, true_contours
from sim.evaluate.scenario import DemError, EvaluationScenario, load_evaluation_scenario
from sim.evaluate.searched_dem import beyond, searched_terrain
from sim.evaluate.truth import case_generators, draw_truth, with_errors

SCENARIOS = Path(__file__).parents[3] / "configs" / "scenarios" / "evaluate"
COLUMNS = np.arange(640, dtype=float)


def disturbed(santa_cruz: Path, name: str, case: int):
    """Exact and disturbed contours of a case of a scenario, without noise."""
    given = load_evaluation_scenario(SCENARIOS / f"{name}.toml")
    quiet = {"contour_sigma_px": 0.0, "contour_correlated_sigma_px": 0.0}
    scenario = given.model_copy(update={"errors": given.errors.model_copy(update=quiet)})
    rng = case_generators(1, case)
    truth = draw_truth(true_surface(santa_cruz), scenario, rng)
    exact = true_contours(truth, scenario.camera, COLUMNS)
    return exact, disturb(truth, scenario, COLUMNS, exact, rng)


@pytest.mark.parametrize("path", sorted(SCENARIOS.glob("*.toml")), ids=lambda path: path.stem)
def test_every_scenario_that_ships_can_be_read(path: Path) -> None:
    assert load_evaluation_scenario(path).errors.altitude_sigma_m > 0.0


def test_an_ideal_case_has_the_exact_contours(santa_cruz: Path) -> None:
    exact, seen = disturbed(santa_cruz, "ideal", 0)
    np.testing.assert_array_equal(seen.rows_px, exact)


def test_clouds_lower_the_contour_and_the_foreground_raises_it(santa_cruz: Path) -> None:
    for name, higher in (("cloud", False), ("foreground", True)):
        changes = []
        for case in range(4):
            exact, seen = disturbed(santa_cruz, name, case)
            for rows, true_rows, genuine in zip(seen.rows_px, exact, seen.genuine, strict=True):
                np.testing.assert_array_equal(rows[genuine], true_rows[genuine])
                changes.append((rows - true_rows)[np.isfinite(rows) & ~genuine])
        change = np.concatenate(changes)
        assert len(change) > 0
        assert (change < 0.0).all() if higher else (change > 0.0).all()


def test_one_direction_of_an_occluded_case_is_not_the_terrain(santa_cruz: Path) -> None:
    for case in range(4):
        _, seen = disturbed(santa_cruz, "occluded", case)
        assert sorted(genuine.mean() > 0.9 for genuine in seen.genuine) == [False, True, True, True]


def test_contour_noise_has_the_sigmas_and_the_correlation_asked_for() -> None:
    errors = {"contour_sigma_px": 0.6, "contour_correlated_sigma_px": 0.4, "contour_correlation_px": 12.0}
    noise = contour_noise(
        200_000, EvaluationScenario.model_validate({"errors": errors}), np.random.default_rng(1)
    )
    assert noise.std() == pytest.approx(np.hypot(0.6, 0.4), rel=0.03)
    assert np.mean(noise[12:] * noise[:-12]) == pytest.approx(0.16 * np.exp(-1.0), rel=0.1)


def test_a_dem_error_has_the_size_and_the_reach_asked_for(santa_cruz: Path) -> None:
    terrain = true_surface(santa_cruz).terrain
    wrong = with_errors(terrain, DemError(rms_m=5.0, correlation_m=200.0), np.random.default_rng(1))
    error = (wrong.height_m - terrain.height_m).astype(float)
    assert np.sqrt(np.mean(error**2)) == pytest.approx(5.0, rel=0.02)
    south_m, _ = terrain.cell_size_m()
    cells = round(200.0 / south_m)
    expected = 25.0 * np.exp(-((cells * south_m / 200.0) ** 2))
    assert np.mean(error[cells:] * error[:-cells]) == pytest.approx(expected, rel=0.06)


def test_measured_minus_true_attitude_has_the_sigmas_of_the_scenario(santa_cruz: Path) -> None:
    scenario = load_evaluation_scenario(SCENARIOS / "realistic.toml")
    bias, own = [], []
    for case in range(60):
        frames = draw_truth(true_surface(santa_cruz), scenario, case_generators(2, case)).frames
        off = [(f.measured.heading_deg - f.attitude.heading_deg + 180.0) % 360.0 - 180.0 for f in frames]
        bias.append(np.mean(off))
        own.extend(np.array(off) - np.mean(off))
        assert all(abs(frame.attitude.roll_deg) <= 5.0 for frame in frames)
    assert np.std(bias) == pytest.approx(1.0, rel=0.3)
    assert np.std(own) == pytest.approx(0.1 * np.sqrt(0.75), rel=0.2)


def test_the_truth_of_an_outside_case_is_not_on_what_is_searched(santa_cruz: Path) -> None:
    surface = true_surface(santa_cruz)
    rows, cols = surface.height_m.shape
    for side, inner in (
        ("north", (0, cols // 2)),
        ("south", (rows - 1, 0)),
        ("west", (0, 0)),
        ("east", (0, cols - 1)),
    ):
        allowed = beyond(surface, side, 1000.0)
        assert not allowed[inner]
        assert 0.3 < allowed.mean() < 0.5
        dem = searched_terrain(santa_cruz, side).dem
        assert dem.z_m.size == pytest.approx(rows * cols / 2, rel=0.01)
    whole, east = searched_terrain(santa_cruz).dem, searched_terrain(santa_cruz, "east").dem
    np.testing.assert_array_equal(east.z_m, whole.z_m[:, cols // 2 :])
    assert east.transform.c == pytest.approx(whole.transform.c + whole.transform.a * (cols // 2))
