import dataclasses
import errno
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from affine import Affine

from localizer.fix import Candidate, Fix, Nuisance, Position, Stage1Counts
from localizer.search.details import FrameDetail, LocateDetails, LocateResult

# ---- dem info


def test_dem_info_says_what_is_in_the_terrain_that_ships(run, santa_cruz_file):
    status, out, err = run("dem", "info", santa_cruz_file, "--date", "2026-11-23")
    assert (status, err) == (0, "")
    for fact in (
        "GTiff, 800 x 800 int16, pixel is point, vertical unit m",
        "30.83 m north-south x 24.65 m east-west",
        "EPSG:4326 (WGS 84); positions in EPSG:32610",
        "37.12514° to 37.34736° north, -122.27792° to -122.05569° east",
        "28.0 to 996.0 m, 0.00 % void",
        "+0.436° to +0.573°",
        "+12.67° at the centre on 2026-11-23",
    ):
        assert fact in out


def test_dem_info_as_json_is_one_object(run, santa_cruz_file):
    status, out, _ = run("dem", "info", santa_cruz_file, "--json", "--date", "2026-11-23")
    facts = json.loads(out)
    assert status == 0
    assert facts["files"][0]["driver"] == "GTiff"
    assert facts["files"][0]["vertical_unit_from"] == "assumed"
    assert (facts["rows"], facts["cols"]) == (800, 800)
    assert (facts["lowest_m"], facts["highest_m"], facts["voids_percent"]) == (28.0, 996.0, 0.0)
    assert facts["metric_crs"] == "EPSG:32610"
    assert facts["bounds"]["north_deg"] == pytest.approx(37.347361, abs=1e-6)
    assert facts["convergence_deg"] == pytest.approx([0.436, 0.573], abs=1e-3)
    # the World Magnetic Model's own calculator gives 12.67
    assert facts["declination_deg"] == pytest.approx(12.67, abs=0.01)


def test_dem_info_has_no_declination_where_the_model_has_no_life(run, santa_cruz_file):
    _, out, _ = run("dem", "info", santa_cruz_file, "--json", "--date", "1992-07-01")
    assert json.loads(out)["declination_deg"] is None
    _, out, _ = run("dem", "info", santa_cruz_file, "--date", "1992-07-01")
    assert "no World Magnetic Model at hand for 1992-07-01" in out


def test_dem_info_takes_several_files_as_one(run, write_raster, ramp):
    first = write_raster(ramp, "first.tif")
    second = write_raster(
        ramp, "second.tif", transform=Affine(30.0, 0.0, 560_150.0, 0.0, -30.0, 5_120_000.0), unit="m"
    )
    status, out, _ = run("dem", "info", first, second)
    assert status == 0
    assert "6 rows x 10 columns" in out
    assert str(first) in out
    assert str(second) in out


def test_dem_info_points_at_zeros_that_look_like_voids(run, write_raster, ramp):
    z = ramp + 850
    z[2, 2:4] = 0
    path = write_raster(z)
    assert "2 cells of 0 lie far below all others" in run("dem", "info", path)[1]
    status, out, _ = run("dem", "info", path, "--nodata", "0", "--json")
    assert status == 0
    assert json.loads(out)["suspect_zeros"] == 0
    assert json.loads(out)["files"][0]["voids"] == 2
    # ground at sea level is none of them
    assert "note" not in run("dem", "info", write_raster(ramp))[1]


def test_what_an_option_says_otherwise_than_the_file_is_told(run, write_raster, ramp):
    path = write_raster(ramp, crs="EPSG:32611", unit="m")
    out = run("dem", "info", path, "--crs", "EPSG:32610", "--vertical-unit", "ft")[1]
    assert "says WGS 84 / UTM zone 11N; --crs takes it for WGS 84 / UTM zone 10N" in out
    assert "says its elevations are in m; --vertical-unit takes them for ft" in out
    assert "note" not in run("dem", "info", path, "--crs", "EPSG:32611", "--vertical-unit", "m")[1]


