"""Pictures of another engine, with realistic sensor errors and relief that the DEM lacks."""

import json
from pathlib import Path

import numpy as np
import pytest
from pyproj import Transformer

from localizer.bundle import load_bundle
from localizer.dem.lattice import load_dem
from localizer.search.details import LocateResult
from localizer.search.locate import locate_bundle

pytestmark = pytest.mark.long

DEMS = {"bt": "bigtujunga_srtm_30m.tif", "sh": "sthelens_usgs_30m.dem", "yo": "yosemite_ned_1s.tif"}


@pytest.fixture(scope="module")
def results(skyfix_data: Path) -> dict[str, tuple[LocateResult, float]]:
    """The answer for each rendered bundle and how far off it is in metres."""
    out = {}
    for folder in sorted((skyfix_data / "rendered").iterdir()):
        dem = load_dem([skyfix_data / "terrain" / DEMS[folder.name[:2]]])
        result = locate_bundle(load_bundle(folder / "bundle"), dem)
        truth = json.loads((folder / "truth.json").read_text())
        to_metric = Transformer.from_crs(truth["crs"], dem.metric_crs, always_xy=True)
        easting, northing = to_metric.transform(truth["position"]["easting"], truth["position"]["northing"])
        place = result.fix.position
        off = np.inf if place is None else np.hypot(place.easting_m - easting, place.northing_m - northing)
        out[folder.name] = result, float(off)
    return out


def test_all_are_fixed_within_30_m(results):
    far = {name: off for name, (result, off) in results.items() if result.fix.status != "fix" or off > 30.0}
    assert not far


def test_no_wrong_place_is_called_a_fix(results):
    wrong = {
        name: off for name, (result, off) in results.items() if result.fix.status == "fix" and off > 150.0
    }
    assert not wrong
