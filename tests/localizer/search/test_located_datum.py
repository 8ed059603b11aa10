"""A whole search on elevation files that say too little or count from elsewhere; pictures rendered from other terrain data."""

import json

import numpy as np
import pytest
import rasterio

BUNDLE = "rendered/bt_ridge/bundle"
TERRAIN = "terrain/bigtujunga_srtm_30m.tif"

pytestmark = pytest.mark.long


@pytest.fixture
def rewritten(skyfix_data, tmp_path):
    """The terrain of the pictures, shifted up and with another CRS."""

    def write(name, crs="EPSG:32611", shift_m=0.0):
        with rasterio.open(skyfix_data / TERRAIN) as dataset:
            z = dataset.read(1, masked=True).astype(np.float32)
            profile = dataset.profile | {"dtype": "float32", "nodata": -9999.0, "crs": crs}
        path = tmp_path / name
        with rasterio.open(path, "w", **profile) as dataset:
            dataset.write((z + shift_m).filled(-9999.0), 1)
        return path

    return write


@pytest.fixture
def located(skyfix_data, run):
    def locate(*options):
        status, out, err = run("locate", skyfix_data / BUNDLE, "--json", *options)
        fix = json.loads(out)
        return status, fix, err

    return locate


def test_an_unknown_datum_is_no_fix_until_it_is_named(rewritten, located):
    path = rewritten("clarke.tif", "+proj=utm +zone=11 +ellps=clrk66 +units=m")
    status, fix, err = located("--dem", path)
    assert (status, fix["status"], fix["reason"]["code"]) == (3, "ambiguous", "unknown_datum")
    assert err.count("datum of the elevation model is not known") == 1
    status, fix, err = located("--dem", path, "--crs", "EPSG:26711")
    assert (status, fix["status"], fix["reason"]) == (0, "fix", None)
    assert "good to 7 m" in err


def test_heights_of_another_reference_are_explained_and_mended(rewritten, located):
    path = rewritten("ellipsoid.tif", shift_m=-33.5)
    status, fix, err = located("--dem", path)
    assert status == 4
    assert fix["reason"]["code"] == "no_ground_at_altitude"
    assert "without the altimeter the terrain fits at 34.29" in err
    status, fix, _ = located("--dem", path, "--geoid-offset", "-33.5")
    assert status == 0
    assert (
        np.hypot(fix["position"]["easting_m"] - 400_579.3, fix["position"]["northing_m"] - 3_795_164.7) < 40.0
    )
