"""What lies beside a report's page opens in GDAL and says what the fix says."""

import json
import re
from html.parser import HTMLParser

import numpy as np
import pyogrio
import pytest
import rasterio
from affine import Affine
from fakes.results import a_result
from pyproj import CRS, Geod
from rasterio.warp import transform as warp

from localizer.bundle import load_bundle
from localizer.dem.geodesy import rowcol_to_metric
from localizer.dem.lattice import dem_from_array
from localizer.errors import SkyfixError
from localizer.search.details import LocateResult
from localizer.show.candidates import places
from localizer.show.posterior import NODATA, posterior
from localizer.show.report_folder import files_beside, prepare_folder, write_report

ROWS, COLS = 60, 80
GEOGRAPHIC = Affine(1 / 3600, 0.0, -122.2, 0.0, -1 / 3600, 37.3)
PROJECTED = Affine(30.0, 0.0, 560_000.0, 0.0, -30.0, 5_120_000.0)
ACROSS_THE_DATE_LINE = Affine(1 / 3600, 0.0, 180.0 - 40.5 / 3600, 0.0, -1 / 3600, -16.8)
VECTORS = ("candidates.geojson", "fix.gpx", "fix.kml")


def terrain(crs=4326, transform=GEOGRAPHIC):
    rows, cols = np.mgrid[:ROWS, :COLS]
    z_m = 1200 + 300 * np.sin(rows / 9) * np.cos(cols / 7)
    z_m[:4, :9] = np.nan
    return dem_from_array(z_m, transform, CRS.from_epsg(crs))


@pytest.fixture
def exported(bundle_dir, tmp_path):
    """Writes the report of a result and returns its folder."""
    bundle = load_bundle(bundle_dir)
    images = {frame.label: np.full((12, 16, 3), 90, np.uint8) for frame in bundle.frames}

    def exported(dem, result, folder=tmp_path / "report"):
        if not folder.is_dir():  # else one that something happened to after it was prepared
            prepare_folder(folder)
        write_report(folder, bundle, images, result, dem)
        return folder

    return exported


@pytest.fixture
def beside(bundle_dir, tmp_path):
    """Writes all but the page, which takes a while to draw, and returns the folder."""

    def beside(dem, result):
        found = places(result, dem)
        files = files_beside(found, posterior(found, dem), load_bundle(bundle_dir), result, dem)
        for name, content in files.items():
            (tmp_path / name).write_bytes(content)
        return tmp_path

    return beside


FIX = [(30.3, 44.8, 0.9995)]
SEVERAL = [(30.3, 44.8, 0.6), (12.0, 20.0, 0.3), (50.1, 60.2, 0.1)]


@pytest.mark.parametrize(("crs", "transform"), [(4326, GEOGRAPHIC), (32610, PROJECTED)])
def test_every_point_file_opens_in_gdal_at_the_fix(beside, crs, transform):
    dem = terrain(crs, transform)
    result = a_result(dem, FIX)
    folder = beside(dem, result)
    position = result.fix.position
    for name in VECTORS:
        table = pyogrio.raw.read(folder / name, layer="waypoints" if name.endswith("gpx") else None)
        lon_deg, lat_deg = point_of(table[2][0])
        assert Geod(ellps="WGS84").inv(lon_deg, lat_deg, position.lon_deg, position.lat_deg)[2] < 0.02, name
        assert CRS.from_user_input(table[0]["crs"]) == CRS.from_epsg(4326)


def point_of(wkb):
    """Longitude and latitude of a point in well-known binary, 2D or 3D."""
    return np.frombuffer(wkb, "<f8", count=2, offset=5)


