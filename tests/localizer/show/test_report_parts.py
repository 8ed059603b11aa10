"""A file of a report that cannot be made costs none of the others, and is named."""

import numpy as np
import pytest
from affine import Affine
from click.testing import CliRunner
from fakes.results import a_result
from pyproj import CRS

from localizer.bundle import load_bundle
from localizer.commands import cli
from localizer.dem.lattice import dem_from_array
from localizer.errors import SkyfixError
from localizer.show import report_folder as folder_module
from localizer.show.output_parts import OutputParts
from localizer.show.report_folder import prepare_folder, write_report

ALL = {"report.html", "posterior.tif", "candidates.geojson", "fix.gpx", "fix.kml"}
EXPORTERS = {
    "posterior.tif": "posterior_tif",
    "candidates.geojson": "candidates_geojson",
    "fix.gpx": "fix_gpx",
    "fix.kml": "fix_kml",
    "report.html": "page",
}


def terrain():
    rows, cols = np.mgrid[:40, :50]
    z_m = 900.0 + 200.0 * np.sin(rows / 9) * np.cos(cols / 7)
    return dem_from_array(z_m, Affine(1 / 3600, 0.0, -122.2, 0.0, -1 / 3600, 37.3), CRS.from_epsg(4326))


def quick_page(_bundle, _images, _result, _dem, _places, _posterior, files, _truth, missing):
    return "\n".join([*missing, *(f'href="{name}"' for name, _ in files)])


def fails(*_args, **_options):
    raise ValueError("longitude out of range")


@pytest.fixture
def written(bundle_dir, tmp_path, monkeypatch):
    """Writes a report, with a page that takes no time to draw, and returns its folder and what went wrong."""
    monkeypatch.setattr(folder_module, "page", quick_page)
    bundle = load_bundle(bundle_dir)
    images = {frame.label: np.full((12, 16, 3), 90, np.uint8) for frame in bundle.frames}

    def written(spots=((20.0, 30.0, 0.999),)):
        dem = terrain()
        target = tmp_path / "report"
        prepare_folder(target)
        try:
            write_report(target, bundle, images, a_result(dem, list(spots)), dem)
        except SkyfixError as error:
            return target, error
        return target, None

    return written


@pytest.mark.parametrize("name", EXPORTERS)
def test_one_exporter_that_fails_leaves_all_other_files(written, monkeypatch, name):
    monkeypatch.setattr(folder_module, EXPORTERS[name], fails)
    target, error = written()
    assert {path.name for path in target.iterdir()} == ALL - {name}
    assert error is not None
    assert error.exit_status == 1
    assert f"{name}: could not be made (ValueError: longitude out of range" in str(error)
    assert "\n" not in str(error)
    if name != "report.html":
        html = (target / "report.html").read_text()
        assert f"{name}: could not be made" in html
        assert f'href="{name}"' not in html


def test_no_old_file_is_left_in_the_place_of_one_that_failed(written, monkeypatch):
    written()
    monkeypatch.setattr(folder_module, "fix_gpx", fails)
    target, _ = written()
    assert {path.name for path in target.iterdir()} == ALL - {"fix.gpx"}


def test_several_failures_are_all_named(written, monkeypatch):
    for name in ("fix_gpx", "fix_kml"):
        monkeypatch.setattr(folder_module, name, fails)
    target, error = written()
    assert {path.name for path in target.iterdir()} == ALL - {"fix.gpx", "fix.kml"}
    assert "fix.gpx" in str(error)
    assert "fix.kml" in str(error)


@pytest.mark.parametrize("broken", ["places", "posterior"])
def test_even_without_the_places_there_is_a_page(written, monkeypatch, broken):
    monkeypatch.setattr(folder_module, broken, fails)
    target, error = written()
    assert (target / "report.html").is_file()
    assert error is not None
    if broken == "posterior":
        assert {path.name for path in target.iterdir()} == ALL - {"posterior.tif"}


def test_the_page_itself_names_what_is_missing(bundle_dir, tmp_path, monkeypatch):
    monkeypatch.setattr(folder_module, "fix_gpx", fails)
    bundle, dem = load_bundle(bundle_dir), terrain()
    images = {frame.label: np.full((12, 16, 3), 90, np.uint8) for frame in bundle.frames}
    prepare_folder(tmp_path / "report")
    with pytest.raises(SkyfixError, match=r"fix\.gpx"):
        write_report(tmp_path / "report", bundle, images, a_result(dem, [(20.0, 30.0, 0.999)]), dem)
    html = (tmp_path / "report" / "report.html").read_text()
    assert "fix.gpx: could not be made (ValueError: longitude out of range" in html


def test_a_whole_report_fails_nothing(written):
    target, error = written()
    assert error is None
    assert {path.name for path in target.iterdir()} == ALL


def test_bad_input_among_the_failures_does_not_hide_a_defect():
    parts = OutputParts()
    with parts.part("one"):
        raise SkyfixError("--plot: no space left")
    with parts.part("two"):
        raise ZeroDivisionError("division by zero")
    with pytest.raises(SkyfixError, match="no space left; two: could not be made") as raised:
        parts.end()
    assert raised.value.exit_status == 1


def test_who_interrupts_is_not_held_up():
    parts = OutputParts()
    with pytest.raises(KeyboardInterrupt), parts.part("one"):
        raise KeyboardInterrupt


@pytest.mark.parametrize("broken", ["plot", "report"])
def test_locate_prints_the_fix_writes_the_other_and_names_what_failed(
    bundle_dir, tmp_path, monkeypatch, broken
):
    dem, plot, target = tmp_path / "dem.tif", tmp_path / "fix.png", tmp_path / "report"
    dem.write_bytes(b"")
    monkeypatch.setattr("localizer.dem.choice.DemChoice.load_to_search", lambda *_args, **_options: terrain())
    result = a_result(terrain(), [(20.0, 30.0, 0.999)])
    monkeypatch.setattr("localizer.search.locate.locate_bundle", lambda *_: result)
    monkeypatch.setattr(
        "localizer.show.plot.draw_fix" if broken == "plot" else "localizer.show.report_folder.fix_kml", fails
    )
    done = CliRunner().invoke(
        cli.localizer,
        [
            "locate",
            str(bundle_dir),
            "--dem",
            str(dem),
            "--json",
            "--plot",
            str(plot),
            "--report",
            str(target),
        ],
    )
    assert '"schema":"skyfix.fix/1"' in done.output
    assert isinstance(done.exception, SkyfixError)
    assert done.exception.exit_status == 1
    assert ("fix.png" if broken == "plot" else "fix.kml") in str(done.exception)
    assert plot.exists() == (broken != "plot")
    assert {path.name for path in target.iterdir()} == (ALL if broken == "plot" else ALL - {"fix.kml"})
