"""The page in Debian's chromium: what a crew sees, on a desk and on a phone, of any state that the rig can be in.

``SKYFIX_SCREENSHOTS=FOLDER`` keeps the pictures.
"""

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from browser import DESKTOP, PHONE, Page, browser
from fakes.daemon import LONG_PATIENCE_S, Daemon, add_keys, running_daemon
from fakes.driving import drive_to, next_stop
from fakes.located import ScriptedActions, answer_of, bundle_id, write_bundle

from localizer.fix import Status
from localizer.track.tracker import Tracker
from rig.config.run import HttpServer
from rig.daemon.http import serving
from rig.daemon.search.skylines import FILE_NAME, BundleSkylines, FrameSkylines
from rig.daemon.spool.store import Spool
from rig.daemon.state import DaemonState
from sim.commands.options import EMBEDDED_DEM
from sim.launch.launcher import simulated_rig
from sim.world.scenario import load_scenario
from sim.world.truth import World

pytestmark = [pytest.mark.system, pytest.mark.timeout(900)]

TOKEN = "0123456789abcdef0123456789abcdef"
SIZES = {"desktop": DESKTOP, "phone": PHONE}
SMALLEST_PX = 14.0
DRIVE_S = 6.0


@pytest.fixture
def window(program: Callable[[str], Path], tmp_path: Path) -> Callable[[str], object]:
    """Opens a browser of a size."""
    chromium, chromedriver = program("chromium"), program("chromedriver")
    return lambda size: browser(chromium, chromedriver, tmp_path / f"profile-{size}", SIZES[size])


class Rig:
    """A daemon state and a spool, and the server on them, which can be stopped and started again."""

    def __init__(self, folder: Path) -> None:
        self.spool, self.daemon_state, self.actions = (
            Spool(folder / "spool", 100),
            DaemonState(),
            ScriptedActions(),
        )
        self._token = folder / "token"
        self._token.write_text(TOKEN)
        self._token.chmod(0o600)
        self.daemon_state.set_activity("idle")
        self.daemon_state.set_device("camera", "ok", "camera 64 x 48 px")

    @contextmanager
    def serving(self, listen: str = "127.0.0.1:0") -> Iterator[str]:
        section = HttpServer(listen=listen, token_file=self._token, valid_s=3600.0)
        with serving(section, self.daemon_state, self.actions, self.spool, [EMBEDDED_DEM]) as url:
            yield url

    def answered(self, number: int, status: Status, age_s: float) -> None:
        answer = answer_of(bundle_id(number), status, age_s, east_m=150.0 * number)
        folder = write_bundle(self.spool.bundles_dir, answer.bundle)
        line = ((0.0, 20.0), (63.0, 24.0))
        frames = tuple(
            FrameSkylines(
                label=label, width_px=64, height_px=48, found=(line,), doubtful=(), predicted=(line,)
            )
            for label in "NESW"
        )
        (folder / FILE_NAME).write_text(BundleSkylines(bundle=answer.bundle, frames=frames).model_dump_json())
        self.spool.reconcile()
        self.spool.set_answer(answer, Tracker())
        self.daemon_state.set_answer(answer)


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[Rig]:
    rig = Rig(tmp_path)
    with rig.spool:
        yield rig


def looks(page: Page) -> str:
    """The class that the answer's box has, which is how it looks."""
    return str(page.does("document.getElementById('answer').className"))


def fits(page: Page) -> bool:
    """Whether nothing is cut off on the right."""
    return bool(page.does("document.documentElement.scrollWidth <= innerWidth"))


def smallest_type_px(page: Page) -> float:
    """Of all text that is shown."""
    return float(
        page.does(  # type: ignore[arg-type]
            "Math.min(...[...document.querySelectorAll('body *')].filter(e => e.offsetParent && [...e.childNodes]"
            ".some(n => n.nodeType === 3 && n.data.trim())).map(e => parseFloat(getComputedStyle(e).fontSize)))"
        )
    )