def test_a_waypoint_tells_time_name_status_and_sigma(beside):
    dem = terrain()
    folder = beside(dem, a_result(dem, FIX))
    meta, _, _, values = pyogrio.raw.read(folder / "fix.gpx", layer="waypoints")
    waypoint = {name: column[0] for name, column in zip(meta["fields"], values, strict=True)}
    assert waypoint["name"] == "fix 20261123T043151Z-3f9a"
    assert str(waypoint["time"]).startswith("2026-11-23T04:31:51")
    assert waypoint["ele"] == pytest.approx(float(dem.ground_m(30.3, 44.8)), abs=0.1)
    assert "status fix; 1 sigma 5.3 m x 2.4 m" in waypoint["desc"]
    kml = (folder / "fix.kml").read_text()
    assert "<when>2026-11-23T04:31:51Z</when>" in kml
    assert "status fix; 1 sigma 5.3 m x 2.4 m" in kml


def test_no_name_of_an_ambiguous_place_says_fix(beside):
    dem = terrain()
    folder = beside(dem, a_result(dem, SEVERAL))
    meta, _, _, values = pyogrio.raw.read(folder / "fix.gpx", layer="waypoints")
    names = values[list(meta["fields"]).index("name")]
    assert list(names) == [f"candidate {i} of 3 (ambiguous) 20261123T043151Z-3f9a" for i in (1, 2, 3)]
    assert (folder / "fix.kml").read_text().count("<name>candidate") == 3


def test_geojson_has_each_candidate_and_the_ellipse_that_holds_95_percent(beside):
    dem = terrain(32610, PROJECTED)
    folder = beside(dem, a_result(dem, SEVERAL))
    features = json.loads((folder / "candidates.geojson").read_text())["features"]
    points = [f for f in features if f["geometry"]["type"] == "Point"]
    rings = [f for f in features if f["geometry"]["type"] == "Polygon"]
    assert [f["properties"]["rank"] for f in points] == [f["properties"]["rank"] for f in rings] == [1, 2, 3]
    assert [f["properties"]["probability"] for f in points] == [0.6, 0.3, 0.1]
    assert (
        features[0]["properties"]
        | {
            "status": "ambiguous",
            "rms_px": 0.8,
            "time": "2026-11-23T04:31:51Z",
        }
        == (features[0]["properties"])
    )
    ring = np.array(rings[0]["geometry"]["coordinates"][0])
    assert (ring[0] == ring[-1]).all()
    assert signed_area(ring) > 0.0  # right-hand rule: counter-clockwise
    easting_m, northing_m = np.array(warp("EPSG:4326", "EPSG:32610", *ring.T))
    centre_m = rowcol_to_metric(dem, 30.3, 44.8)
    off_m = np.array([easting_m - centre_m[0], northing_m - centre_m[1]])
    chi2 = (off_m * np.linalg.solve([[25.0, 8.0], [8.0, 9.0]], off_m)).sum(axis=0)
    assert chi2 == pytest.approx(5.991, rel=0.02)


def signed_area(ring):
    x, y = ring.T
    return 0.5 * float((x[:-1] * y[1:] - x[1:] * y[:-1]).sum())


def test_an_ellipse_across_the_date_line_is_cut_in_two(beside):
    dem = terrain(4326, ACROSS_THE_DATE_LINE)
    folder = beside(dem, a_result(dem, [(30.0, 39.9, 0.999)]))
    geometry = json.loads((folder / "candidates.geojson").read_text())["features"][1]["geometry"]
    assert geometry["type"] == "MultiPolygon"
    for (ring,) in geometry["coordinates"]:
        lon_deg = np.array(ring)[:, 0]
        assert (np.abs(lon_deg) <= 180.0).all()
        assert np.ptp(lon_deg) < 0.001
        assert signed_area(np.array(ring)) > 0.0


