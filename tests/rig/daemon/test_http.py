"""The daemon's HTTP API and its access control."""

import asyncio
import json
import math
import re
import shutil
from collections.abc import Iterator
from contextlib import ExitStack, nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from fakes.located import ScriptedActions, answer_of, bundle_id, json_of, write_bundle
from fastapi import HTTPException
from fastapi.security import HTTPAuthorizationCredentials
from fastapi.testclient import TestClient
from starlette.datastructures import Headers
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp

from localizer.bundle import Bundle
from localizer.fix import Fix
from localizer.track.tracker import Tracker
from rig.config.run import HttpServer
from rig.daemon.http.access_control import HostCheck, read_token, token_check
from rig.daemon.http.app import make_app
from rig.daemon.http.event_streams import MAX_STREAMS, EventStreams, TooManyStreamsError
from rig.daemon.http.map import ReliefMap
from rig.daemon.spool.store import Entry, Spool, SpoolError
from rig.daemon.state import Answer, DaemonState, TriggerAnswer
from rig.errors import ConfigError

TOKEN = "0123456789abcdef0123456789abcdef"
BEARER = {"Authorization": f"Bearer {TOKEN}"}
SANTA_CRUZ = Path(__file__).parents[3] / "sim" / "terrain" / "santa_cruz_srtm_1s.tif"


class Published:
    """A daemon state and a spool with the server's application."""

    def __init__(self, spool: Spool, token: str | None = TOKEN, dem: Path = SANTA_CRUZ) -> None:
        self.spool, self.daemon_state, self.actions = spool, DaemonState(), ScriptedActions()
        section = HttpServer(names=("rover.lan",), valid_s=30.0)
        app = make_app(
            section,
            self.daemon_state,
            self.actions,
            spool,
            EventStreams(self.daemon_state),
            ReliefMap([dem]),
            token,
        )
        self.client = TestClient(app, base_url="http://localhost")

    def answered(self, answer: Answer) -> None:
        """As the daemon does when a search has ended."""
        write_bundle(self.spool.bundles_dir, answer.bundle)
        self.spool.reconcile()
        self.spool.set_answer(answer, Tracker())
        self.daemon_state.set_answer(answer)

    def get(self, path: str, **more: Any) -> Any:
        return json_of(self.client.get(path, **more))


@pytest.fixture
def spool(tmp_path: Path) -> Iterator[Spool]:
    with Spool(tmp_path / "spool", 100) as spool:
        yield spool


@pytest.fixture
def published(spool: Spool) -> Iterator[Published]:
    published = Published(spool)
    with published.client:
        yield published


# ---- the fix


def test_before_the_first_answer_there_is_no_fix_to_be_had(published: Published) -> None:
    response = published.client.get("/fix")
    assert response.status_code == 404
    assert "no answer yet" in response.json()["detail"]


def test_a_fix_comes_as_skyfix_fix_1_with_its_age(published: Published) -> None:
    published.answered(answer_of(bundle_id(1), age_s=12.0))
    answer = published.get("/fix")
    assert Fix.model_validate(answer["fix"], strict=False).status == "fix"
    assert answer["fix"]["schema"] == "skyfix.fix/1"
    assert 12.0 <= answer["age_s"] < 30.0
    assert answer["current"] is True
    assert answer["captured"].endswith("Z")


def test_an_old_fix_is_not_current(published: Published) -> None:
    published.answered(answer_of(bundle_id(1), age_s=31.0))
    assert published.get("/fix")["current"] is False


def test_a_fix_is_not_current_once_the_vehicle_is_seen_to_move(published: Published) -> None:
    published.daemon_state.set_moving()
    published.answered(answer_of(bundle_id(1), age_s=0.0))
    assert published.get("/fix")["current"] is True
    published.daemon_state.set_moving()
    answer = published.get("/fix")
    assert answer["current"] is False
    assert answer["moved_on"] is True


