"""The page after a restart, and on a map whose metres are none of the ground: in Debian's chromium."""

import dataclasses
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from browser import DESKTOP, Page, browser
from fakes.located import ScriptedActions, answer_of, bundle_id, write_bundle
from pyproj import Transformer

from localizer.dem.ground import map_metres
from localizer.track.tracker import Tracker
from rig.config.run import HttpServer
from rig.daemon.http import serving
from rig.daemon.search.answers import restore
from rig.daemon.spool.store import Spool
from rig.daemon.state import Answer, DaemonState
from sim.commands.options import EMBEDDED_DEM

pytestmark = [pytest.mark.system, pytest.mark.timeout(900)]


@pytest.fixture
def page(program: Callable[[str], Path], tmp_path: Path) -> Iterator[Page]:
    with browser(program("chromium"), program("chromedriver"), tmp_path / "profile", DESKTOP) as page:
        yield page


def store(spool: Spool, answer: Answer) -> None:
    write_bundle(spool.bundles_dir, answer.bundle)
    spool.begin_capture("interval", None)
    spool.end_capture()
    spool.set_answer(answer, Tracker())


def count(page: Page, selector: str) -> object:
    return page.does(f"document.querySelectorAll('{selector}').length")


def test_after_a_restart_the_last_fix_is_shown_as_old_with_the_track(page: Page, tmp_path: Path) -> None:
    with Spool(tmp_path / "spool", 100) as spool:
        for number in (1, 2, 3):
            store(spool, answer_of(bundle_id(number), "fix", 400.0 - 100.0 * number, east_m=200.0 * number))
        daemon_state = DaemonState()
        restore(daemon_state, spool)
        daemon_state.set_activity("idle")
        section = HttpServer(listen="127.0.0.1:0", valid_s=3600.0)
        with serving(section, daemon_state, ScriptedActions(), spool, [EMBEDDED_DEM]) as url:
            page.open(url)
            page.until(lambda: page.text("verdict") == "OLD FIX", "an old fix")
            assert page.does("document.getElementById('answer').className") == "old"  # striped
            assert page.text("age").split()[1] in ("seconds", "minute", "minutes")
            assert page.text("place").split()[0] == "37.22000°"
            assert "before the rig was started anew" in page.text("meaning")
            page.until(lambda: count(page, "#over .stop") == 3, "the track")
            page.until(lambda: count(page, "#over .past .star") == 1, "a hollow star")
            assert count(page, "#over .now") == 0

            daemon_state.set_answer(answer_of(bundle_id(4), "none", 1.0))
            page.until(lambda: page.text("verdict") == "NO FIX", "an answer of this run")
            assert "The last fix is" in page.text("meaning")
            # these bundles have no skylines beside them
            assert [said for said in page.complaints() if "/skylines" not in said] == []


def test_an_ellipse_and_the_scale_bar_are_of_the_ground(page: Page, tmp_path: Path) -> None:
    x, y = Transformer.from_crs("EPSG:4326", "EPSG:3857", always_xy=True).transform(15.1, 68.3)
    dem = tmp_path / "mercator.tif"
    rows, cols = np.mgrid[:120, :160]
    with rasterio.open(
        dem,
        "w",
        driver="GTiff",
        height=120,
        width=160,
        count=1,
        dtype="float32",
        crs="EPSG:3857",
        transform=Affine(75.0, 0.0, x - 6000.0, 0.0, -75.0, y + 4500.0),
    ) as file:
        file.write((500 + 200 * np.sin(rows / 9) * np.cos(cols / 7)).astype(np.float32), 1)
    scale = map_metres("EPSG:3857", x, y).scale
    answer = answer_of(bundle_id(1), "fix", 5.0)
    assert answer.fix.position is not None
    place = answer.fix.position.model_copy(
        update={"easting_m": x, "northing_m": y, "crs": "EPSG:3857", "lat_deg": 68.3, "lon_deg": 15.1}
    )
    candidate = answer.fix.candidates[0].model_copy(update={"easting_m": x, "northing_m": y})
    fix = answer.fix.model_copy(
        update={"position": place, "covariance_m2": ((900.0, 0.0), (0.0, 400.0)), "candidates": (candidate,)}
    )
    daemon_state = DaemonState()
    daemon_state.set_answer(dataclasses.replace(answer, fix=fix))
    section = HttpServer(listen="127.0.0.1:0", valid_s=3600.0)
    with (
        Spool(tmp_path / "spool", 100) as spool,
        serving(section, daemon_state, ScriptedActions(), spool, [dem]) as url,
    ):
        page.open(url)
        page.until(lambda: count(page, "#over .now .ellipse") == 1, "an ellipse")
        page.does("document.querySelector('[data-view=near]').click()")
        page.until(lambda: count(page, "#over .now .ellipse") == 1, "an ellipse from near by")
        across_px = page.does("document.querySelector('.ellipse').getBoundingClientRect().width")
        per_px = page.does(
            "(() => { const map = document.getElementById('map'); return map.viewBox.baseVal.width / map.clientWidth })()"
        )
        assert isinstance(across_px, float | int)
        assert isinstance(per_px, float | int)
        expected_m = 2.0 * np.sqrt(5.991) * 30.0  # of the ground
        assert across_px * per_px / scale == pytest.approx(expected_m, rel=0.05)
        bar_px = page.does("document.getElementById('scale').getBoundingClientRect().width")
        bar_m = float(str(page.does("document.getElementById('scale').textContent")).split()[0])
        assert isinstance(bar_px, float | int)
        assert bar_px * per_px / scale == pytest.approx(bar_m, rel=0.05)
        assert "95 % within" in str(page.does("document.getElementById('facts').textContent"))
        assert "73 m" in str(page.does("document.getElementById('facts').textContent"))
        assert page.complaints() == []
