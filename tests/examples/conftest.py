"""The folder that the examples of the documentation run in: the terrain that ships, and two bundles of a short drive."""

import json
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import matplotlib as mpl
import pytest

import localizer
from sim.evaluate.image_level import write_pictures
from sim.evaluate.scenario import EvaluationScenario
from sim.evaluate.truth import case_generators, truth_at
from sim.world.surface import Surface
from sim.world.terrain import read_terrain

ROOT = Path(__file__).parents[2]
TERRAIN = ROOT / "sim" / "terrain" / "santa_cruz_srtm_1s.tif"
SCENARIO = ROOT / "configs" / "scenarios" / "evaluate" / "realistic.toml"
STOPS = {"first": (37.32802, -122.21957), "second": (37.328, -122.2173)}
LEG = {"distance_m": 201.0, "distance_sigma_m": 4.0, "heading_deg": 90.6, "heading_sigma_deg": 1.0}


def _make_bundle(surface: Surface, folder: Path, lat_deg: float, lon_deg: float, seed: int) -> dict[str, Any]:
    """Render the bundle of a rig at a place; returns the truth."""
    scenario = EvaluationScenario.model_validate(tomllib.loads(SCENARIO.read_text()))
    terrain = localizer.load_dem(TERRAIN)
    row, col = (float(value) for value in localizer.lonlat_to_rowcol(terrain, lon_deg, lat_deg))
    eye_m = surface.height(row, col) + scenario.vehicle.mast_height_m
    truth = truth_at(surface, surface.observer(row, col, eye_m), scenario, case_generators(1, seed))
    write_pictures(truth, scenario, seed, folder)
    easting_m, northing_m = localizer.rowcol_to_metric(terrain, row, col)
    return {
        "easting_m": float(easting_m),
        "northing_m": float(northing_m),
        "crs": terrain.metric_crs.to_string(),
    }


@pytest.fixture(scope="session")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """``terrain.tif``, ``bundles/first``, ``bundles/second``, ``truth.json`` (of the first) and ``legs.jsonl``."""
    folder = tmp_path_factory.mktemp("drive")
    (folder / "terrain.tif").symlink_to(TERRAIN)
    surface = Surface(read_terrain([TERRAIN]))
    truths = [
        _make_bundle(surface, folder / "bundles" / name, *place, seed)
        for seed, (name, place) in enumerate(STOPS.items())
    ]
    (folder / "truth.json").write_text(json.dumps(truths[0]))
    (folder / "legs.jsonl").write_text(json.dumps(LEG) + "\n")
    return folder


@pytest.fixture
def in_drive(drive: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Run in that folder, with figures that go nowhere."""
    monkeypatch.chdir(drive)
    backend = mpl.get_backend()
    mpl.use("agg")
    yield drive
    mpl.use(backend)


@pytest.fixture(scope="session")
def result(drive: Path) -> localizer.LocateResult:
    """What ``localizer.locate`` returns for the first bundle."""
    dem = localizer.load_dem(drive / "terrain.tif")
    return localizer.locate(localizer.load_bundle(drive / "bundles" / "first"), dem)
