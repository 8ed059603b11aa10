"""What elevations count from, and what becomes of an altitude that counts from something else."""

from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pyproj
import pytest
import rasterio
from affine import Affine
from pyproj import CRS

from localizer.dem.datum import pipeline
from localizer.dem.heights import GEOID_SIGMA_M, heights_of
from localizer.dem.info import dem_notes
from localizer.dem.lattice import DemError, dem_from_array, load_dem
from localizer.fix import Fix, Nuisance, Position, Stage1Counts
from localizer.observation import Observation
from localizer.search.altitude_reference import altitude_note, diagnose_altimeter, with_datum_uncertainty
from localizer.search.answer import Located, without_known_datum

ELLIPSOIDAL = (
    'COMPD_CS["UTM 11 + ellipsoid",'
    + CRS.from_epsg(32611).to_wkt("WKT1_GDAL")
    + ',VERT_CS["WGS 84 ellipsoid",'
    'VERT_DATUM["World Geodetic System 1984 ellipsoid",2002],UNIT["metre",1],AXIS["Up",UP]]]'
)
LOCAL_HEIGHT = (
    ELLIPSOIDAL.replace('VERT_CS["WGS 84 ellipsoid"', 'VERT_CS["local height"')
    .replace("World Geodetic System 1984 ellipsoid", "Ellipsoid of a survey")
    .replace(",2002]", ",2005]")
)
"""Only the name of its datum says what it counts from."""
GRID = Affine(30.0, 0.0, 400_000.0, 0.0, -30.0, 3_800_000.0)
HILLS = (500.0 + np.add.outer(np.arange(40.0), np.arange(50.0))).astype(np.float32)


@pytest.mark.parametrize(
    ("crs", "name", "ellipsoidal"),
    [
        ("EPSG:32611", None, False),
        ("EPSG:5773", "EGM96 height", False),
        (LOCAL_HEIGHT, "local height", True),
        ("EPSG:4979", "height above the ellipsoid", True),
        ("EPSG:4326+5773", "EGM96 height", False),
        ("EPSG:4326+3855", "EGM2008 height", False),
        ("EPSG:26911+5703", "NAVD88 height", False),
        ("EPSG:6339+6360", "NAVD88 height (ftUS)", False),
        (ELLIPSOIDAL, "height above the ellipsoid", True),
        (CRS.from_epsg(32611).to_3d().to_wkt(), "height above the ellipsoid", True),
    ],
)
def test_the_vertical_datum_is_what_the_crs_says(crs, name, ellipsoidal):
    heights = heights_of(CRS.from_user_input(crs))
    assert (heights.name, heights.ellipsoidal) == (name, ellipsoidal)


def test_a_file_s_vertical_datum_is_printed(write_raster, run):
    path = write_raster(HILLS, crs="EPSG:26910+5703")
    _, out, _ = run("dem", "info", path)
    assert "heights       NAVD88 height" in out
    _, out, _ = run("dem", "info", write_raster(HILLS, "plain.tif"))
    assert "heights       not stated" in out


def test_it_is_kept_where_crs_is_told(write_raster):
    """--crs says where the grid lies, not what its elevations count from."""
    path = write_raster(HILLS, crs=ELLIPSOIDAL, transform=GRID)
    assert load_dem([path], crs="EPSG:26911").heights.ellipsoidal


def test_heights_above_the_ellipsoid_are_said_and_the_altimeter_trusted_less(write_raster, run):
    path = write_raster(HILLS, crs=ELLIPSOIDAL, transform=GRID)
    status, out, _ = run("dem", "info", path)
    assert status == 0
    assert "--geoid-offset" in out
    dem = load_dem([path])
    trusted = with_datum_uncertainty(observation(altitude_m=1000.0, sigma_m=5.0), dem)
    assert trusted.altitude_sigma_m == pytest.approx(np.hypot(5.0, GEOID_SIGMA_M))


def test_the_geoid_offset_is_taken_off_and_then_the_altimeter_counts(write_raster):
    path = write_raster(HILLS, crs=ELLIPSOIDAL, transform=GRID)
    dem = load_dem([path], geoid_offset_m=-33.5)
    assert np.allclose(dem.z_m, HILLS + 33.5)
    told = observation(altitude_m=1000.0, sigma_m=5.0)
    assert with_datum_uncertainty(told, dem) is told
    assert not any("ellipsoid" in note for note in dem_notes(dem))
    # without a word in the file too: not every file says it
    assert np.allclose(load_dem([write_raster(HILLS, "bare.tif")], geoid_offset_m=-33.5).z_m, HILLS + 33.5)


@pytest.mark.parametrize("offset", ["nan", "inf", "-3350", "121"])
def test_a_geoid_offset_that_no_place_has_is_refused(write_raster, refused, offset):
    assert "--geoid-offset" in refused("dem", "info", write_raster(HILLS), "--geoid-offset", offset)