def test_dem_info_across_the_date_line_runs_from_west_to_east(run, write_raster, ramp):
    path = write_raster(ramp, crs="EPSG:4326", transform=Affine(0.01, 0.0, 179.97, 0.0, -0.01, -17.0))
    bounds = json.loads(run("dem", "info", path, "--json")[1])["bounds"]
    assert bounds["west_deg"] == pytest.approx(179.97)
    assert bounds["east_deg"] == pytest.approx(-179.98)


def test_golden_dem_info_of_archive_files(run, skyfix_data):
    status, out, _ = run("dem", "info", skyfix_data / "terrain/sthelens_usgs_30m.dem", "--json")
    facts = json.loads(out)
    assert status == 0
    assert (facts["crs"], facts["metric_crs"]) == ("EPSG:26710", "EPSG:26710")
    assert facts["files"][0]["driver"] == "USGSDEM"
    assert facts["voids_percent"] == pytest.approx(100 * 4151 / 153036)
    out = run("dem", "info", skyfix_data / "photos/aletsch_aster_25m.tif")[1]
    assert "6891 cells of 0 lie far below all others; if they are voids, say --nodata 0" in out
    assert "note" not in run("dem", "info", skyfix_data / "terrain/sanfrancisco_srtm_1s.tif")[1]


def test_every_dem_that_cannot_be_used_is_told_in_one_line(refused, write_raster, ramp, tmp_path):
    good = write_raster(ramp, "good.tif")
    text = tmp_path / "notes.txt"
    text.write_text("not a raster")
    void = write_raster(np.full((6, 5), -32767, np.int16), "void.tif")
    bare = write_raster(ramp, "bare.tif", crs=None)
    feet = write_raster(ramp, "feet.tif", crs="EPSG:2227")
    far = write_raster(ramp, "far.tif", transform=Affine(30.0, 0.0, 0.0, 0.0, -30.0, 5_120_000.0))
    turned = write_raster(
        ramp, "turned.tif", transform=Affine(30.0, 0.0, 5e5, 0.0, -30.0, 5e6) @ Affine.rotation(9)
    )
    assert "no such file" in refused("dem", "info", tmp_path / "nowhere.tif")
    assert "not an elevation raster" in refused("dem", "info", text)
    assert "all void" in refused("dem", "info", void)
    assert "--crs" in refused("dem", "info", bare)
    assert "--vertical-unit" in refused("dem", "info", feet)
    assert "no overlap" in refused("dem", "info", good, far)
    assert "rotated" in refused("dem", "info", turned)
    assert "too few" in refused("dem", "info", write_raster(ramp[:2], "small.tif"))
    assert "--crs" in refused("dem", "info", good, "--crs", "EPSG:nonsense")
    assert "--vertical-unit" in refused("dem", "info", good, "--vertical-unit", "furlong")
    assert "Missing argument" in refused("dem", "info")


def test_a_cut_file_is_told_in_one_line_by_the_program_itself(tmp_path, write_raster):
    """As a process of its own: GDAL writes to the standard error that no test fixture replaces."""
    whole = write_raster(np.random.default_rng(1).integers(0, 3000, (300, 300)).astype(np.int16))
    cut = tmp_path / "cut.tif"
    cut.write_bytes(whole.read_bytes()[:50_000])
    done = subprocess.run(
        [sys.executable, "-c", "from localizer.commands.cli import main; main()", "dem", "info", str(cut)],
        capture_output=True,
        text=True,
        env=os.environ,
        check=False,
    )
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.count("\n") == 1
    assert "not an elevation raster" in done.stderr


# ---- locate


@pytest.fixture
def dem_file(write_raster):
    rows, cols = np.mgrid[:40, :50]
    return write_raster((1000 + 10 * rows + 20 * np.sin(cols)).astype(np.float32), "terrain.tif")


