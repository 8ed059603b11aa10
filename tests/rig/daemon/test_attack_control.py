"""The control socket and the daemon's requests: no client blocks or ends the daemon, and answers are correct."""

import json
import os
import queue
import shutil
import socket
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import ExitStack
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from click.testing import CliRunner
from fakes.attacks import BOM, JSON_ATTACKS, TOML_ATTACKS
from fakes.located import write_bundle
from fakes.timebases import FastClock, on
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from rig.commands.cli import rig
from rig.config.load import load_config
from rig.daemon import control as control_module
from rig.daemon.control import CLIENT_TIMEOUT_S, MAX_CLIENTS, ControlError, ControlSocket, send_request
from rig.daemon.heartbeat import Heartbeats
from rig.daemon.main_loop import MainLoop
from rig.daemon.named_files import check_named_files
from rig.daemon.notify import Notifier
from rig.daemon.runtime import _why_not_ready
from rig.daemon.spool.store import Spool
from rig.daemon.state import DaemonState
from rig.daemon.status import status_json, status_text
from rig.daemon.triggers import Triggers
from rig.errors import ConfigError

EXAMPLE = Path(__file__).parents[3] / "configs" / "vehicle.toml"
PATIENCE_S = 30.0

SPEED = 20.0
"""So fast runs the clock by which the loop looks whether it shall end, and proves that it gets on."""


class Listening:
    """A control socket that is served, and whose loop is watched."""

    def __init__(self, path: Path, why_not_ready: Callable[[], str | None] = lambda: None) -> None:
        self.path, self.daemon_state, self.heartbeats = path, DaemonState(), Heartbeats()
        self._stop = threading.Event()
        triggers = Triggers(self.daemon_state, why_not_ready, lambda source: None)
        self._listener = ControlSocket(path, self.daemon_state, triggers)
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def _serve(self) -> None:
        with self.heartbeats.watched("control", 1.0 * SPEED):
            self._listener.run(lambda: self.heartbeats.beat("control"), self._stop)

    def end(self) -> None:
        self._stop.set()
        self._thread.join()
        self._listener.close()

    def say(self, content: bytes) -> bytes:
        """What it answers to these bytes, after which nothing comes."""
        with socket.socket(socket.AF_UNIX) as client:
            client.settimeout(PATIENCE_S)
            client.connect(str(self.path))
            try:
                client.sendall(content)
                client.shutdown(socket.SHUT_WR)
                return client.makefile("rb").readline()
            except ConnectionError:  # it has heard enough
                return b'{"error": ""}'

    def lives(self) -> bool:
        begun_s = time.monotonic()
        answers = send_request(self.path, "status", PATIENCE_S)["activity"] == "starting"
        return answers and time.monotonic() - begun_s < CLIENT_TIMEOUT_S / 2 and not self.heartbeats.stalled()


@pytest.fixture
def listening(tmp_path: Path) -> Iterator[Listening]:
    with on(FastClock(SPEED)):
        listening = Listening(tmp_path / "control.sock")
        yield listening
        listening.end()


@pytest.mark.parametrize("attack", JSON_ATTACKS)
def test_documents_that_are_attacks_are_answered(listening: Listening, attack: str) -> None:
    assert "error" in json.loads(listening.say(JSON_ATTACKS[attack][:4000] + b"\n"))
    assert listening.lives()