def test_a_geoid_offset_that_the_file_contradicts_is_noted(write_raster, run):
    path = write_raster(HILLS, crs="EPSG:26911+5703")
    status, out, _ = run("dem", "info", path, "--geoid-offset", "-33.5")
    assert status == 0
    assert (
        "says that its elevations are NAVD88 height, which counts from the sea; --geoid-offset moves them by +33.5 m"
        in out
    )
    assert "heights       NAVD88 height; -33.5 m taken off (--geoid-offset)" in out


def test_depths_are_no_elevations(write_raster, refused):
    path = write_raster(-HILLS, crs="EPSG:32610+5715")
    for options in ((), ("--vertical-unit", "m")):
        assert "count downwards (MSL depth); say --scale -1" in refused("dem", "info", path, *options)
    assert np.allclose(load_dem([path], scale=-1.0).z_m, HILLS)


def test_a_library_s_geoid_offset_is_checked_too(write_raster):
    with pytest.raises(DemError, match="--geoid-offset"):
        load_dem([write_raster(HILLS)], geoid_offset_m=500.0)


@pytest.fixture
def geoid(tmp_path):
    """Installs a geoid grid of the whole Earth, given by its undulation at longitudes and latitudes, for a while."""
    own = pyproj.datadir.get_data_dir()

    def install(
        undulation_m: Callable[[np.ndarray, np.ndarray], np.ndarray], name: str = "egm96_15.gtx"
    ) -> None:
        lon, lat = np.meshgrid(np.linspace(-180.0, 180.0, 13), np.linspace(90.0, -90.0, 7))
        folder = tmp_path / "proj"
        folder.mkdir(exist_ok=True)
        with rasterio.open(
            folder / name,
            "w",
            driver="GTX",
            height=7,
            width=13,
            count=1,
            dtype="float32",
            crs="EPSG:4326",
            transform=Affine(30.0, 0.0, -195.0, 0.0, -30.0, 105.0),
        ) as dataset:
            dataset.write(undulation_m(lon, lat).astype(np.float32), 1)
        pyproj.datadir.append_data_dir(str(folder))
        pipeline.cache_clear()

    yield install
    pyproj.datadir.set_data_dir(own)
    pipeline.cache_clear()


def test_an_installed_geoid_grid_brings_ellipsoidal_heights_to_the_sea(write_raster, geoid):
    """The undulation changes by 0.4 m to the north and by 0.3 m to the east: of each cell its own is taken off."""
    z_m = (500.0 + np.add.outer(np.arange(1100.0), np.arange(10.0))).astype(np.float32)
    path = write_raster(
        z_m, crs=ELLIPSOIDAL, transform=Affine(5_000.0, 0.0, 400_000.0, 0.0, -100.0, 3_800_000.0)
    )
    geoid(lambda lon, lat: 40.0 + 0.3 * lon - 0.4 * lat)
    dem = load_dem([path])
    east, north = np.meshgrid(402_500.0 + 5_000.0 * np.arange(10), 3_799_950.0 - 100.0 * np.arange(1100))
    lon, lat = pyproj.Transformer.from_crs(32611, 4326, always_xy=True).transform(east, north)
    expected_m = 40.0 + 0.3 * lon - 0.4 * lat
    assert np.allclose(dem.z_m, z_m - expected_m, rtol=0.0, atol=0.002)
    least, most = expected_m.min(), expected_m.max()
    assert dem.heights.converted == f"EGM96 height ({least:+.1f} to {most:+.1f} m taken off)"
    assert f"{least:+.1f}" != f"{most:+.1f}"
    assert dem.heights.altitude_sigma_m == 0.0


def test_the_newer_geoid_is_taken_where_both_are_installed(write_raster, geoid):
    geoid(lambda lon, _: np.full(lon.shape, -33.5))
    geoid(lambda lon, _: np.full(lon.shape, -34.5), "egm08_25.gtx")
    dem = load_dem([write_raster(HILLS, crs=ELLIPSOIDAL, transform=GRID)])
    assert np.allclose(dem.z_m, HILLS + 34.5, atol=0.001)
    assert "EGM2008" in dem.heights.converted


def test_heights_above_the_sea_stay_as_they_are_whatever_geoid_is_installed(write_raster, geoid):
    geoid(lambda lon, _: np.full(lon.shape, -33.5))
    dem = load_dem([write_raster(HILLS, crs="EPSG:26911+5703", transform=GRID)])
    assert np.array_equal(dem.z_m, HILLS)
    assert dem.heights.converted is None


@pytest.mark.parametrize(
    ("undulation_m", "slope"),
    [
        (121.0, 0.0),
        (-121.0, 0.0),
        (120.0, 30.0),
    ],  # the last one: at the middle of the DEM, so half of it is too high
)
def test_a_geoid_grid_that_no_place_has_is_not_used(write_raster, geoid, undulation_m, slope):
    to_lonlat = pyproj.Transformer.from_crs(32611, 4326, always_xy=True)
    middle, _ = to_lonlat.transform(400_750.0, 3_799_400.0)
    geoid(lambda lon, _: undulation_m + slope * (lon - middle))
    dem = load_dem([write_raster(HILLS, crs=ELLIPSOIDAL, transform=GRID)])
    assert np.array_equal(dem.z_m, HILLS)
    assert dem.heights.converted is None


