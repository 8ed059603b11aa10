"""Which way leads from a CRS to WGS84, how good it is, and what is done where there is none."""

import json
import math
import os
import subprocess
import sys

import numpy as np
import pytest
from affine import Affine
from pyproj import CRS, Geod, Transformer

from localizer.dem.crs import geographic_crs
from localizer.dem.datum import datum_shift, unknown_datum_note
from localizer.dem.geodesy import (
    geodesic_end,
    geodesic_expansion,
    lonlat_to_rowcol,
    meridian_convergence_deg,
    metric_to_lonlat,
    metric_to_rowcol,
    rowcol_to_lonlat,
    rowcol_to_metric,
)
from localizer.dem.lattice import DemError, dem_from_array, load_dem

FLAT = np.ones((60, 60), np.float32)
WGS84 = Geod(ellps="WGS84")
ESRI_CLARKE = (
    'PROJCS["NAD_1927_UTM_Zone_11N",GEOGCS["GCS_Clarke_1866",DATUM["D_Clarke_1866",'
    'SPHEROID["Clarke_1866",6378206.4,294.9786982]],PRIMEM["Greenwich",0.0],UNIT["Degree",0.0174532925199433]],'
    'PROJECTION["Transverse_Mercator"],PARAMETER["False_Easting",500000.0],PARAMETER["False_Northing",0.0],'
    'PARAMETER["Central_Meridian",-117.0],PARAMETER["Scale_Factor",0.9996],PARAMETER["Latitude_Of_Origin",0.0],'
    'UNIT["Meter",1.0]]'
)
ARC_INFO = "Projection UTM\nZone 11\nDatum NONE\nSpheroid CLARKE1866\nUnits METERS\nXshift 0.0\nYshift 0.0\nParameters\n"
UTM_11 = Affine(30.0, 0.0, 400_000.0, 0.0, -30.0, 3_800_000.0)


def shift_at(crs: str, lon_deg: float, lat_deg: float):
    system = CRS.from_user_input(crs)
    lon, lat = np.array([lon_deg - 0.05, lon_deg + 0.05]), np.array([lat_deg - 0.05, lat_deg + 0.05])
    x, y = Transformer.from_crs(4326, system, always_xy=True).transform(lon, lat)
    return datum_shift(system, x, y)


@pytest.mark.parametrize(
    ("crs", "place"),
    [
        ("EPSG:4214", (103.5, 30.5)),  # Beijing 1954, in Sichuan
        ("EPSG:4144", (91.0, 28.0)),  # Kalianpur 1937
        ("EPSG:4147", (104.0, 21.5)),  # Hanoi 1972, inland
        ("EPSG:4610", (103.5, 30.5)),  # Xian 1980
        ("EPSG:4206", (9.0, 17.0)),  # Agadez
        ("EPSG:4215", (4.5, 50.5)),  # Belge 1950
        ("EPSG:4306", (7.5, 46.9)),  # Bern 1938
        ("EPSG:4308", (15.0, 62.0)),  # RT38
        ("EPSG:4174", (-11.8, 8.4)),  # Sierra Leone 1924
        ("EPSG:4738", (114.1, 22.4)),  # Hong Kong 1963
        ("EPSG:4671", (3.0, 36.0)),  # Voirol 1879
        ("EPSG:4128", (36.0, -16.0)),  # Madzansua
        ("EPSG:2391", (24.0, 60.0)),  # KKJ has one; a projected system of it in the wrong place has none
        ("+proj=utm +zone=11 +ellps=clrk66 +type=crs", (-118.0, 34.3)),
        ("+proj=longlat +ellps=bessel +type=crs", (10.0, 47.0)),
        ("+proj=utm +zone=33 +ellps=intl +type=crs", (15.0, 47.0)),
        ("+proj=utm +zone=33 +ellps=GRS80 +type=crs", (15.0, 47.0)),
        ("+proj=longlat +R=6371000 +type=crs", (15.0, 47.0)),
        (ESRI_CLARKE, (-118.0, 34.3)),
    ],
)
def test_where_only_a_ballpark_operation_is_left_the_datum_is_not_known(crs, place):
    if crs == "EPSG:2391":
        place = (-118.0, 34.3)
    shift = shift_at(crs, *place)
    assert not shift.known
    note = unknown_datum_note(CRS.from_user_input(crs), shift)
    assert "--crs" in note
    assert "\n" not in note