def test_the_posterior_adds_up_to_one_around_the_fix_on_the_dem_s_grid(beside):
    dem = terrain()
    folder = beside(dem, a_result(dem, FIX, covariance_m2=((900.0, 300.0), (300.0, 2500.0))))
    with rasterio.open(folder / "posterior.tif") as raster:
        assert (raster.dtypes, raster.nodata, raster.crs.to_epsg()) == (("float32",), NODATA, 4326)
        probability = raster.read(1).astype(float)
        col, row = ~dem.transform @ (raster.transform.c, raster.transform.f)
        assert (row, col) == pytest.approx((round(row), round(col)), abs=1e-6)
        assert (raster.transform.a, raster.transform.e) == (dem.transform.a, dem.transform.e)
        rows, cols = np.mgrid[: raster.height, : raster.width]
        x, y = raster.transform @ (cols + 0.5, rows + 0.5)
    assert probability.sum() == pytest.approx(0.9995, abs=1e-4)
    easting_m, northing_m = (
        np.reshape(v, x.shape) for v in warp(dem.crs, dem.metric_crs, x.ravel(), y.ravel())
    )
    centre_m = [float((v * probability).sum() / probability.sum()) for v in (easting_m, northing_m)]
    assert centre_m == pytest.approx([float(v) for v in rowcol_to_metric(dem, 30.3, 44.8)], abs=0.5)
    east_m, north_m = easting_m - centre_m[0], northing_m - centre_m[1]
    moments = [(probability * v).sum() / probability.sum() for v in (east_m**2, east_m * north_m, north_m**2)]
    # a cell spreads its probability over its own breadth, 24.7 m by 30.9 m
    assert moments == pytest.approx([900 + 24.7**2 / 12, 300, 2500 + 30.9**2 / 12], rel=0.03)


@pytest.mark.parametrize("sigma_m", [0.01, 0.5, 5.0, 60.0])
def test_no_probability_is_lost_however_small_or_large_the_ellipse(sigma_m):
    dem = terrain(32610, PROJECTED)
    result = a_result(dem, FIX, covariance_m2=((sigma_m**2, 0.0), (0.0, (sigma_m / 30) ** 2)))
    assert posterior(places(result, dem), dem).total == pytest.approx(0.9995, abs=1e-4)


def test_every_candidate_has_its_share_of_the_posterior():
    dem = terrain(32610, PROJECTED)
    spread = posterior(places(a_result(dem, SEVERAL), dem), dem)
    for row, col, share in SEVERAL:
        r, c = round(row) - spread.first_row, round(col) - spread.first_col
        assert spread.probability[r - 2 : r + 3, c - 2 : c + 3].sum() == pytest.approx(share, abs=1e-3)


def test_what_reaches_beyond_the_dem_is_lost_and_voids_are_nodata():
    dem = terrain(32610, PROJECTED)
    result = a_result(dem, [(-0.5, 40.0, 1.0)], "ambiguous", ((400.0, 0.0), (0.0, 400.0)))
    assert posterior(places(result, dem), dem).total == pytest.approx(0.5, abs=0.02)
    beyond = posterior(places(a_result(dem, [(-40.0, 40.0, 1.0)], "ambiguous"), dem), dem)
    assert beyond.total == 0.0
    beside_voids = posterior(places(a_result(dem, [(9.0, 9.0, 1.0)]), dem), dem)
    void = np.isnan(dem.z_m[beside_voids.first_row :, beside_voids.first_col :])
    rows, cols = beside_voids.probability.shape
    assert ((beside_voids.probability == NODATA) == void[:rows, :cols]).all()


def names_in(folder):
    return sorted(path.name for path in folder.iterdir())


def test_without_a_place_only_the_page_is_written_and_old_points_are_removed(exported):
    dem = terrain()
    folder = exported(dem, a_result(dem, FIX))
    assert names_in(folder) == sorted([*VECTORS, "posterior.tif", "report.html"])
    assert exported(dem, a_result(dem, [])) == folder
    assert names_in(folder) == ["report.html"]
    assert "There is no place to put on a map" in (folder / "report.html").read_text()