def a_result(status):
    """What the search would say of a place in ``dem_file``."""
    place = {"easting_m": 560_310.4, "northing_m": 5_119_402.8}
    position = Position(
        **place, crs="EPSG:32610", lat_deg=46.23, lon_deg=-122.22, ground_m=1190.0, row=19.4, col=9.8
    )
    fix = Fix(
        bundle="20261123T043151Z-3f9a",
        status=status,
        position=None if status == "none" else position,
        covariance_m2=None if status == "none" else ((9.0, 0.0), (0.0, 4.0)),
        probability=0.0 if status == "none" else 0.999,
        candidates=() if status == "none" else (Candidate(**place, probability=0.999, rms_px=0.8),),
        stage1=Stage1Counts(cells=2000, after_altitude=400, after={"E": 40, "N": 7}, points_explored=34567),
        residual={} if status == "none" else {"N": 0.7, "E": 0.9},
        nuisance=None
        if status == "none"
        else Nuisance(azimuth_bias_deg=0.4, tilt_bias_deg=-0.01, altitude_bias_m=2.1),
        timing_s={"horizon": 0.05, "stage1": 0.02},
    )
    u_px = np.arange(16.0)
    frames = tuple(
        FrameDetail(label, u_px, np.full(16, 5.5), u_px < 12, u_px, np.full(16, 5.0)) for label in ("N", "E")
    )
    survivors = {name: np.argwhere(np.ones((n, 2))) for name, n in (("altitude", 20), ("E", 5), ("N", 2))}
    return LocateResult(
        fix,
        LocateDetails(
            frames,
            survivors,
            np.array([[19.4, 9.8]])[: len(fix.candidates)],
            np.array([[[9.0, 0.0], [0.0, 4.0]]])[: len(fix.candidates)],
            None,
        ),
    )


@pytest.fixture
def searched(monkeypatch):
    """Puts a result in the place of the search; returns what the search was called with."""

    def searched(status):
        calls = []

        def locate_bundle(bundle, dem):
            calls.append((bundle, dem))
            return a_result(status)

        monkeypatch.setattr("localizer.search.locate.locate_bundle", locate_bundle)
        return calls

    return searched


@pytest.mark.parametrize(("status", "exit_status"), [("fix", 0), ("ambiguous", 3), ("none", 4)])
def test_locate_prints_the_fix_and_ends_with_the_contract_s_status(
    run, searched, bundle_dir, dem_file, status, exit_status
):
    calls = searched(status)
    code, out, err = run("locate", bundle_dir, "--dem", dem_file, "--json")
    assert (code, err) == (exit_status, "")
    assert out.count("\n") == 1
    assert json.loads(out)["status"] == status
    ((bundle, dem),) = calls
    assert bundle.directory == bundle_dir
    assert dem.z_m.shape == (40, 50)
    assert run("locate", bundle_dir, "--dem", dem_file)[0] == exit_status


def test_locate_in_words(run, searched, bundle_dir, dem_file, tmp_path):
    searched("fix")
    truth = tmp_path / "truth.json"
    truth.write_text(
        json.dumps({"easting_m": 560_313.4, "northing_m": 5_119_402.8, "crs": "EPSG:32610", "row": 19.4})
    )
    _, out, _ = run("locate", bundle_dir, "--dem", dem_file, "--truth", truth)
    for fact in (
        "fix: one place stands out",
        "46.23000° N  122.22000° W  (WGS84)",
        "560310.4 E  5119402.8 N  (EPSG:32610)",
        "3.0 m x 2.0 m, the longer towards 91° true",
        "3.0 m  (1.0 sigma)",
        "2000 cells > altitude 400 > E 40 > N 7  (34567 points explored)",
        "N 0.70  E 0.90  px",
        "azimuth +0.400°  tilt -0.010°  altitude +2.1 m",
        "horizon 0.05  stage1 0.02  s",
    ):
        assert fact in out


def test_the_truth_never_reaches_the_search_nor_the_json(run, searched, bundle_dir, dem_file, tmp_path):
    searched("fix")
    truth = tmp_path / "truth.json"
    truth.write_text(json.dumps({"easting_m": 0.0, "northing_m": 0.0, "crs": "EPSG:32610"}))
    with_truth = run("locate", bundle_dir, "--dem", dem_file, "--json", "--truth", truth)
    assert with_truth == run("locate", bundle_dir, "--dem", dem_file, "--json")