@pytest.mark.parametrize("status", ["ambiguous", "none"])
def test_what_is_no_fix_is_not_current_however_young_and_leaves_the_last_fix_to_be_seen(
    published: Published, status: Any
) -> None:
    published.answered(answer_of(bundle_id(1), age_s=10.0))
    published.answered(answer_of(bundle_id(2), status))
    state = published.get("/status")
    assert state["last"]["fix"]["status"] == status
    assert state["last"]["current"] is False
    assert state["last_fix"]["bundle"] == bundle_id(1)
    assert published.get("/fix")["fix"]["status"] == status


def test_an_answer_to_a_bundle_that_had_to_wait_does_not_hide_a_newer_fix(published: Published) -> None:
    published.answered(answer_of(bundle_id(2), age_s=5.0))
    published.answered(answer_of(bundle_id(1), "none", age_s=4000.0))
    assert published.get("/fix")["bundle"] == bundle_id(2)
    assert published.get("/status")["last"]["current"] is True


def test_the_state_names_each_device_and_whether_the_rig_is_degraded(published: Published) -> None:
    published.daemon_state.set_device("camera", "ok", "camera 640 x 480")
    assert published.get("/status")["degraded"] is False
    published.daemon_state.set_device("compass", "failing", "MMC5983MA on i2c 1: no answer")
    state = published.get("/status")
    assert state["degraded"] is True
    assert [(device["name"], device["state"]) for device in state["devices"]] == [
        ("camera", "ok"),
        ("compass", "failing"),
    ]


def test_the_track_has_the_fixes_in_order_and_nothing_else(published: Published) -> None:
    for number, status in enumerate(("fix", "ambiguous", "fix", "none", "fix")):
        published.answered(answer_of(bundle_id(number), status, east_m=100.0 * number))  # type: ignore[arg-type]
    assert [point["bundle"] for point in published.get("/track")] == [bundle_id(n) for n in (0, 2, 4)]


# ---- bundles


def test_a_bundle_comes_out_as_it_was_written(published: Published) -> None:
    published.answered(answer_of(bundle_id(1)))
    folder = published.spool.bundles_dir / bundle_id(1)
    assert [each["id"] for each in published.get("/bundles")] == [bundle_id(1)]
    document = published.client.get(f"/bundles/{bundle_id(1)}")
    assert document.content == (folder / "bundle.json").read_bytes()
    assert Bundle.model_validate_json(document.content).id == bundle_id(1)
    frame = published.client.get(f"/bundles/{bundle_id(1)}/frames/E.png")
    assert frame.content == (folder / "frames" / "E.png").read_bytes()
    assert frame.headers["content-type"] == "image/png"
    assert published.get(f"/bundles/{bundle_id(1)}/fix")["fix"]["bundle"] == bundle_id(1)


def test_the_list_goes_on_where_it_stopped(published: Published) -> None:
    for number in range(5):
        published.answered(answer_of(bundle_id(number)))
    first = published.get("/bundles", params={"limit": 2})
    then = published.get("/bundles", params={"limit": 10, "before": first[-1]["number"]})
    assert [each["id"] for each in first + then] == [bundle_id(number) for number in (4, 3, 2, 1, 0)]


def test_the_skylines_are_there_once_they_have_been_stored(published: Published) -> None:
    published.answered(answer_of(bundle_id(1)))
    path = f"/bundles/{bundle_id(1)}/skylines"
    assert published.client.get(path).status_code == 404
    (published.spool.bundles_dir / bundle_id(1) / "skylines.json").write_text('{"bundle":"b","frames":[]}')
    assert published.get(path) == {"bundle": "b", "frames": []}


def test_a_bundle_that_is_gone_leaves_its_answer(published: Published) -> None:
    published.answered(answer_of(bundle_id(1)))
    shutil.rmtree(published.spool.bundles_dir / bundle_id(1))
    published.spool.reconcile()
    assert published.client.get(f"/bundles/{bundle_id(1)}").status_code == 404
    assert published.get(f"/bundles/{bundle_id(1)}/fix")["fix"]["status"] == "fix"