def test_a_folder_that_cannot_be_written_is_told_in_one_line(tmp_path):
    file = tmp_path / "file"
    file.write_text("")
    for folder in (file, file / "below"):
        with pytest.raises(SkyfixError, match=r"^--report: .*file"):
            prepare_folder(folder)


def test_a_folder_where_a_file_of_the_report_belongs_is_told_before_the_search(tmp_path):
    (tmp_path / "report.html").mkdir()
    with pytest.raises(SkyfixError, match=r"report\.html: is a folder where a file belongs"):
        prepare_folder(tmp_path)


def test_a_file_that_cannot_be_replaced_leaves_nothing_half_written(exported, tmp_path):
    dem = terrain()
    (tmp_path / "report" / "posterior.tif").mkdir(parents=True)
    with pytest.raises(SkyfixError, match=r"posterior.tif: Is a directory"):
        exported(dem, a_result(dem, FIX))
    assert names_in(tmp_path / "report") == ["posterior.tif"]


# ---- the page


class Parts(HTMLParser):
    """Text, and every address that the page refers to."""

    def __init__(self, html):
        super().__init__()
        self.text, self.addresses, self.open = "", [], []
        self.feed(html)

    def handle_starttag(self, tag, attributes):
        self.addresses += [value for name, value in attributes if name in ("src", "href", "srcset", "data")]
        if tag not in ("meta", "img"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] != "style":
            self.text += " " + data


@pytest.mark.parametrize("spots", [FIX, SEVERAL, []])
def test_the_page_stands_alone(exported, spots):
    dem = terrain()
    folder = exported(dem, a_result(dem, spots))
    html = (folder / "report.html").read_text()
    page = Parts(html)
    assert page.open == []
    beside = {address for address in page.addresses if not address.startswith("data:image/webp;base64,")}
    assert beside == ({*VECTORS, "posterior.tif"} if spots else set())
    assert len(page.addresses) - len(beside) == 2 + 2 + bool(spots)  # frames, maps, posterior
    for word in ("http:", "https:", "url(", "@import", "<script"):
        assert word not in html


def test_the_page_of_a_fix_says_where_how_sure_and_what_is_odd(exported):
    dem = terrain(32610, PROJECTED)
    result = a_result(dem, FIX)
    page = Parts((exported(dem, result) / "report.html").read_text())
    position = result.fix.position
    for fact in (
        f"{position.lat_deg:.5f}° N",
        "5.3 m x 2.4 m",
        "One place stands out",
        "4,764",
        "34,567",
        "+2.400°",
        "+4.8",  # of a compass that is good for 0.5°
        "4.5 m",
        "12.5 columns",
        "1432.6 m ± 5.0 m",
        "+0.050° (+0.5)",
        "0.070 s",
        "2026-11-23 04:31:51 UTC",
    ):
        assert fact in page.text, fact
    assert re.findall(
        r'<td class=" far">([^<]*)</td>', (exported(dem, result) / "report.html").read_text()
    ) == [
        "+4.8",
        "+0.100° (+5.0)",
        "+0.100° (+5.0)",
    ]


def test_the_page_of_an_ambiguous_result_shows_all_candidates_and_calls_none_a_fix(exported):
    dem = terrain()
    page = Parts((exported(dem, a_result(dem, SEVERAL)) / "report.html").read_text())
    assert "3 places fit" in page.text
    assert "All candidates" in page.text
    for _, _, probability in SEVERAL:
        assert f"{probability:.4f}" in page.text
    assert "the fix" not in page.text.lower().replace("the fix as skyfix.fix/1", "")


def test_words_of_a_bundle_are_not_taken_for_html(exported):
    dem = terrain()
    result = a_result(dem, FIX)
    spoilt = LocateResult(result.fix.model_copy(update={"bundle": "<script>&"}), result.details)
    html = (exported(dem, spoilt) / "report.html").read_text()
    assert "<script>" not in html
    assert "&lt;script&gt;&amp;" in html