def test_a_slow_client_delays_no_other_and_is_dropped(
    listening: Listening, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(control_module, "CLIENT_TIMEOUT_S", 0.6)
    with socket.socket(socket.AF_UNIX) as slow, pytest.raises(ConnectionError):  # noqa: PT012
        slow.connect(str(listening.path))
        begun_s = time.monotonic()
        while time.monotonic() - begun_s < PATIENCE_S:
            slow.sendall(b"[")
            assert listening.lives()
            time.sleep(0.1)
    assert time.monotonic() - begun_s < 5.0, "the deadline is for all that it sends"


def test_many_silent_clients_do_not_lock_others_out(listening: Listening) -> None:
    silent = [socket.socket(socket.AF_UNIX) for _ in range(3 * MAX_CLIENTS)]
    try:
        for each in silent:
            each.settimeout(PATIENCE_S)
            each.connect(str(listening.path))
        assert listening.lives()
    finally:
        for each in silent:
            each.close()


def test_who_comes_with_many_others_comes_again_until_there_is_room(tmp_path: Path) -> None:
    """A Unix socket whose backlog is full refuses at once: EAGAIN, whatever timeout there is."""
    path = tmp_path / "full"
    with ExitStack() as stack:
        server = stack.enter_context(socket.socket(socket.AF_UNIX))
        server.bind(str(path))
        server.listen(0)

        def serve() -> None:
            time.sleep(0.3)
            server.settimeout(PATIENCE_S)
            for _ in range(2):
                client, _ = server.accept()
                stack.callback(client.close)
            client.recv(4096)
            client.sendall(b'{"answer": "started"}\n')

        first = stack.enter_context(socket.socket(socket.AF_UNIX))
        first.connect(str(path))
        serving = threading.Thread(target=serve)
        serving.start()
        stack.callback(serving.join)
        assert send_request(path, "trigger", PATIENCE_S) == {"answer": "started"}
    with socket.socket(socket.AF_UNIX) as server, socket.socket(socket.AF_UNIX) as first:
        server.bind(str(tmp_path / "stays full"))
        server.listen(0)
        first.connect(str(tmp_path / "stays full"))
        with pytest.raises(ControlError, match="does not answer"):
            send_request(tmp_path / "stays full", "trigger", 0.3)


def test_who_asks_much_and_reads_nothing_is_cut_off(
    listening: Listening, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(control_module, "CLIENT_TIMEOUT_S", 0.3)
    listening.daemon_state.set_device("camera", "failing", "x" * 3_000_000)
    with socket.socket(socket.AF_UNIX) as deaf:
        deaf.connect(str(listening.path))
        deaf.sendall(b'{"do": "status"}\n')
        time.sleep(0.8)
        assert listening.lives()
        received = b""
        while part := deaf.recv(1 << 20):
            received += part
        assert b"\n" not in received


@settings(max_examples=80, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    st.binary(max_size=60)
    | st.recursive(
        st.none() | st.booleans() | st.floats() | st.text(max_size=5) | st.sampled_from(["do", "status"]),
        lambda inner: (
            st.lists(inner, max_size=3) | st.dictionaries(st.just("do") | st.text(max_size=3), inner)
        ),
        max_leaves=5,
    ).map(lambda value: json.dumps(value).encode() + b"\n")
)
def test_any_message_is_answered(listening: Listening, message: bytes) -> None:
    answer = json.loads(listening.say(message))
    assert set(answer) & {"error", "answer", "schema"}


def test_a_file_that_is_no_socket_is_not_taken_away(tmp_path: Path) -> None:
    (tmp_path / "diary").write_text("dear diary")
    with pytest.raises(ControlError, match="something else than a socket"):
        Listening(tmp_path / "diary")
    assert (tmp_path / "diary").read_text() == "dear diary"


@pytest.mark.parametrize("answer", [b"[" * 100_000 + b"\n", b"[]\n", b"", b"x" * 9_000_000, b"trickle"])
def test_a_client_survives_the_end_of_the_daemon(tmp_path: Path, answer: bytes) -> None:
    """Another program may listen at that path."""
    ended = threading.Event()
    with socket.socket(socket.AF_UNIX) as liar:
        liar.bind(str(tmp_path / "s"))
        liar.listen()

        def lie() -> None:
            client, _ = liar.accept()
            with client:
                try:
                    while answer == b"trickle" and not ended.is_set():
                        client.sendall(b"[")
                        time.sleep(0.05)
                    client.sendall(answer)
                except OSError:
                    pass

        thread = threading.Thread(target=lie)
        thread.start()
        begun_s = time.monotonic()
        with pytest.raises(ControlError) as refusal:
            send_request(tmp_path / "s", "status", 0.5)
        ended.set()
        thread.join()
    assert time.monotonic() - begun_s < 5.0
    assert len(str(refusal.value)) < 300


# ---- honest answers


def not_ready_config(folder: Path) -> Path:
    config = folder / "vehicle.toml"
    config.write_text('[run]\ndem = ["terrain.tif"]\ncontrol = "control.sock"\n')
    return config


def test_not_ready_comes_with_the_reason(tmp_path: Path) -> None:
    listening = Listening(tmp_path / "control.sock", lambda: "camera not ready")
    try:
        listening.daemon_state.set_activity("idle")
        listening.daemon_state.set_device("camera", "failing", "/dev/video0: no such device; plug it in")
        assert send_request(listening.path, "trigger") == {
            "answer": "not ready",
            "why": "camera: /dev/video0: no such device; plug it in",
        }
        told = CliRunner().invoke(
            rig, ["trigger", "--config", str(not_ready_config(tmp_path))], standalone_mode=False
        )
        assert told.stdout.splitlines()[-1] == "not ready: camera: /dev/video0: no such device; plug it in"
        assert told.return_value == 4
    finally:
        listening.end()


def test_a_capture_that_the_reserve_of_the_disk_forbids_is_not_answered_started(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    daemon_state = DaemonState()
    daemon_state.set_activity("idle")
    with Spool(tmp_path / "spool", 100) as spool:
        triggers = Triggers(daemon_state, lambda: _why_not_ready(daemon_state, spool), lambda source: None)
        usage = shutil.disk_usage(tmp_path)
        monkeypatch.setattr(shutil, "disk_usage", lambda path: usage._replace(free=22_000_000))
        assert triggers.trigger("command") == "not ready"
        why = daemon_state.snapshot().storage
        assert why is not None
        assert "22 MB are free on its disk" in why
        assert "full" not in why
        assert str(tmp_path / "spool") in why
        assert why in status_text(status_json(daemon_state.snapshot()))
        monkeypatch.undo()
        assert triggers.trigger("command") == "started"
        assert daemon_state.snapshot().storage is None


def test_a_quota_full_of_waiting_bundles_is_reported_before_the_capture_too(tmp_path: Path) -> None:
    daemon_state = DaemonState()
    daemon_state.set_activity("idle")
    with Spool(tmp_path / "spool", 10) as spool:
        assert _why_not_ready(daemon_state, spool) is None
        folder = write_bundle(spool.bundles_dir, "20261123T043151Z-3f9a")
        (folder / "more").write_bytes(os.urandom(8_000_000))
        spool.reconcile()
        assert "quota_mb" in (_why_not_ready(daemon_state, spool) or "")
        assert len(spool.entries(5)) == 1, "asking deletes nothing"


# ---- the configuration


def a_loop(path: Path) -> tuple[MainLoop, DaemonState, "queue.SimpleQueue[Any]"]:
    """The daemon's main loop without other parts; it reloads its configuration from ``path``."""
    config = load_config(EXAMPLE)
    assert config.run
    daemon_state, terrain = DaemonState(), Future[None]()
    terrain.set_result(None)
    search = SimpleNamespace(terrain=terrain, pictures=terrain, wake=lambda: None)
    requests: queue.SimpleQueue[Any] = queue.SimpleQueue()
    triggers = Triggers(daemon_state, lambda: None, requests.put)
    parts: Any = (daemon_state, Notifier(None), triggers, SimpleNamespace(), search, None, None, requests)
    return MainLoop(config.run, path, *parts), daemon_state, requests


@pytest.mark.parametrize("attack", TOML_ATTACKS)
def test_a_configuration_that_is_an_attack_is_refused_on_sighup_and_the_daemon_goes_on(
    tmp_path: Path, attack: str
) -> None:
    (tmp_path / "vehicle.toml").write_bytes(TOML_ATTACKS[attack])
    loop, daemon_state, requests = a_loop(tmp_path / "vehicle.toml")
    requests.put("reload")
    requests.put(KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt):
        loop.run(lambda: None, lambda: None)
    assert daemon_state.snapshot().counts["configurations refused"] == 1


def test_a_missing_dem_is_reported_with_key_file_and_advice(tmp_path: Path) -> None:
    path = tmp_path / "vehicle.toml"
    path.write_bytes(BOM + EXAMPLE.read_bytes())
    config = load_config(path)
    assert config.run
    with pytest.raises(ConfigError) as refusal:
        check_named_files(config.run, path)
    told = str(refusal.value)
    assert told.startswith(f"{path}: [run] dem: {tmp_path / 'terrain.tif'}: no such file")
    assert "localizer dem info" in told
    for make, problem in ((Path.touch, "is empty"), (lambda file: file.write_bytes(b"x"), None)):
        make(tmp_path / "terrain.tif")
        if problem:
            with pytest.raises(ConfigError, match=problem):
                check_named_files(config.run, path)
        else:
            check_named_files(config.run, path)


def test_rig_run_ends_at_once_where_a_file_that_it_names_is_missing(tmp_path: Path) -> None:
    """Before any device is used: none exists here, and none is mentioned."""
    path = tmp_path / "vehicle.toml"
    text = EXAMPLE.read_text()
    path.write_text(text)
    begun_s = time.monotonic()
    told = CliRunner().invoke(rig, ["run", "--config", str(path)])
    assert isinstance(told.exception, ConfigError)
    assert "[run] dem" in str(told.exception)
    assert time.monotonic() - begun_s < 5.0
    (tmp_path / "terrain.tif").write_bytes(b"II*\0")
    path.write_text(text.replace('# token_file = "token"', 'token_file = "nowhere"'))
    told = CliRunner().invoke(rig, ["run", "--config", str(path)])
    assert "[run.http] token_file" in str(told.exception)
    assert str(path) in str(told.exception)
    (tmp_path / "spool").write_text("a file")
    path.write_text(text)
    told = CliRunner().invoke(rig, ["run", "--config", str(path)])
    assert "[run.spool] dir" in str(told.exception)