OUTSIDE = (
    "%2e%2e",
    "..%2f..%2fsecret",
    "..%2f..%2f..%2fsecret",
    "....//secret",
    "%2Fetc%2Fpasswd",
    "..%5c..%5csecret",
    "index.sqlite",
    "%00",
    "\u2024\u2024",
)


@pytest.mark.parametrize(
    "path", ["/bundles/{}", "/bundles/{}/frames/N.png", "/bundles/ID/frames/{}", "/page/{}"]
)
def test_no_path_leaves_the_spool(published: Published, tmp_path: Path, path: str) -> None:
    (tmp_path / "secret").write_text("what is in it")
    published.answered(answer_of(bundle_id(1)))
    for name in OUTSIDE:
        response = published.client.get(path.replace("ID", bundle_id(1)).format(name))
        assert response.status_code in (404, 422), name
        assert "what is in it" not in response.text


def test_links_out_of_the_spool_lead_nowhere(published: Published, tmp_path: Path) -> None:
    outside = write_bundle(tmp_path, "outside")
    (outside / "skylines.json").write_text("{}")
    published.answered(answer_of(bundle_id(1)))
    folder = published.spool.bundles_dir / bundle_id(1)
    for name in ("frames/N.png", "skylines.json"):
        (folder / name).unlink(missing_ok=True)
        (folder / name).symlink_to(outside / name)
    assert published.client.get(f"/bundles/{bundle_id(1)}/frames/N.png").status_code == 404
    assert published.client.get(f"/bundles/{bundle_id(1)}/skylines").status_code == 404

    (published.spool.bundles_dir / bundle_id(2)).symlink_to(outside)
    published.spool.reconcile()
    assert published.spool.folder_of(bundle_id(2)) is not None
    assert published.client.get(f"/bundles/{bundle_id(2)}").status_code == 404


def test_a_frame_whose_file_leads_outside_is_not_served(published: Published, tmp_path: Path) -> None:
    (tmp_path / "secret.png").write_text("secret")
    published.answered(answer_of(bundle_id(1)))
    document = published.spool.bundles_dir / bundle_id(1) / "bundle.json"
    fields = json.loads(document.read_text())
    fields["frames"][0]["file"] = "../../../secret.png"
    document.write_text(json.dumps(fields))
    response = published.client.get(f"/bundles/{bundle_id(1)}/frames/secret.png")
    assert response.status_code == 503
    assert "a path inside the bundle" in response.json()["detail"]


# ---- acting


@pytest.mark.parametrize(
    ("answer", "status"), [("started", 202), ("busy", 409), ("not ready", 503), ("stopping", 503)]
)
def test_a_capture_is_asked_for_with_the_token_and_the_answer_is_passed_on(
    published: Published, answer: TriggerAnswer, status: int
) -> None:
    published.actions.answer = answer
    response = published.client.post("/capture", headers=BEARER)
    assert response.status_code == status
    assert published.actions.asked == ["http"]


@pytest.mark.parametrize(
    "headers",
    [
        {},
        {"Authorization": "Bearer "},
        {"Authorization": f"Bearer {TOKEN[:-1]}"},
        {"Authorization": f"Bearer {TOKEN}x"},
        {"Authorization": f"Basic {TOKEN}"},
        {"Authorization": "Bearer \u00e9\u00e9".encode("latin-1")},
    ],
)
def test_without_the_token_nothing_is_done(published: Published, headers: dict[str, Any]) -> None:
    response = published.client.post("/capture", headers=headers)
    assert response.status_code == 401
    assert response.headers["www-authenticate"] == "Bearer"
    assert published.actions.asked == []


def test_without_a_token_file_nothing_can_be_done(spool: Spool) -> None:
    published = Published(spool, token=None)
    with published.client:
        response = published.client.post("/capture", headers=BEARER)
        assert response.status_code == 403
        assert "token_file" in response.json()["detail"]
        assert published.actions.asked == []
        assert published.get("/status")["can_act"] is False