def test_files_of_different_vertical_datums_are_not_put_together(write_raster):
    sea = write_raster(HILLS, "sea.tif", crs="EPSG:32611", transform=GRID)
    space = write_raster(HILLS, "space.tif", crs=ELLIPSOIDAL, transform=GRID @ Affine.translation(50, 0))
    with pytest.raises(DemError, match="ellipsoid"):
        load_dem([sea, space])


# ---- what is said of an answer


DEM = dem_from_array(HILLS, GRID, CRS.from_epsg(32611))


def observation(altitude_m: float | None = 1000.0, sigma_m: float = 5.0) -> Observation:
    frame = SimpleNamespace(label="N", u_px=np.arange(50.0))
    return Observation((frame,), 2.0, altitude_m, sigma_m, 1.0, 0.02)  # type: ignore[arg-type]


def a_fix(status: str = "fix", altitude_bias_m: float = 0.0) -> Fix:
    return Fix(
        bundle="b",
        status=status,  # type: ignore[arg-type]
        position=None
        if status == "none"
        else Position(
            easting_m=400_300.0,
            northing_m=3_799_700.0,
            crs="EPSG:32611",
            lat_deg=34.3,
            lon_deg=-118.1,
            ground_m=520.0,
            row=10.0,
            col=10.0,
        ),
        covariance_m2=None if status == "none" else ((9.0, 0.0), (0.0, 9.0)),
        probability=0.99,
        candidates=(),
        stage1=Stage1Counts(cells=1, after_altitude=1, after={}, points_explored=1),
        residual={},
        nuisance=None
        if status == "none"
        else Nuisance(azimuth_bias_deg=0.0, tilt_bias_deg=0.0, altitude_bias_m=altitude_bias_m),
        timing_s={},
    )


def located(status: str, altitude_m: float = 959.0) -> Located:
    best = SimpleNamespace(row=20.0, col=20.0, altitude_m=altitude_m) if status != "none" else None
    return Located(SimpleNamespace(status=status), best, None, {})  # type: ignore[arg-type]


@pytest.mark.parametrize(("bias_m", "said"), [(41.0, True), (-41.0, True), (19.0, False), (0.0, False)])
def test_an_altitude_bias_beyond_four_sigmas_is_a_note(bias_m, said):
    bundle = SimpleNamespace(altitude=SimpleNamespace(value_m=1000.0, sigma_m=5.0))
    note = altitude_note(a_fix(altitude_bias_m=bias_m), bundle, DEM)  # type: ignore[arg-type]
    assert (note is not None) == said
    if said:
        assert f"{bias_m:+.0f} m" in note
        assert f"--geoid-offset {-bias_m:.0f}" in note


def test_no_altimeter_no_note():
    bundle = SimpleNamespace(altitude=None)
    assert altitude_note(a_fix(altitude_bias_m=0.0), bundle, DEM) is None  # type: ignore[arg-type]


def test_where_nothing_fits_the_altitude_is_left_out_once_and_what_that_shows_is_said():
    asked = []

    def search(blind: Observation) -> Located:
        asked.append(blind)
        return located("fix")

    terrain = SimpleNamespace(dem=DEM)
    fix = diagnose_altimeter(terrain, observation(), a_fix("none"), search)  # type: ignore[arg-type]
    assert fix.status == "none"
    assert fix.position is None
    assert fix.reason.code == "no_ground_at_altitude"
    assert "off by +41 m (8.2 sigma)" in fix.reason.text
    assert len(asked) == 1
    assert asked[0].altitude_m is None


def test_where_it_shows_nothing_either_that_is_said():
    terrain = SimpleNamespace(dem=DEM)
    fix = diagnose_altimeter(terrain, observation(), a_fix("none"), lambda _: located("none"))  # type: ignore[arg-type]
    assert fix.status == "none"
    assert fix.reason.code == "outside"


@pytest.mark.parametrize(
    ("fix", "seen"),
    [(a_fix("fix"), observation()), (a_fix("none"), observation(altitude_m=None, sigma_m=np.inf))],
)
def test_nothing_is_searched_again_with_a_place_or_without_an_altimeter(fix, seen):
    terrain = SimpleNamespace(dem=DEM)
    assert diagnose_altimeter(terrain, seen, fix, lambda _: pytest.fail("searched")) is fix  # type: ignore[arg-type]


def test_a_place_on_an_unknown_datum_is_no_fix():
    unknown = dem_from_array(HILLS, GRID, CRS.from_user_input("+proj=utm +zone=11 +ellps=clrk66 +type=crs"))
    fix = without_known_datum(a_fix(), unknown)
    assert fix.status == "ambiguous"
    assert fix.exit_status == 3
    assert fix.reason.code == "unknown_datum"
    assert "--crs" in fix.reason.text
    assert fix.position == a_fix().position
    assert without_known_datum(a_fix(), DEM) == a_fix()
    assert without_known_datum(a_fix("none"), unknown) == a_fix("none")
