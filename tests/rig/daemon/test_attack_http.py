"""The server asked by attackers and by programs that do not know it, over real sockets and in raw bytes."""

import logging
import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from importlib.metadata import version
from pathlib import Path

import httpx2 as httpx
import pytest
from fakes.located import ScriptedActions, answer_of, bundle_id, write_bundle
from fastapi.testclient import TestClient
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from localizer.track.tracker import Tracker
from rig.config.run import HttpServer
from rig.daemon.heartbeat import Heartbeats
from rig.daemon.http import serving
from rig.daemon.http.access_control import LONGEST_DELAY_S
from rig.daemon.http.app import make_app
from rig.daemon.http.event_streams import EventStreams
from rig.daemon.http.idle_timeout import MAX_WAITING
from rig.daemon.http.map import ReliefMap
from rig.daemon.http.request_limits import MAX_BODY_BYTES
from rig.daemon.spool.store import Spool
from rig.daemon.state import DaemonState

SANTA_CRUZ = Path(__file__).parents[3] / "sim" / "terrain" / "santa_cruz_srtm_1s.tif"
TOKEN = "0123456789abcdef0123456789abcdef"
BEARER = {"Authorization": f"Bearer {TOKEN}"}
PATIENCE_S = 20.0
HEAD = b"POST /capture HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer " + TOKEN.encode() + b"\r\n"


class Server:
    """The real application on a real socket."""

    def __init__(
        self, url: str, actions: ScriptedActions, daemon_state: DaemonState, heartbeats: Heartbeats
    ) -> None:
        self.url, self.actions, self.daemon_state, self.heartbeats = url, actions, daemon_state, heartbeats

    @contextmanager
    def connected(self) -> Iterator[socket.socket]:
        address = httpx.URL(self.url)
        with socket.create_connection((address.host, address.port or 80), PATIENCE_S) as client:
            yield client

    def answer_to(self, *parts: bytes) -> bytes:
        """The answer, until the server closes the connection or pauses."""
        with self.connected() as client:
            heard = b""
            try:
                for part in parts:
                    client.sendall(part)
                client.settimeout(0.25)
                while part := client.recv(1 << 16):
                    heard += part
            except (TimeoutError, ConnectionError):
                pass
            return heard

    def lives(self) -> bool:
        return httpx.get(f"{self.url}/healthz", timeout=PATIENCE_S).status_code == 200


@contextmanager
def served(folder: Path) -> Iterator[Server]:
    (folder / "token").write_text(TOKEN)
    (folder / "token").chmod(0o600)
    daemon_state, heartbeats, actions = DaemonState(), Heartbeats(), ScriptedActions()
    with Spool(folder / "spool", 100) as spool:
        answer = answer_of(bundle_id(1))
        write_bundle(spool.bundles_dir, answer.bundle)
        spool.reconcile()
        spool.set_answer(answer, Tracker())
        daemon_state.set_answer(answer)
        section = HttpServer(listen="127.0.0.1:0", token_file=folder / "token")
        with serving(section, daemon_state, actions, spool, [SANTA_CRUZ], heartbeats) as url:
            yield Server(url, actions, daemon_state, heartbeats)


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """For tests whose traces do not matter to each other."""
    with served(tmp_path_factory.mktemp("attack")) as server:
        yield server


@pytest.fixture
def fresh_server(tmp_path: Path) -> Iterator[Server]:
    """One that has heard nothing yet."""
    with served(tmp_path) as server:
        yield server


def test_a_body_larger_than_any_request_has_is_answered_413_and_not_taken_in(server: Server) -> None:
    """As it claims to be, in chunks without a claim, and to a path that takes none."""
    asked = len(server.actions.asked)
    claimed = HEAD + b"Content-Length: 6000000000\r\n\r\n"
    assert server.answer_to(claimed).startswith(b"HTTP/1.1 413")
    chunked = HEAD + b"Transfer-Encoding: chunked\r\n\r\n"
    chunk = b"8000\r\n" + bytes(0x8000) + b"\r\n"
    assert server.answer_to(chunked, *[chunk] * 3).startswith(b"HTTP/1.1 413")
    get = b"GET /status HTTP/1.1\r\nHost: localhost\r\nContent-Length: 70000\r\n\r\n"
    assert server.answer_to(get).startswith(b"HTTP/1.1 413")
    too_much = httpx.post(f"{server.url}/capture", headers=BEARER, content=bytes(MAX_BODY_BYTES + 1))
    assert too_much.status_code == 413
    assert len(server.actions.asked) == asked
    assert httpx.post(f"{server.url}/capture", headers=BEARER, content=b"{}").status_code == 202


def test_who_goes_on_sending_after_413_is_cut_off(server: Server) -> None:
    with server.connected() as client, pytest.raises(ConnectionError):  # noqa: PT012
        client.sendall(HEAD + b"Content-Length: 6000000000\r\n\r\n")
        for _ in range(2000):
            client.sendall(bytes(1 << 20))