def test_the_token_is_not_to_be_had_from_a_get(published: Published) -> None:
    assert published.client.get("/capture", headers=BEARER).status_code == 405
    assert published.actions.asked == []


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (None, "No such file"),
        (b"", "holds no token"),
        (b"short\n", "16 characters"),
        (b"two words that are long", "one word"),
        (b"\xff" * 20, "ASCII"),
    ],
)
def test_a_token_that_cannot_be_used_is_refused_at_the_start(
    tmp_path: Path, content: bytes | None, problem: str
) -> None:
    file = tmp_path / "token"
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(ConfigError, match=problem) as refused:
        read_token(file)
    assert "token_file" in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_token_is_read_without_its_line_end(tmp_path: Path) -> None:
    file = tmp_path / "token"
    file.write_text(f"{TOKEN}\n")
    file.chmod(0o600)
    assert read_token(file) == TOKEN


@pytest.mark.parametrize(
    ("mode", "told"), [(0o600, False), (0o640, False), (0o660, False), (0o604, True), (0o644, True)]
)
def test_a_token_that_everybody_can_read_is_told_of(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, mode: int, told: bool
) -> None:
    file = tmp_path / "token"
    file.write_text(TOKEN)
    file.chmod(mode)
    assert read_token(file) == TOKEN
    assert ["can be read by everybody: chmod o-r" in text for text in caplog.messages] == [True] * told


@pytest.mark.parametrize(("token", "fits"), [("x" * 15, False), ("x" * 16, True), ("x" * 4097, False)])
def test_a_token_has_16_characters_at_least(tmp_path: Path, token: str, fits: bool) -> None:
    file = tmp_path / "token"
    file.write_text(token)
    if fits:
        assert read_token(file) == token
        return
    with pytest.raises(
        ConfigError, match=r"\[run\.http\] token_file .*; make one with: openssl rand -hex 16"
    ):
        read_token(file)


# ---- who asks


REFUSED_TO = "which is not known here: use the address, or add the name to [run.http] names"


@pytest.fixture
def known(monkeypatch: pytest.MonkeyPatch) -> HostCheck:
    """Of a machine that is called ``rig7.field.example``, with the further name ``Rover.lan``."""
    monkeypatch.setattr("socket.gethostname", lambda: "Rig7.field.example")
    return HostCheck(PlainTextResponse("answered"), ["Rover.lan"])


@pytest.mark.parametrize(
    "host",
    [
        "localhost", "localhost:8080", "LOCALHOST", "localhost.", "127.0.0.1:1", "127.0.0.1:65535", "[::1]", "[::1]:8080",
        "192.168.1.20", "[fe80::1]", "ROVER.lan:8080", "rover.lan.", "rig7.field.example", "rig7.local:80", "RIG7.local",
    ],
)  # fmt: skip
def test_names_of_this_machine_and_addresses_are_known(known: HostCheck, host: str) -> None:
    assert known.knows(host)


@pytest.mark.parametrize(
    "host",
    [
        "evil.example", "evil.example:8080", "localhost.evil.example", "evil.localhost", "a.rover.lan", "xrover.lan",
        "rover.lanx", "rover.lan.evil.example", "rover", "lan", "rig7", "field.example", "x.rig7.field.example",
        "rig7.local.example", "rig7.field.example.local", "127.0.0.1.evil.example", "127.0.0", "127.0.0.1.1", "1",
        "0x7f000001", "[::1", "::1]x", "[::1].evil.example", "", ".", "localhost..", "localhost:", "localhost:x",
        "localhost:123456", "localhost:80:80", "a b", " localhost", "localhost\n", "user@localhost", "localhost/",
        "localhost,evil.example",
    ],
)  # fmt: skip
def test_a_name_that_only_resembles_a_known_one_is_not(known: HostCheck, host: str) -> None:
    assert not known.knows(host)