@pytest.mark.parametrize("size", SIZES)
def test_each_status_is_distinct_and_an_old_fix_never_looks_current(
    rig: Rig, window: Callable[[str], object], tmp_path: Path, size: str
) -> None:
    with rig.serving() as url, window(size) as page:  # type: ignore[attr-defined]
        page.open(url)
        page.until_says("verdict", "NO ANSWER YET")

        rig.answered(1, "fix", 12.0)
        page.until_says("verdict", "FIX")
        page.until(lambda: looks(page) == "fix", "a fix")
        assert page.text("place").split() == ["37.22000°", "N", "122.17000°", "W"]
        assert re.fullmatch(r"\d+ (seconds|minutes?) old", page.text("age"))
        page.until(lambda: page.does("document.querySelectorAll('#over .now .star').length") == 1, "a star")
        page.until(
            lambda: page.does("document.querySelectorAll('#frames figure').length") == 4, "four frames"
        )
        page.shoot(f"{size}-fix", tmp_path)

        rig.answered(2, "ambiguous", 5.0)
        page.until(lambda: looks(page) == "ambiguous", "ambiguous")
        assert page.text("verdict") == "AMBIGUOUS"
        assert page.text("place") == ""
        assert "3 places fit" in page.text("meaning")
        assert page.does("document.querySelectorAll('#candidates li').length") == 3
        page.until(lambda: page.does("document.querySelectorAll('#over .diamond').length") == 3, "diamonds")
        assert page.does("document.querySelectorAll('#over .star').length") == 0
        page.shoot(f"{size}-ambiguous", tmp_path)

        rig.answered(3, "none", 5.0)
        page.until(lambda: looks(page) == "none", "none")
        assert page.text("verdict") == "NO FIX"
        assert page.text("place") == ""
        assert "the vehicle may be elsewhere" in page.text("meaning")
        page.until(
            lambda: page.does("document.querySelectorAll('#over .past .star').length") == 1, "an old star"
        )
        page.shoot(f"{size}-none", tmp_path)

        rig.answered(4, "fix", 3601.0)
        page.until(lambda: looks(page) == "old", "old")
        assert page.text("verdict") == "OLD FIX"
        assert page.text("age") == "60 minutes old"
        assert page.does("document.querySelectorAll('#over .now').length") == 0
        page.shoot(f"{size}-old", tmp_path)

        assert fits(page)
        assert smallest_type_px(page) >= SMALLEST_PX
        assert page.complaints() == []


def test_the_age_of_a_fix_is_updated_live(rig: Rig, window: Callable[[str], object]) -> None:
    with rig.serving() as url, window("phone") as page:  # type: ignore[attr-defined]
        rig.answered(1, "fix", 3590.0)
        page.open(url)
        page.until(lambda: looks(page) == "fix", "a fix")
        page.until(lambda: looks(page) == "old", "old")


def test_without_a_connection_nothing_looks_current_until_it_is_back(
    rig: Rig, window: Callable[[str], object], tmp_path: Path
) -> None:
    with window("phone") as page:  # type: ignore[attr-defined]
        with rig.serving() as url:
            rig.answered(1, "fix", 5.0)
            page.open(url)
            page.until(lambda: looks(page) == "fix", "a fix")
        page.until(lambda: not page.does("document.getElementById('offline').hidden"), "offline")
        assert "No connection to the rig" in page.text("offline")
        assert looks(page) == "old"
        assert page.does("document.getElementById('capture').disabled") is True
        page.shoot("phone-offline", tmp_path)

        with rig.serving(url.removeprefix("http://")):
            page.until(lambda: page.does("document.getElementById('offline').hidden"), "online again")
            page.until(lambda: looks(page) == "fix", "a fix again")
            rig.daemon_state.set_device("camera", "failing", "no picture within 2 s; look at its cable")
            page.until_says("log", "no picture within 2 s")
            page.until_says("devices", "failing")


def test_what_the_rig_says_is_never_taken_for_markup(rig: Rig, window: Callable[[str], object]) -> None:
    evil = "<img src=x onerror=\"document.title='owned'\"><script>document.title='owned'</script>"
    with rig.serving() as url, window("desktop") as page:  # type: ignore[attr-defined]
        page.open(url)
        rig.daemon_state.set_device("camera", "failing", evil)
        rig.daemon_state.emit("capture", stage="failed", reason=evil)
        page.until_says("devices", "<script>")
        page.until_says("log", "<script>")
        assert page.does("document.querySelectorAll('#log img, #devices img').length") == 0
        assert "owned" not in page.does("document.title")  # type: ignore[operator]