def test_a_host_that_is_not_known_does_not_have_its_body_taken_in(server: Server) -> None:
    evil = b"POST /capture HTTP/1.1\r\nHost: evil.example\r\nContent-Length: 6000000000\r\n\r\n"
    answer = server.answer_to(evil)
    assert answer.startswith(b"HTTP/1.1 421")
    assert b"connection: close" in answer.lower()


@pytest.mark.parametrize(
    "lies",
    [
        b"Content-Length: -1\r\n\r\n",
        b"Content-Length: 1e9\r\n\r\n",
        b"Content-Length: 5\r\nContent-Length: 6\r\n\r\nhello",
        b"Content-Length: 99999999999999999999999\r\n\r\n",
        b"Transfer-Encoding: gzip\r\n\r\n",
        b"Transfer-Encoding: chunked\r\n\r\nzz\r\n",
        b"Transfer-Encoding: chunked\r\n\r\nffffffffffffffffffff\r\n",
        b"X-Long: " + b"a" * 200_000 + b"\r\n\r\n",
        b"".join(b"X-%d: y\r\n" % number for number in range(20_000)) + b"\r\n",
    ],
)
def test_lies_about_the_body_and_heaps_of_headers_are_refused(server: Server, lies: bytes) -> None:
    asked = len(server.actions.asked)
    answer = server.answer_to(HEAD + lies)
    assert answer == b"" or answer.split()[1] in (b"400", b"413", b"431", b"501")
    assert len(server.actions.asked) == asked
    assert server.lives()