@pytest.mark.parametrize("host", ["localhost:8080", "192.168.1.20", "ROVER.lan:8080"])
def test_a_request_to_a_known_name_is_answered(published: Published, host: str) -> None:
    assert published.client.get("/status", headers={"Host": host}).status_code == 200


@pytest.mark.parametrize(
    "path", ["/status", "/", "/events", "/page/app.js", "/bundles", "/metrics", "/openapi.json"]
)
def test_a_name_that_merely_resolves_to_this_machine_is_not_answered(published: Published, path: str) -> None:
    response = published.client.get(path, headers={"Host": "evil.example"})
    assert response.status_code == 421
    assert response.text == f"asked as 'evil.example', {REFUSED_TO}\n"
    assert response.headers["connection"] == "close"


def test_a_capture_is_not_begun_for_a_foreign_name_even_with_the_token(published: Published) -> None:
    response = published.client.post("/capture", headers={"Host": "evil.example", **BEARER})
    assert response.status_code == 421
    assert published.actions.asked == []


@pytest.mark.parametrize(
    ("hosts", "told"),
    [
        (["localhost", "localhost"], "2 names"),
        (["localhost", "evil.example"], "2 names"),
        (["evil.example", "localhost"], "2 names"),
        ([], "0 names"),
        (["e" * 100], repr("e" * 80)),
    ],
)
def test_a_request_has_one_host(known: HostCheck, hosts: list[str], told: str) -> None:
    """What stands between may look at the other one."""
    status, headers, body = asked(known, [(b"host", host.encode()) for host in hosts])
    assert status == 421
    assert body == f"asked as {told}, {REFUSED_TO}\n".encode()
    assert headers["x-frame-options"] == "DENY"
    assert asked(known, [(b"host", b"localhost")])[::2] == (200, b"answered")


def asked(app: ASGIApp, headers: list[tuple[bytes, bytes]]) -> tuple[int, Headers, bytes]:
    """Status, headers and body of the answer to a GET with exactly these headers."""
    sent: list[Any] = []

    async def receive() -> Any:
        return {"type": "http.request", "body": b"", "more_body": False}

    async def send(message: Any) -> None:
        sent.append(message)

    scope = {"type": "http", "method": "GET", "path": "/", "headers": headers, "query_string": b""}
    asyncio.run(app(scope, receive, send))  # type: ignore[arg-type]
    start, *rest = sent
    return start["status"], Headers(raw=start["headers"]), b"".join(each["body"] for each in rest)


SECURITY_HEADERS = {
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "referrer-policy": "no-referrer",
    "cross-origin-resource-policy": "same-origin",
    "cross-origin-opener-policy": "same-origin",
    "permissions-policy": "camera=(), geolocation=(), microphone=()",
}


@pytest.mark.parametrize("host", ["localhost", "evil.example"])
def test_all_answers_carry_the_security_headers(published: Published, host: str) -> None:
    for path in ("/", "/status", "/fix", "/nothing", "/openapi.json", "/metrics"):
        headers = published.client.get(path, headers={"Host": host}).headers
        policy = dict(part.split(" ", 1) for part in headers["content-security-policy"].split("; "))
        assert policy.pop("default-src") == policy.pop("base-uri") == policy.pop("form-action") == "'none'"
        assert policy.pop("frame-ancestors") == "'none'"
        assert set(policy.values()) == {"'self'"}
        assert {name: headers[name] for name in SECURITY_HEADERS} == SECURITY_HEADERS
        assert "access-control-allow-origin" not in headers