def test_a_drive_with_a_simulated_rig(window: Callable[[str], object], tmp_path: Path) -> None:
    """From the first look at the page, over the token and a capture, to the fix with its skylines and its track."""
    (tmp_path / "token").write_text(TOKEN)
    (tmp_path / "token").chmod(0o600)
    world = World.create([EMBEDDED_DEM], load_scenario(None), 3)
    with simulated_rig(world, bundle_dir=tmp_path / "bundles", dem_paths=[EMBEDDED_DEM]) as rig:
        add_keys(rig.config_path, "run.http", token_file=f'"{tmp_path / "token"}"', valid_s=LONG_PATIENCE_S)
        add_keys(rig.config_path, "run.search", time_s=LONG_PATIENCE_S)  # on a busy machine it is minutes
        with (
            running_daemon(rig.config_path, tmp_path / "log") as daemon,
            window("desktop") as page,  # type: ignore[attr-defined]
        ):
            daemon.until_ready()
            url = re.findall(r"HTTP url=(\S+)", (tmp_path / "log").read_text())[0]
            page.open(url)
            page.until(
                lambda: page.does("document.querySelectorAll('#devices .ok').length") == 5, "all devices ok"
            )

            page.until(lambda: can_capture(page), "ready")
            page.does("document.getElementById('capture').click()")
            enter_token(page, "wrong" * 5)
            page.until_says("ask-why", "refused")
            enter_token(page, TOKEN)
            page.until_says("activity", "capturing")
            agrees(page, answered(page, daemon, 1))

            lat_deg, lon_deg, _ = next_stop(rig, 325.0)
            drive_to(rig, lat_deg, lon_deg, DRIVE_S)
            page.until(lambda: can_capture(page), "ready again")
            page.does("document.getElementById('capture').click()")  # the token is known by now
            page.until_says("activity", "capturing")
            status = answered(page, daemon, 2)
            agrees(page, status)

            page.until(lambda: page.does("document.querySelectorAll('#frames figure').length") == 4, "frames")
            # a steep frame may show the sky in an eighth of its columns only
            lines = "[...document.querySelectorAll('#frames path.{}')].every(p => p.getAttribute('d').length > 100)"
            page.until(lambda: page.does(lines.format("found")), "skylines found")
            if status["last"]["fix"]["position"]:
                assert page.does(lines.format("predicted"))
            page.shoot("drive-desktop", tmp_path)
            page.resize(PHONE)
            page.until(lambda: fits(page), "as narrow as a phone")
            page.shoot("drive-phone", tmp_path)
            foreign = "performance.getEntriesByType('resource').filter(e => !e.name.startsWith(location.origin)).length"
            assert page.does(foreign) == 0
            assert not [
                message for message in page.complaints() if "/capture" not in message
            ]  # the refused token
            assert daemon.stop() == 0
            page.until_says("offline", "No connection")


def agrees(page: Page, status: dict[str, Any]) -> None:
    """What the search makes of the place is not this test's matter; that the page says it is."""
    fix = status["last"]["fix"]
    page.until(lambda: fix["bundle"] in page.text("log") and looks(page) == fix["status"], fix["status"])
    fixes = status["counts"].get("answers fix", 0)
    page.until(lambda: page.does("document.querySelectorAll('#over .stop').length") == fixes, "a track")


def answered(page: Page, daemon: Daemon, count: int) -> dict[str, Any]:
    """The daemon's status once so many bundles have an answer: on a busy machine a search takes minutes."""

    def is_answered() -> bool:
        counts = daemon.status()["counts"]
        lost = [name for name in ("captures failed", "captures refused", "searches failed") if name in counts]
        assert not lost, daemon.log.read_text()
        return sum(number for name, number in counts.items() if name.startswith("answers ")) == count

    page.until(is_answered, f"{count} answers: {daemon.log.read_text()}")
    return daemon.status()


def can_capture(page: Page) -> bool:
    return not page.does("document.getElementById('capture').disabled")


def enter_token(page: Page, token: str) -> None:
    page.until(lambda: page.does("document.getElementById('ask').open"), "a question for the token")
    page.driver.execute_script("document.getElementById('token').value = arguments[0]", token)
    page.does("document.querySelector('#ask button.main').click()")
