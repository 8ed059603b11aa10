import cv2
import numpy as np
import pytest
from affine import Affine
from pyproj import CRS

from localizer.dem.geodesy import rowcol_to_lonlat, rowcol_to_metric
from localizer.dem.lattice import dem_from_array
from localizer.fix import Candidate, Fix, Position, Stage1Counts
from localizer.search.details import FrameDetail, LocateDetails, LocateResult
from localizer.show.plot import FOUND, draw_fix
from localizer.show.relief import hillshade
from localizer.truth import Truth

ROWS, COLS = 60, 80


def terrain(crs):
    rows, cols = np.mgrid[:ROWS, :COLS]
    z_m = 1200 + 300 * np.sin(rows / 9) * np.cos(cols / 7)
    z_m[:4, :9] = np.nan
    transform = (
        Affine(1 / 3600, 0.0, -122.2, 0.0, -1 / 3600, 37.3)
        if crs == 4326
        else Affine(30.0, 0.0, 560_000.0, 0.0, -30.0, 5_120_000.0)
    )
    return dem_from_array(z_m, transform, CRS.from_epsg(crs))


def result_at(dem, status, row, col, labels):
    easting_m, northing_m = (float(value) for value in rowcol_to_metric(dem, row, col))
    lon_deg, lat_deg = (float(value) for value in rowcol_to_lonlat(dem, row, col))
    here = Candidate(easting_m=easting_m, northing_m=northing_m, probability=0.6, rms_px=0.8)
    there = Candidate(easting_m=easting_m + 500.0, northing_m=northing_m, probability=0.4, rms_px=0.9)
    placed = status != "none"
    fix = Fix(
        bundle="b",
        status=status,
        position=Position(
            easting_m=easting_m,
            northing_m=northing_m,
            crs=dem.metric_crs.to_string(),
            lat_deg=lat_deg,
            lon_deg=lon_deg,
            ground_m=float(dem.ground_m(row, col)),
            row=row,
            col=col,
        )
        if placed
        else None,
        covariance_m2=((25.0, 8.0), (8.0, 9.0)) if placed else None,
        probability=0.6 if placed else 0.0,
        candidates={"fix": (here,), "ambiguous": (here, there), "none": ()}[status],
        stage1=Stage1Counts(cells=4800, after_altitude=300, after={"N": 3}, points_explored=1),
        residual=dict.fromkeys(labels, 0.5) if placed else {},
        nuisance=None,
        timing_s={},
    )
    u_px = np.arange(64.0)
    predicted = u_px if placed else np.zeros(0)
    frames = tuple(
        FrameDetail(
            label,
            u_px,
            20 + 5 * np.sin(u_px / 9),
            u_px % 16 < 13,
            predicted,
            20 + 5 * np.sin(predicted / 9.2),
        )
        for label in labels
    )
    around = np.argwhere(np.ones((ROWS, COLS)))
    far = np.hypot(around[:, 0] - row, around[:, 1] - col)
    survivors = {"altitude": around[far < 12]} | {
        label: around[far < 9 / (i + 1)] for i, label in enumerate(labels)
    }
    return LocateResult(
        fix,
        LocateDetails(frames, survivors, np.array([[row, col]]), np.array([[[25.0, 8.0], [8.0, 9.0]]]), None),
    )


@pytest.mark.parametrize(
    ("crs", "status", "labels"),
    [(4326, "fix", "NESW"), (32610, "fix", "N"), (32610, "ambiguous", "ABCDEFG"), (4326, "none", "NE")],
)
def test_the_picture_is_drawn_for_any_number_of_frames_and_any_outcome(tmp_path, crs, status, labels):
    dem = terrain(crs)
    result = result_at(dem, status, 30.3, 44.8, labels)
    images = {label: np.full((48, 64, 3), 90, np.uint8) for label in labels}
    easting_m, northing_m = (float(value) for value in rowcol_to_metric(dem, 30.5, 44.6))
    truth = Truth(easting_m=easting_m, northing_m=northing_m, crs=dem.metric_crs.to_string())
    path = tmp_path / "fix.png"
    draw_fix(path, images, result, dem, truth)
    picture = cv2.imread(str(path))
    assert picture.shape[0] > 700
    red, green, blue = (int(FOUND[i : i + 2], 16) for i in (1, 3, 5))
    assert (picture == [blue, green, red]).all(axis=2).sum() > 200


def test_without_a_truth_and_without_survivors_there_is_still_a_picture(tmp_path):
    dem = terrain(32610)
    result = result_at(dem, "none", 30.0, 40.0, "N")
    nothing = {name: np.zeros((0, 2), np.int64) for name in ("altitude", "N")}
    details = LocateDetails(result.details.frames, nothing, np.zeros((0, 2)), np.zeros((0, 2, 2)), None)
    path = tmp_path / "none.svg"
    draw_fix(path, {"N": np.zeros((48, 64, 3), np.uint8)}, LocateResult(result.fix, details), dem)
    assert "<svg" in path.read_text()


def test_slopes_towards_the_north_west_are_bright():
    rows, cols = np.mgrid[:20, :20]
    facing_north_west = hillshade(10.0 * (rows + cols), 30.0)  # rises to the south-east
    facing_south_east = hillshade(-10.0 * (rows + cols), 30.0)
    flat = hillshade(np.zeros((20, 20)), 30.0)
    inner = (slice(2, -2), slice(2, -2))
    assert facing_north_west[inner].min() > flat.max() > facing_south_east[inner].max()
    assert np.allclose(flat, np.sqrt(0.5))
