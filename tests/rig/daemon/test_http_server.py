"""The server as a daemon has it: a thread, a real socket, streams that end with it."""

import json
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import httpx2 as httpx
import pytest
from fakes.located import ScriptedActions, answer_of, bundle_id

from rig.config.run import HttpServer
from rig.daemon.heartbeat import Heartbeats
from rig.daemon.http import serving
from rig.daemon.http.event_streams import MAX_STREAMS
from rig.daemon.http.server import HttpError
from rig.daemon.spool.store import Spool
from rig.daemon.state import DaemonState

SANTA_CRUZ = Path(__file__).parents[3] / "sim" / "terrain" / "santa_cruz_srtm_1s.tif"
WAIT_S = 60.0


@pytest.fixture
def spool(tmp_path: Path) -> Iterator[Spool]:
    with Spool(tmp_path / "spool", 100) as spool:
        yield spool


@contextmanager
def served(spool: Spool, daemon_state: DaemonState, listen: str = "127.0.0.1:0") -> Iterator[str]:
    with serving(HttpServer(listen=listen), daemon_state, ScriptedActions(), spool, [SANTA_CRUZ]) as url:
        yield url


def wait_for(met: Callable[[], bool]) -> None:
    until = time.monotonic() + WAIT_S
    while not met():
        assert time.monotonic() < until
        time.sleep(0.02)


class Listener:
    """Reads /events; ``ended`` once the server has ended the stream."""

    def __init__(self, url: str, headers: dict[str, str | bytes] | None = None) -> None:
        self.lines: list[str] = []
        self.ended = False
        self._headers = headers or {}
        self._thread = threading.Thread(target=self._read, args=(url,), daemon=True)
        self._thread.start()
        wait_for(lambda: ": skyfix" in self.lines)

    def _read(self, url: str) -> None:
        with httpx.stream("GET", f"{url}/events", timeout=WAIT_S, headers=self._headers) as response:
            for line in response.iter_lines():
                self.lines.append(line)
        self.ended = True

    def events(self) -> list[dict[str, object]]:
        return [json.loads(line.removeprefix("data: ")) for line in self.lines if line.startswith("data: ")]


def test_events_reach_all_who_listen_in_order_and_streams_end_with_the_server(spool: Spool) -> None:
    daemon_state = DaemonState()
    with served(spool, daemon_state) as url:
        listeners = [Listener(url), Listener(url)]
        daemon_state.set_device("camera", "failing", "no picture")
        daemon_state.set_answer(answer_of(bundle_id(1)))
        wait_for(lambda: all(len(listener.events()) == 2 for listener in listeners))
        log = httpx.get(f"{url}/log").json()
    for listener in listeners:
        wait_for(lambda listener=listener: listener.ended)  # type: ignore[misc]
        assert listener.events() == log
        assert [event["kind"] for event in log] == ["device", "answer"]
        assert log[0]["data"] == {"name": "camera", "state": "failing", "detail": "no picture"}
        assert "event: device" in listener.lines


def test_a_stream_that_starts_during_a_fix_begins_with_it(spool: Spool) -> None:
    daemon_state = DaemonState()
    with served(spool, daemon_state) as url:
        early = Listener(url)
        daemon_state.set_answer(answer_of(bundle_id(1)))
        daemon_state.set_device("camera", "ok", "here")
        wait_for(lambda: len(early.events()) == 2)
        late = Listener(url)
        wait_for(lambda: len(late.events()) == 1)
        daemon_state.set_device("camera", "failing", "gone")
        wait_for(lambda: len(late.events()) == 2)
        assert [event["kind"] for event in late.events()] == ["answer", "device"]
        assert late.events()[0]["data"] == {"bundle": bundle_id(1), "status": "fix", "mode": "whole DEM"}


def test_a_reconnected_stream_gets_the_missed_events(spool: Spool) -> None:
    daemon_state = DaemonState()
    with served(spool, daemon_state) as url:
        early = Listener(url)
        for number in range(5):
            daemon_state.emit("log", level="info", text=f"line {number}")
        wait_for(lambda: len(early.events()) == 5)
        numbers = [event["number"] for event in early.events()]
        back = Listener(url, {"Last-Event-ID": str(numbers[2])})
        wait_for(lambda: len(back.events()) == 2)
        assert [event["number"] for event in back.events()] == numbers[3:]
        for nonsense in ("99999", "-1", "one", "\N{ARABIC-INDIC DIGIT ONE}".encode("utf-8")):
            assert Listener(url, {"Last-Event-ID": nonsense}).events() == []