@pytest.mark.parametrize(
    ("crs", "place", "accuracy_m"),
    [
        ("EPSG:4267", (-118.2, 34.3), 7.0),  # NAD27
        ("EPSG:26710", (-122.2, 46.2), 7.0),
        ("EPSG:4269", (-118.2, 34.3), 4.0),  # NAD83
        ("EPSG:4258", (10.0, 47.0), 1.0),  # ETRS89
        ("EPSG:21781", (8.0, 46.5), 1.5),
        ("EPSG:4301", (138.5, 36.0), 9.0),  # Tokyo
        ("EPSG:4326", (8.0, 46.5), 0.0),
        ("EPSG:32611", (-118.2, 34.3), 0.0),
        ("EPSG:3857", (15.0, 68.3), 0.0),
        ("EPSG:4807", (5.0, 45.0), 2.0),  # in grads from Paris
        ("EPSG:4813", (110.0, -7.0), 6.0),  # from Jakarta: the place is looked for where it lies
        ("+proj=utm +zone=11 +ellps=clrk66 +towgs84=-8,160,176 +type=crs", (-118.2, 34.3), 5.0),
        ("+proj=tmerc +lon_0=15 +ellps=WGS84 +type=crs", (15.0, 47.0), 3.0),
    ],
)
def test_the_operation_s_own_accuracy_is_kept(crs, place, accuracy_m):
    shift = shift_at(crs, *place)
    assert shift.known
    assert shift.accuracy_m == pytest.approx(accuracy_m)


def test_nad27_moves_a_place_by_what_its_operation_says():
    """Helmert (-8, 159, 175), "NAD27 to WGS 84 (6)", as EPSG 15851's neighbours have it."""
    dem = dem_from_array(FLAT, Affine(0.0003, 0.0, -118.0, 0.0, -0.0003, 34.3), CRS.from_epsg(4267))
    lon_deg, lat_deg = rowcol_to_lonlat(dem, 30.0, 30.0)
    own_lon, own_lat = -118.0 + 0.0003 * 30.5, 34.3 - 0.0003 * 30.5
    _, _, moved_m = WGS84.inv(own_lon, own_lat, float(lon_deg), float(lat_deg))
    assert 75.0 < moved_m < 95.0
    back = lonlat_to_rowcol(dem, lon_deg, lat_deg)
    assert [float(v) for v in back] == pytest.approx([30.0, 30.0], abs=1e-4)
    east, north = rowcol_to_metric(dem, 30.0, 30.0)
    assert [float(v) for v in metric_to_rowcol(dem, east, north)] == pytest.approx([30.0, 30.0], abs=1e-4)
    assert [float(v) for v in metric_to_lonlat(dem, east, north)] == pytest.approx(
        [float(lon_deg), float(lat_deg)], abs=1e-9
    )


def test_a_geographic_dem_s_eastings_are_as_uncertain_as_the_way_to_wgs84():
    geographic = dem_from_array(FLAT, Affine(0.0003, 0.0, -118.0, 0.0, -0.0003, 34.3), CRS.from_epsg(4267))
    projected = dem_from_array(FLAT, UTM_11, CRS.from_epsg(26711))
    assert geographic.metric_accuracy_m == 7.0
    assert projected.metric_accuracy_m == 0.0
    assert projected.lonlat_accuracy_m == 7.0
    assert geographic.lonlat_accuracy_m == 0.0  # said already


def test_the_prj_files_that_arc_info_and_arcgis_wrote_without_a_datum(tmp_path, run):
    grid = "ncols 5\nnrows 5\nxllcorner 400000\nyllcorner 3800000\ncellsize 30\n" + "\n".join(
        ["1 2 3 4 5"] * 5
    )
    for name, projection in (("arcgis", ESRI_CLARKE), ("arcinfo", ARC_INFO)):
        (tmp_path / f"{name}.asc").write_text(grid)
        (tmp_path / f"{name}.prj").write_text(projection)
        status, out, _ = run("dem", "info", tmp_path / f"{name}.asc")
        assert status == 0
        assert "datum         not known" in out
        assert "Clarke 1866" in out
    _, out, _ = run("dem", "info", tmp_path / "arcgis.asc", "--crs", "EPSG:26711")
    assert "NAD27 to WGS 84" in out
    assert "good to 7 m" in out
    assert "not known" not in out