@pytest.mark.parametrize("status", ["fix", "ambiguous", "none"])
def test_locate_draws_the_picture(run, searched, bundle_dir, dem_file, tmp_path, status):
    searched(status)
    picture = tmp_path / "fix.png"
    run("locate", bundle_dir, "--dem", dem_file, "--json", "--plot", picture)
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("status", ["fix", "none"])
def test_locate_writes_a_report_into_a_folder_that_it_makes(
    run, searched, bundle_dir, dem_file, tmp_path, status
):
    searched(status)
    folder = tmp_path / "reports" / "first"
    out = run("locate", bundle_dir, "--dem", dem_file, "--json", "--report", folder)[1]
    assert json.loads(out)["status"] == status
    assert "<!doctype html>" in (folder / "report.html").read_text()
    assert (folder / "fix.gpx").exists() == (status == "fix")


def test_locate_warns_of_zeros_that_look_like_voids_on_standard_error(
    run, searched, bundle_dir, write_raster
):
    searched("fix")
    z = np.full((40, 50), 900, np.int16)
    z[3:5] = 0
    code, out, err = run("locate", bundle_dir, "--dem", write_raster(z), "--json")
    assert code == 0
    assert json.loads(out)["status"] == "fix"
    assert re.fullmatch(r"localizer: 100 cells of 0 .* --nodata 0\n", err)


def test_locate_says_why_nothing_may_have_been_found(run, searched, monkeypatch, bundle_dir, dem_file):
    searched("none")
    seen = dataclasses.replace(a_result("none").details.frames[0], used=np.ones(9, bool))
    stage1 = Stage1Counts(cells=2000, after_altitude=0, after={}, points_explored=0)
    nowhere = a_result("none").fix.model_copy(update={"stage1": stage1})
    result = dataclasses.replace(
        a_result("none"), fix=nowhere, details=dataclasses.replace(a_result("none").details, frames=(seen,))
    )
    monkeypatch.setattr("localizer.search.locate.locate_bundle", lambda bundle, dem: result)
    code, _, err = run("locate", bundle_dir, "--dem", dem_file)
    assert code == 4
    assert "no ground in the DEM lies as high as the altitude and the mast's height say" in err


def test_locate_interrupted_in_compiled_code_says_so(run, monkeypatch, bundle_dir, dem_file):
    def locate_bundle(bundle, dem):
        raise SystemError("returned a result with an exception set") from KeyboardInterrupt()

    monkeypatch.setattr("localizer.search.locate.locate_bundle", locate_bundle)
    assert run("locate", bundle_dir, "--dem", dem_file) == (130, "", "localizer: interrupted\n")


def test_the_search_is_told_what_is_said_of_the_dem(run, refused, searched, bundle_dir, dem_file):
    calls = searched("fix")
    run("locate", bundle_dir, "--dem", dem_file)
    run("locate", bundle_dir, "--dem", dem_file, "--dem-error", "2.5")
    assert [dem.error_m for _, dem in calls] == [None, 2.5]
    for nonsense in ("-1", "nan", "inf", "much"):
        assert "--dem-error" in refused("locate", bundle_dir, "--dem", dem_file, "--dem-error", nonsense)


