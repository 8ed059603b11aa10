"""What is drawn over the frames: the skyline found, and the terrain's where the answer puts the camera."""

import numpy as np
import pytest
from affine import Affine
from pyproj import CRS

from localizer.bundle import Altitude, Bundle, Camera, Frame
from localizer.camera import camera_to_world, project
from localizer.dem.geodesy import rowcol_to_metric
from localizer.dem.horizon import Terrain, horizon, prepare_terrain
from localizer.dem.lattice import dem_from_array
from localizer.fix import Fix, Nuisance, Position, Stage1Counts
from localizer.skyline.find import ColumnState, Skyline
from rig.daemon.search.skylines import BundleSkylines, bundle_skylines

ROW, COL, MAST_M = 40.3, 38.6, 2.0
TRUE_AZIMUTH_DEG, TRUE_TILT_DEG, ROLL_DEG = 30.0, 8.0, -2.0
AZIMUTH_BIAS_DEG, TILT_BIAS_DEG = 1.5, 0.4


@pytest.fixture(scope="module")
def terrain() -> Terrain:
    """A bowl with a wavy rim, 80 x 80 cells of 30 m."""
    row, col = np.mgrid[0:80, 0:80]
    off = np.hypot(row - 40, col - 40)
    z_m = 500.0 + 8.0 * off + 40.0 * np.sin(row / 5.0) * np.cos(col / 7.0) * (off > 15)
    return prepare_terrain(
        dem_from_array(z_m, Affine(30.0, 0.0, 560_000.0, 0.0, -30.0, 5_120_000.0), CRS("EPSG:32610"))
    )


@pytest.fixture(scope="module")
def camera() -> Camera:
    return Camera(width_px=320, height_px=240, fx_px=250.0, fy_px=250.0, cx_px=159.5, cy_px=119.5)


def skyline_from(terrain: Terrain, camera: Camera) -> Skyline:
    """As the terrain has it from the place, with a doubtful stretch and a gap."""
    altitude_m = float(terrain.dem.ground_m(ROW, COL)) + MAST_M
    azimuth_deg = TRUE_AZIMUTH_DEG + np.arange(-50.0, 50.0, 0.05)
    elevation_deg, _ = horizon(terrain, ROW, COL, altitude_m, azimuth_deg)
    u_px, v_px = project(
        camera, camera_to_world(TRUE_AZIMUTH_DEG, TRUE_TILT_DEG, ROLL_DEG), azimuth_deg, elevation_deg[0]
    )
    row_px = np.interp(np.arange(camera.width_px), u_px, v_px)
    state = np.full(camera.width_px, ColumnState.OK, np.uint8)
    confidence = np.ones(camera.width_px)
    confidence[100:140] = 0.2
    row_px[200:220], state[200:220], confidence[200:220] = np.nan, ColumnState.NO_SKY, 0.0
    return Skyline(row_px, np.full(camera.width_px, 0.3), confidence, state)


def bundle_of(terrain: Terrain, camera: Camera, altitude_bias_m: float | None) -> Bundle:
    true_m = float(terrain.dem.ground_m(ROW, COL)) + MAST_M
    frame = Frame(
        label="NNE",
        file="frames/NNE.png",
        sha256="0" * 64,
        time="2026-11-23T04:31:40Z",
        azimuth_deg=TRUE_AZIMUTH_DEG + AZIMUTH_BIAS_DEG,
        azimuth_sigma_deg=0.1,
        tilt_deg=TRUE_TILT_DEG + TILT_BIAS_DEG,
        tilt_sigma_deg=0.01,
        roll_deg=ROLL_DEG,
        roll_sigma_deg=0.02,
    )
    return Bundle(
        id="20261123T043151Z-3f9a",
        created="2026-11-23T04:31:51Z",
        camera=camera,
        mast_height_m=MAST_M,
        altitude=None
        if altitude_bias_m is None
        else Altitude(value_m=true_m + altitude_bias_m, sigma_m=20.0),
        azimuth_bias_sigma_deg=1.0,
        tilt_bias_sigma_deg=0.5,
        frames=(frame,),
    )


def fix_at(terrain: Terrain, altitude_bias_m: float) -> Fix:
    easting_m, northing_m = rowcol_to_metric(terrain.dem, ROW, COL)
    position = Position(
        easting_m=float(easting_m),
        northing_m=float(northing_m),
        crs="EPSG:32610",
        lat_deg=46.2,
        lon_deg=-122.2,
        ground_m=float(terrain.dem.ground_m(ROW, COL)),
        row=ROW,
        col=COL,
    )
    return Fix(
        bundle="20261123T043151Z-3f9a",
        status="fix",
        position=position,
        covariance_m2=((9.0, 0.0), (0.0, 9.0)),
        probability=0.999,
        candidates=(),
        stage1=Stage1Counts(cells=6400, after_altitude=100, after={"NNE": 3}, points_explored=10),
        residual={"NNE": 0.5},
        nuisance=Nuisance(
            azimuth_bias_deg=AZIMUTH_BIAS_DEG, tilt_bias_deg=TILT_BIAS_DEG, altitude_bias_m=altitude_bias_m
        ),
        timing_s={},
    )


@pytest.mark.parametrize("altitude_bias_m", [None, -15.0])
def test_the_prediction_lies_on_the_skyline_once_the_solved_errors_are_taken_off(
    terrain: Terrain, camera: Camera, altitude_bias_m: float | None
) -> None:
    bundle = bundle_of(terrain, camera, altitude_bias_m)
    fix = fix_at(terrain, altitude_bias_m or 0.0)
    (frame,) = bundle_skylines(bundle, [skyline_from(terrain, camera)], fix, terrain).frames

    found = np.array([point for line in frame.found for point in line])
    predicted = np.array([point for line in frame.predicted for point in line])
    off_px = np.interp(found[:, 0], predicted[:, 0], predicted[:, 1]) - found[:, 1]
    assert np.abs(off_px).max() < 0.5
    assert predicted[0, 0] < 3.0
    assert predicted[-1, 0] > camera.width_px - 4.0


def test_lines_break_where_there_is_no_skyline_and_doubtful_stretches_are_apart(
    terrain: Terrain, camera: Camera
) -> None:
    skyline = skyline_from(terrain, camera)
    (frame,) = bundle_skylines(
        bundle_of(terrain, camera, None), [skyline], fix_at(terrain, 0.0), terrain
    ).frames

    def ends(line: tuple[tuple[float, float], ...]) -> tuple[float, float]:
        return line[0][0], line[-1][0]

    assert [ends(line) for line in frame.found] == [(0.0, 99.0), (140.0, 199.0), (220.0, 319.0)]
    assert [ends(line) for line in frame.doubtful] == [(100.0, 139.0)]


def test_an_answer_without_a_place_predicts_nothing(terrain: Terrain, camera: Camera) -> None:
    nowhere = fix_at(terrain, 0.0).model_copy(
        update={"status": "none", "position": None, "covariance_m2": None, "nuisance": None}
    )
    skylines = bundle_skylines(
        bundle_of(terrain, camera, None), [skyline_from(terrain, camera)], nowhere, terrain
    )
    assert skylines.frames[0].predicted == ()
    assert BundleSkylines.model_validate_json(skylines.model_dump_json()) == skylines