def test_predict_says_that_the_place_may_lie_elsewhere_in_an_unknown_datum(write_raster, run):
    z = (100.0 + np.add.outer(np.arange(80.0), np.arange(80.0))).astype(np.float32)
    path = write_raster(z, crs="+proj=utm +zone=10 +ellps=clrk66 +units=m")
    lon, lat = Transformer.from_crs(
        CRS.from_user_input("+proj=utm +zone=10 +ellps=clrk66 +type=crs"), 4326, always_xy=True
    ).transform(561_200.0, 5_118_800.0)
    status, _, err = run("predict", "--dem", path, "--at", f"{lat:.6f},{lon:.6f}", "--azimuth", "90")
    assert status == 0
    assert "datum of the elevation model is not known" in err


def test_two_files_of_different_unknown_datums_are_not_put_together(write_raster):
    first = write_raster(FLAT, "a.tif", crs="+proj=utm +zone=10 +ellps=clrk66 +units=m")
    second = write_raster(
        FLAT,
        "b.tif",
        crs="+proj=utm +zone=10 +ellps=intl +units=m",
        transform=Affine(30, 0, 561_800, 0, -30, 5_120_000),
    )
    with pytest.raises(DemError, match="CRS differ"):
        load_dem([first, second])


def test_proj_asks_no_network_whatever_the_environment_says():
    code = (
        "import localizer.dem.crs, threading; from pyproj import network; seen = [network.is_network_enabled()];"
        "t = threading.Thread(target=lambda: seen.append(network.is_network_enabled())); t.start(); t.join(); print(seen)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | {"PROJ_NETWORK": "ON"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.strip() == "[False, False]"


# ---- derived systems


ROTATED = "+proj=ob_tran +o_proj=longlat +o_lon_p=0 +o_lat_p=39.25 +lon_0=18 +datum=WGS84 +type=crs"  # COSMO's, over the Alps


def goes_north(dem, distance_m=1000.0):
    """Azimuth and length of what the lattice takes for so many metres to true north."""
    row, col = (dem.rows - 1) / 2, (dem.cols - 1) / 2
    lon, lat = (float(v) for v in rowcol_to_lonlat(dem, row, col))
    to_lon, to_lat = rowcol_to_lonlat(
        dem, *geodesic_end(geodesic_expansion(dem).at(row, col)[0], row, col, 0.0, distance_m)
    )
    azimuth_deg, _, length_m = WGS84.inv(lon, lat, float(to_lon), float(to_lat))
    return azimuth_deg, length_m


def test_a_rotated_pole_s_north_is_not_taken_for_true_north():
    rotated = CRS.from_user_input(ROTATED)
    x, y = Transformer.from_crs(4326, rotated, always_xy=True).transform(8.0, 46.5)
    dem = dem_from_array(FLAT, Affine(0.0003, 0.0, x - 0.009, 0.0, -0.0003, y + 0.009), rotated)
    assert "Derived" not in geographic_crs(rotated).type_name
    # UTM zone 32 (9 E) at 8 E, 46.5 N: sin(46.5) * -1
    assert float(meridian_convergence_deg(dem, 29.5, 29.5)) == pytest.approx(
        -math.sin(math.radians(46.5)), abs=0.01
    )
    azimuth_deg, length_m = goes_north(dem)
    assert azimuth_deg == pytest.approx(0.0, abs=1e-4)
    assert length_m == pytest.approx(1000.0, abs=0.01)


def test_a_derived_projected_system_goes_by_true_north_too():
    wkt = CRS.from_epsg(32632).to_wkt("WKT2_2019").replace("PROJCRS[", "BASEPROJCRS[", 1)
    base = wkt[: wkt.index("CS[Cartesian")].rstrip().rstrip(",")
    derived = CRS.from_wkt(
        f'DERIVEDPROJCRS["site",{base}],DERIVINGCONVERSION["turned",METHOD["Affine parametric transformation",ID["EPSG",9624]],'
        'PARAMETER["A0",1000,LENGTHUNIT["metre",1],ID["EPSG",8623]],PARAMETER["A1",0.8,SCALEUNIT["unity",1],ID["EPSG",8624]],'
        'PARAMETER["A2",0.6,SCALEUNIT["unity",1],ID["EPSG",8625]],PARAMETER["B0",2000,LENGTHUNIT["metre",1],ID["EPSG",8639]],'
        'PARAMETER["B1",-0.6,SCALEUNIT["unity",1],ID["EPSG",8640]],PARAMETER["B2",0.8,SCALEUNIT["unity",1],ID["EPSG",8641]]],'
        'CS[Cartesian,2],AXIS["x",east],AXIS["y",north],LENGTHUNIT["metre",1]]'
    )
    assert derived.type_name == "Derived Projected CRS"
    x, y = Transformer.from_crs(4326, derived, always_xy=True).transform(9.0, 46.5)
    dem = dem_from_array(FLAT, Affine(30.0, 0.0, x - 900, 0.0, -30.0, y + 900), derived)
    azimuth_deg, length_m = goes_north(dem)
    assert azimuth_deg == pytest.approx(0.0, abs=1e-3)
    assert length_m == pytest.approx(1000.0, abs=0.5)
    # on the central meridian of the zone the turn is all of the convergence
    assert abs(float(meridian_convergence_deg(dem, 29.5, 29.5))) == pytest.approx(36.87, abs=0.05)


@pytest.mark.parametrize("code", [2193, 3035, 31467, 5514, 27700])
def test_axes_in_another_order_do_not_turn_the_grid(code):
    crs = CRS.from_epsg(code)
    area = crs.area_of_use
    lon, lat = (
        (172.0, -43.0) if code == 2193 else ((area.west + area.east) / 2, (area.south + area.north) / 2)
    )
    x, y = Transformer.from_crs(4326, crs, always_xy=True).transform(lon, lat)
    dem = dem_from_array(FLAT, Affine(30.0, 0.0, x - 900, 0.0, -30.0, y + 900), crs)
    azimuth_deg, length_m = goes_north(dem)
    assert azimuth_deg == pytest.approx(0.0, abs=0.01)
    assert length_m == pytest.approx(1000.0, abs=0.1)


# ---- other bodies


@pytest.mark.parametrize(
    "crs",
    [
        "ESRI:104905",  # Mars 2000
        "ESRI:104903",  # Moon 2000
        "+proj=stere +lat_0=90 +R=1737400 +units=m",
        "+proj=eqc +R=3396190 +units=m",
    ],
)
def test_another_body_is_refused_in_one_line(write_raster, refused, crs):
    geographic = crs.startswith("ESRI")
    grid = Affine(0.01, 0, 10.0, 0, -0.01, 20.0) if geographic else Affine(50.0, 0, 1000.0, 0, -50.0, 9000.0)
    path = write_raster(np.arange(100, dtype=np.float32).reshape(10, 10), crs=crs, transform=grid)
    assert "another body than the Earth" in refused("dem", "info", path)
    assert "another body than the Earth" in refused("predict", "--dem", path, "--at", "20,10")


def test_the_moon_s_dem_of_gazebo_is_refused_in_one_line(skyfix_data, bundle_dir, refused):
    moon = skyfix_data / "reports/dem/dem_moon.tif"
    assert "another body" in refused("dem", "info", moon)
    assert "another body" in refused("locate", bundle_dir, "--dem", moon)


def test_dem_info_s_json_says_the_same(write_raster, run):
    path = write_raster(FLAT, crs="+proj=utm +zone=10 +ellps=clrk66 +units=m")
    _, out, _ = run("dem", "info", path, "--json")
    facts = json.loads(out)
    assert facts["datum_known"] is False
    assert any("--crs" in note for note in facts["notes"])
    _, out, _ = run("dem", "info", path, "--json", "--crs", "EPSG:26710")
    facts = json.loads(out)
    assert facts["datum_known"] is True
    assert facts["wgs84_accuracy_m"] == 7.0
    assert facts["vertical_datum"].startswith("not stated")