def test_a_body_that_does_not_end_is_answered_408(server: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rig.daemon.http.request_limits.BODY_TIMEOUT_S", 0.2)
    with server.connected() as client:
        client.sendall(HEAD + b"Content-Length: 10\r\n\r\n")
        begun = time.monotonic()
        client.sendall(b"a")
        assert client.recv(12) == b"HTTP/1.1 408"
        assert time.monotonic() - begun < 5.0


def test_connections_that_ask_nothing_do_not_keep_others_out(server: Server) -> None:
    with ExitStack() as held:
        for _ in range(2 * MAX_WAITING):
            held.enter_context(server.connected()).sendall(b"GET /status HTTP/1.1\r\nX-Slow: ")
        assert httpx.get(f"{server.url}/status", timeout=PATIENCE_S).status_code == 200


def test_head_is_answered_as_get_without_a_body_everywhere(server: Server) -> None:
    document = httpx.get(f"{server.url}/openapi.json").json()
    slow = ("/map", "/map/relief.webp")  # a picture is drawn for them; they are as the others
    paths = [path for path, methods in document["paths"].items() if "get" in methods and path not in slow]
    assert len(paths) > 7
    for path in [*paths, "/", "/page/page.js", "/healthz", "/openapi.json", "/nothing"]:
        url = server.url + path.replace("{bundle_id}", bundle_id(1)).replace("{file_name}", "N.png")
        head = httpx.head(url, timeout=PATIENCE_S)
        assert head.content == b""
        if path != "/events":
            got = httpx.get(url, timeout=PATIENCE_S)
            assert head.status_code == got.status_code
            assert head.headers["content-type"] == got.headers["content-type"]
            assert path in ("/status", "/fix", "/log", "/metrics") or (
                head.headers["content-length"] == got.headers["content-length"]
            )
        else:
            assert (head.status_code, head.headers["content-type"][:17]) == (200, "text/event-stream")
    assert httpx.head(f"{server.url}/capture").status_code == 405
    refused = httpx.put(f"{server.url}/status")
    assert (refused.status_code, refused.headers["allow"]) == (405, "GET, HEAD")


def test_after_head_the_connection_goes_on(server: Server) -> None:
    with httpx.Client(base_url=server.url) as client:
        for path in ("/events", "/status", "/fix"):
            assert client.head(path).status_code == 200
            assert client.get("/status").json()["activity"] == "starting"


def test_wrong_tokens_are_delayed_counted_and_logged_at_a_limited_rate(
    fresh_server: Server, caplog: pytest.LogCaptureFixture
) -> None:
    server = fresh_server
    begun = time.monotonic()
    with caplog.at_level(logging.WARNING):
        for guess in range(5):
            answer = httpx.post(
                f"{server.url}/capture", headers={"Authorization": f"Bearer {guess}"}, timeout=60
            )
            assert answer.status_code == 401
    assert time.monotonic() - begun > 1.5
    told = [record.getMessage() for record in caplog.records if "wrong token" in record.getMessage()]
    assert len(told) == 1
    assert "127.0.0.1" in told[0]
    assert TOKEN not in told[0]
    assert server.daemon_state.snapshot().counts["wrong tokens"] == 5
    begun = time.monotonic()
    assert httpx.post(f"{server.url}/capture", headers=BEARER).status_code == 202
    assert time.monotonic() - begun < LONGEST_DELAY_S, "the right one does not wait for those who guess"


GUESS = b"POST /capture HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer a-wrong-one\r\nContent-Length: 0\r\n\r\n"


@pytest.mark.parametrize(
    "slow", [GUESS, HEAD + b"Content-Length: 10\r\n\r\n"], ids=["wrong tokens", "bodies that do not end"]
)
def test_slow_requests_do_not_lock_others_out(server: Server, slow: bytes) -> None:
    """While they wait, and as many after they have gone: their places are free again."""
    with ExitStack() as stack:
        for _ in range(MAX_WAITING + 4):
            stack.enter_context(server.connected()).sendall(slow)
            time.sleep(0.01)
        assert server.lives()
        assert httpx.post(f"{server.url}/capture", headers=BEARER).status_code == 202
    for _ in range(80):
        with server.connected() as client:
            client.sendall(slow)
            time.sleep(0.01)
    time.sleep(0.5)
    assert server.lives()
    assert httpx.post(f"{server.url}/capture", headers=BEARER).status_code == 202


def test_who_reads_a_stream_stays_when_many_come(server: Server) -> None:
    with server.connected() as reader, ExitStack() as stack:
        reader.sendall(b"GET /events HTTP/1.1\r\nHost: localhost\r\n\r\n")
        assert b"200 OK" in reader.recv(4096)
        for _ in range(4 * MAX_WAITING):
            stack.enter_context(server.connected()).sendall(GUESS)
        assert server.lives()  # although those that had to go have not noticed it yet
        server.daemon_state.emit("status", still="there")
        heard = b""
        while b"still" not in heard:
            heard += reader.recv(4096)


def test_healthz_tells_life_and_readiness_apart(server: Server) -> None:
    told = httpx.get(f"{server.url}/healthz").json()
    assert told == {
        "alive": True,
        "ready": False,
        "version": version("skyfix"),
        "problems": ["still starting"],
    }
    with server.heartbeats.watched("search", 0.0):
        time.sleep(0.01)
        answer = httpx.get(f"{server.url}/healthz")
        assert answer.status_code == 503
        assert answer.json()["alive"] is False
        assert answer.json()["problems"][0].startswith("search hangs")
    assert server.lives()


def test_the_version_is_the_packages(server: Server) -> None:
    assert httpx.get(f"{server.url}/openapi.json").json()["info"]["version"] == version("skyfix")
    assert httpx.get(f"{server.url}/status").json()["version"] == version("skyfix")


def test_not_ready_is_answered_with_the_reason(tmp_path: Path) -> None:
    daemon_state, actions = DaemonState(), ScriptedActions("not ready")
    daemon_state.set_activity("idle")
    daemon_state.set_device("camera", "failing", "/dev/video0: no such device; plug it in")
    with Spool(tmp_path / "spool", 100) as spool:
        app = make_app(
            HttpServer(),
            daemon_state,
            actions,
            spool,
            EventStreams(daemon_state),
            ReliefMap([SANTA_CRUZ]),
            TOKEN,
        )
        with TestClient(app, base_url="http://localhost") as client:
            answer = client.post("/capture", headers=BEARER)
            assert answer.status_code == 503
            assert answer.json()["detail"] == "not ready: camera: /dev/video0: no such device; plug it in"


@pytest.mark.parametrize(
    "path",
    [
        "/page/../app.py", "/page/..%2fapp.py", "/page/%2e%2e/%2e%2e/command.py", "/page//etc/passwd", "/bundles/..",
        "/bundles/%2e%2e/skylines", "/bundles/..%2f..%2fetc%2fpasswd", "/bundles/.hidden", "/bundles/a%00b",
        "/bundles/{id}/frames/..%2fbundle.json", "/bundles/{id}/frames/%2e%2e", "/bundles/" + "a" * 5000,
    ],
)  # fmt: skip
def test_paths_lead_nowhere_else(server: Server, path: str) -> None:
    asked = f"GET {path.replace('{id}', bundle_id(1))} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n".encode()
    assert server.answer_to(asked).split()[1] in (b"400", b"404", b"405", b"422")


PIECES = [
    b"GET ", b"POST ", b"HEAD ", b"/status", b"/capture", b"/events", b"/bundles/x", b" HTTP/1.1\r\n", b" HTTP/1.0\r\n",
    b"Host: localhost\r\n", b"Host: evil\r\n", b"Content-Length: 5\r\n", b"Transfer-Encoding: chunked\r\n", b"\r\n",
    b"Authorization: Bearer x\r\n", b"0\r\n\r\n", b"5\r\nhello\r\n", b"Expect: 100-continue\r\n", b"Connection: close\r\n",
    b"Upgrade: websocket\r\nConnection: Upgrade\r\n", b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n", b"\x16\x03\x01\x02\x00",
]  # fmt: skip


@settings(max_examples=40, deadline=None, suppress_health_check=list(HealthCheck))
@given(parts=st.lists(st.sampled_from(PIECES) | st.binary(max_size=20), min_size=1, max_size=12))
def test_any_bytes_leave_the_server_as_it_was(server: Server, parts: list[bytes]) -> None:
    with server.connected() as client:
        try:
            client.sendall(b"".join(parts))
            client.shutdown(socket.SHUT_WR)
            client.settimeout(0.05)
            heard = client.recv(1 << 16)
        except (TimeoutError, ConnectionError):
            heard = b""
        assert b" 500 " not in heard[:20]
    assert server.lives()