def test_answers_of_the_moment_are_not_kept_by_anybody(published: Published) -> None:
    """A fix from a cache would be an old one with a young age. The page's own files are asked for anew each time."""
    published.answered(answer_of(bundle_id(1)))
    of_the_moment = (
        "/fix", "/status", "/log", "/track", "/metrics", "/bundles", f"/bundles/{bundle_id(1)}/fix", "/nothing",
    )  # fmt: skip
    for path in of_the_moment:
        assert published.client.get(path).headers["cache-control"] == "no-store", path
    refused = published.client.get("/status", headers={"Host": "evil.example"})
    assert refused.headers["cache-control"] == "no-store"
    for path in ("/", "/page/app.js"):
        assert published.client.get(path).headers["cache-control"] == "no-cache", path


# ---- guesses


class Clock:
    """Time that passes only while somebody sleeps."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now_s = 1000.0
        monkeypatch.setattr("rig.daemon.http.access_control.time.monotonic", lambda: self.now_s)
        monkeypatch.setattr("rig.daemon.http.access_control.asyncio.sleep", self.sleep)

    async def sleep(self, seconds: float) -> None:
        assert seconds <= 0.25  # as often it is looked whether the client is still there
        self.now_s += seconds


class Client:
    """One that shows a wrong token, and leaves after a while."""

    def __init__(self, clock: Clock, leaves_s: float = math.inf) -> None:
        self.clock, self.leaves_s = clock, leaves_s
        self.client = SimpleNamespace(host="192.168.1.66")

    async def is_disconnected(self) -> bool:
        return self.clock.now_s >= self.leaves_s


def delay_s(check: Any, clock: Clock, client: Client | None = None, shown: str = "wrong") -> float:
    """How long the answer to a token takes."""
    before_s = clock.now_s
    credentials = HTTPAuthorizationCredentials(scheme="Bearer", credentials=shown)
    with nullcontext() if shown == TOKEN else pytest.raises(HTTPException) as refused:
        asyncio.run(check(client or Client(clock), credentials))
    assert refused is None or refused.value.status_code == 401
    return clock.now_s - before_s


def test_each_wrong_token_doubles_the_delay_up_to_3_s_and_a_minute_of_peace_ends_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clock, counted = Clock(monkeypatch), list[str]()
    check = token_check(TOKEN, counted.append)
    delays_s = [delay_s(check, clock) for _ in range(7)]
    assert delays_s == pytest.approx([0.1, 0.2, 0.4, 0.8, 1.6, 3.0, 3.0])
    assert delay_s(check, clock, shown=TOKEN) == 0.0, "the right one is not held up"
    assert counted == ["wrong tokens"] * 7
    clock.now_s += 57.0 - 0.1  # less than 60 since the last one was shown
    assert delay_s(check, clock) == pytest.approx(3.0)
    clock.now_s += 57.0 + 0.1
    assert delay_s(check, clock) == pytest.approx(0.1)


def test_a_client_that_has_left_does_not_keep_its_place_busy(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Clock(monkeypatch)
    check = token_check(TOKEN)
    for _ in range(6):
        delay_s(check, clock)
    assert delay_s(check, clock, Client(clock, clock.now_s + 1.0)) == pytest.approx(1.0)


def test_wrong_tokens_are_answered_one_after_the_other_within_15_s(monkeypatch: pytest.MonkeyPatch) -> None:
    """Clients that leave at once: the next one waits for the turns that they have taken."""
    clock = Clock(monkeypatch)
    check = token_check(TOKEN)
    for _ in range(3):
        assert delay_s(check, clock, Client(clock, clock.now_s)) == 0.0
    assert delay_s(check, clock) == pytest.approx(0.1 + 0.2 + 0.4 + 0.8)
    for _ in range(30):
        delay_s(check, clock, Client(clock, clock.now_s))
    assert delay_s(check, clock) == pytest.approx(15.0)


def test_wrong_tokens_are_logged_once_a_minute_with_their_number(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    clock = Clock(monkeypatch)
    check = token_check(TOKEN)
    for _ in range(4):
        delay_s(check, clock, Client(clock, clock.now_s))
    clock.now_s += 60.5
    delay_s(check, clock)
    assert caplog.messages == [
        f"wrong token over HTTP from 192.168.1.66; {number} since the last such line" for number in (1, 4)
    ]


# ---- the rest


def test_the_page_is_there_with_all_that_it_names(published: Published) -> None:
    asked, wanted = set(), {"/"}
    while wanted - asked:
        path = min(wanted - asked)
        asked.add(path)
        response = published.client.get(path)
        assert response.status_code == 200, path
        assert response.headers["cache-control"] == "no-cache"
        wanted |= set(re.findall(r'(?:href|src)="(/page/[^"]+)"', response.text))
        wanted |= {f"/page/{name}" for name in re.findall(r'from "\./([^"]+)"', response.text)}
        assert not re.search(r"https?://(?!www\.w3\.org/)", response.text), path
    assert {"/page/style.css", "/page/app.js", "/page/map.js", "/page/words.js"} <= asked


def test_the_metrics_tell_counts_ages_and_devices_and_no_age_where_there_is_no_fix(
    published: Published,
) -> None:
    published.daemon_state.set_device("camera", "failing", "gone")
    published.daemon_state.count("captures failed", 3)
    text = published.client.get("/metrics").text
    assert 'skyfix_device{device="camera",state="failing"} 1.0' in text
    assert 'skyfix_happened_total{what="captures failed"} 3.0' in text
    assert "skyfix_fix_age_seconds" not in text

    published.answered(answer_of(bundle_id(1), age_s=40.0))
    for _ in range(2):  # at the first time already, and counted once
        text = published.client.get("/metrics").text
        assert "skyfix_answer_delay_seconds_count 1.0" in text
        assert "_created" not in text
    values = dict(line.rsplit(" ", 1) for line in text.splitlines() if not line.startswith("#"))
    assert 40.0 <= float(values["skyfix_fix_age_seconds"]) < 100.0
    assert float(values["skyfix_answer_delay_seconds_sum"]) == pytest.approx(20.0, abs=1.0)
    assert float(values["skyfix_answer_delay_seconds_count"]) == 1.0
    assert float(values['skyfix_search_seconds_sum{part="refine"}']) == pytest.approx(0.4)


def test_a_map_that_cannot_be_drawn_is_reported_in_one_line(spool: Spool, tmp_path: Path) -> None:
    published = Published(spool, dem=tmp_path / "gone.tif")
    with published.client:
        response = published.client.get("/map")
    assert response.status_code == 503
    assert "gone.tif" in response.json()["detail"]
    assert "Traceback" not in response.text


def test_an_unreadable_spool_is_reported_in_one_line(
    published: Published, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(limit: int, before: int | None = None) -> list[Entry]:
        raise SpoolError("spool/index.sqlite: disk I/O error; look at the disk")

    monkeypatch.setattr(published.spool, "entries", broken)
    response = published.client.get("/bundles")
    assert response.status_code == 503
    assert "index.sqlite: disk I/O error" in response.json()["detail"]


def test_openapi_knows_every_path_and_what_it_answers(published: Published) -> None:
    paths = published.get("/openapi.json")["paths"]
    assert set(paths) == {
        "/fix",
        "/status",
        "/events",
        "/log",
        "/capture",
        "/map",
        "/map/relief.webp",
        "/track",
        "/metrics",
        "/bundles",
        "/bundles/{bundle_id}",
        "/bundles/{bundle_id}/frames/{file_name}",
        "/bundles/{bundle_id}/skylines",
        "/bundles/{bundle_id}/fix",
    }
    assert paths["/capture"]["post"]["security"]
    for path, methods in paths.items():
        for method in methods.values():
            for status, response in method["responses"].items():
                assert response.get("content"), (path, status)


def test_no_more_streams_are_served_than_can_be() -> None:
    event_streams = EventStreams(DaemonState())
    with ExitStack() as held:
        for _ in range(MAX_STREAMS):
            held.enter_context(event_streams.stream())
        with pytest.raises(TooManyStreamsError), event_streams.stream():
            pass
    with event_streams.stream():
        assert event_streams.streams == 1