def test_every_bad_input_of_locate_is_told_in_one_line_before_the_search(
    refused, searched, bundle_dir, dem_file, tmp_path
):
    calls = searched("fix")
    assert "--dem" in refused("locate", bundle_dir)
    assert "does not exist" in refused("locate", tmp_path / "nowhere", "--dem", dem_file)
    assert "no such file" in refused("locate", bundle_dir, "--dem", tmp_path / "nowhere.tif")
    assert "--plot" in refused("locate", bundle_dir, "--dem", dem_file, "--plot", tmp_path / "fix.doc")
    assert "no such folder" in refused(
        "locate", bundle_dir, "--dem", dem_file, "--plot", tmp_path / "nowhere" / "fix.png"
    )
    assert "is a file; name a folder" in refused(
        "locate", bundle_dir, "--dem", dem_file, "--report", dem_file
    )
    assert "Not a directory" in refused(
        "locate", bundle_dir, "--dem", dem_file, "--report", dem_file / "below"
    )
    assert "name of the folder is empty" in refused("locate", bundle_dir, "--dem", dem_file, "--report", "")
    (tmp_path / "folder.png").mkdir()
    assert "is a folder; name a file" in refused(
        "locate", bundle_dir, "--dem", dem_file, "--plot", tmp_path / "folder.png"
    )
    assert "cannot be written" in refused(
        "locate", bundle_dir, "--dem", dem_file, "--plot", "/proc/self/fix.png"
    )
    truth = tmp_path / "truth.json"
    assert "No such file" in refused("locate", bundle_dir, "--dem", dem_file, "--truth", truth)
    truth.write_text("{}")
    assert "easting_m" in refused("locate", bundle_dir, "--dem", dem_file, "--truth", truth)
    for fields, complaint in (
        ('{"easting_m": 0, "northing_m": 0, "crs": "nonsense"}', "crs: nonsense is not a coordinate"),
        ('{"easting_m": 0, "northing_m": 0, "crs": "EPSG:5703"}', "crs: EPSG:5703 has no eastings"),
        ('{"easting_m": 1e300, "northing_m": 0, "crs": "EPSG:32610"}', "easting_m: Input should be less"),
        ('{"easting_m": 9e7, "northing_m": 9e7, "crs": "EPSG:32610"}', "lie where EPSG:32610 is not defined"),
    ):
        truth.write_text(fields)
        assert complaint in refused("locate", bundle_dir, "--dem", dem_file, "--truth", truth)
    (bundle_dir / "frames" / "N.png").write_bytes(b"\x89PNG\r\n\x1a\n cut")
    assert "frames[N].sha256" in refused("locate", bundle_dir, "--dem", dem_file)
    (bundle_dir / "frames" / "N.png").unlink()
    assert "frames/N.png is missing" in refused("locate", bundle_dir, "--dem", dem_file)
    assert calls == []


def test_a_picture_that_the_disk_refuses_is_told_in_one_line_after_the_answer(
    run, searched, bundle_dir, dem_file, tmp_path
):
    searched("fix")
    plot = tmp_path / "fix.png"
    plot.symlink_to("/dev/full")
    status, out, err = run("locate", bundle_dir, "--dem", dem_file, "--json", "--plot", plot)
    assert status == 2
    assert json.loads(out)["status"] == "fix"
    assert err == f"localizer: --plot: {plot}: cannot be written: No space left on device\n"


def test_a_path_that_may_not_even_be_looked_at_is_told_in_one_line(refused, monkeypatch, dem_file, tmp_path):
    def forbidden(path):
        raise PermissionError(errno.EACCES, "Permission denied", str(path))

    monkeypatch.setattr("localizer.commands.cli.load_bundle", forbidden)
    said = refused("locate", tmp_path, "--dem", dem_file)
    assert said == f"localizer: {tmp_path}: permission denied; check who may read and write there\n"


def test_an_answer_that_finds_the_disk_full_is_told_in_one_line(santa_cruz_file):
    """As a process of its own, whose standard output is a full disk."""
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [
                sys.executable,
                "-c",
                "from localizer.commands.cli import main; main()",
                "dem",
                "info",
                str(santa_cruz_file),
            ],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert done.returncode == 2
    assert done.stderr == "localizer: the disk is full; make room, or write elsewhere\n"


@pytest.mark.parametrize("command", [[], ["locate"], ["predict"], ["dem"], ["dem", "info"]])
def test_help_has_an_example(run, command):
    status, out, _ = run(*command, "--help")
    assert status == 0
    assert "Example: localizer " in out