def test_a_stream_beyond_the_limit_is_refused_until_one_ends(spool: Spool) -> None:
    with served(spool, DaemonState()) as url, ExitStack() as held:
        address = httpx.URL(url)
        readers = []
        for _ in range(MAX_STREAMS):
            reader = held.enter_context(socket.create_connection((address.host, address.port)))
            reader.sendall(b"GET /events HTTP/1.1\r\nHost: localhost\r\n\r\n")
            assert reader.recv(12) == b"HTTP/1.1 200"
            readers.append(reader)
        refused = httpx.get(f"{url}/events")
        assert refused.status_code == 503
        assert refused.headers["retry-after"] == "5"
        readers[0].close()

        def room() -> bool:
            with httpx.stream("GET", f"{url}/events") as response:
                return response.status_code == 200

        wait_for(room)


def test_a_reader_that_takes_nothing_does_not_delay_others(spool: Spool) -> None:
    daemon_state = DaemonState()
    with served(spool, daemon_state) as url:
        address = httpx.URL(url)
        with socket.create_connection((address.host, address.port)) as deaf:
            deaf.sendall(b"GET /events HTTP/1.1\r\nHost: localhost\r\n\r\n")
            listener = Listener(url)
            for number in range(2000):
                daemon_state.emit("log", message="x" * 4000, number=number)
                if number % 50 == 0:
                    wait_for(lambda number=number: len(listener.events()) > number - 50)  # type: ignore[misc]
            wait_for(lambda: len(listener.events()) == 2000)
            assert httpx.get(f"{url}/status").status_code == 200


def test_signals_stay_the_daemons(spool: Spool) -> None:
    before = signal.getsignal(signal.SIGTERM), signal.getsignal(signal.SIGINT)
    with served(spool, DaemonState()) as url:
        assert httpx.get(f"{url}/status").status_code == 200
        assert (signal.getsignal(signal.SIGTERM), signal.getsignal(signal.SIGINT)) == before


def test_nothing_is_left_once_it_has_ended(spool: Spool) -> None:
    before = {thread.ident for thread in threading.enumerate()}
    with served(spool, DaemonState()) as url:
        listener = Listener(url)
        httpx.get(f"{url}/bundles")
    wait_for(lambda: listener.ended)
    wait_for(lambda: {thread.ident for thread in threading.enumerate()} <= before)
    with pytest.raises(httpx.ConnectError):
        httpx.get(f"{url}/status")


def test_its_loop_proves_that_it_gets_on_while_it_serves(spool: Spool) -> None:
    heartbeats = Heartbeats()
    with serving(
        HttpServer(listen="127.0.0.1:0"), DaemonState(), ScriptedActions(), spool, [SANTA_CRUZ], heartbeats
    ) as url:
        assert httpx.get(f"{url}/status").status_code == 200
        heartbeats.beat("http", within_s=0.0)
        wait_for(lambda: bool(heartbeats.stalled()))
        wait_for(lambda: not heartbeats.stalled())
    with pytest.raises(KeyError):
        heartbeats.beat("http")


def test_an_address_in_use_is_reported_in_one_line(spool: Spool) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        listen = f"127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(HttpError, match=f"listen {listen}.*in use"), served(spool, DaemonState(), listen):
            pass


def test_it_listens_on_ipv6_too(spool: Spool) -> None:
    with served(spool, DaemonState(), "[::1]:0") as url:
        assert url.startswith("http://[::1]:")
        assert httpx.get(f"{url}/status").status_code == 200


def test_the_map_shows_the_whole_dem_in_its_metric_crs(spool: Spool) -> None:
    with served(spool, DaemonState()) as url:
        sheet = httpx.get(f"{url}/map", timeout=WAIT_S).json()
        picture = httpx.get(url + sheet["image"])
    assert sheet["crs"] == "EPSG:32610"
    assert sheet["west_m"] < 574_000 < sheet["east_m"]
    assert sheet["south_m"] < 4_120_000 < sheet["north_m"]
    assert picture.headers["content-type"] == "image/webp"
    assert picture.content[8:12] == b"WEBP"


def test_connections_over_which_nothing_is_asked_are_cut_off_and_streams_are_not(
    spool: Spool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rig.daemon.http.idle_timeout.REQUEST_TIMEOUT_S", 0.3)
    daemon_state = DaemonState()
    with served(spool, daemon_state) as url, ExitStack() as stack:
        host, port = url.removeprefix("http://").split(":")
        listener = Listener(url)
        for begun in (b"", b"GET /status HT", b"GET /status HTTP/1.1\r\nHost: localhost\r\n"):
            client = stack.enter_context(socket.create_connection((host, int(port)), WAIT_S))
            client.sendall(begun)
            assert client.recv(100) == b""
        assert not listener.ended
        daemon_state.set_device("camera", "ok", "here")
        wait_for(lambda: len(listener.events()) == 1)
        asked = stack.enter_context(socket.create_connection((host, int(port)), WAIT_S))
        asked.sendall(b"GET /status HTTP/1.1\r\nHost: localhost\r\n\r\n")
        assert asked.recv(12) == b"HTTP/1.1 200"
