"""The daemon's smaller parts: its log, its signals, its control socket."""

import json
import logging
import os
import signal
import socket
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
import structlog
from click.testing import CliRunner
from fakes import located

from rig.commands.cli import rig
from rig.config.run import control_socket_of_invalid_config
from rig.daemon.control import ControlError, ControlSocket, send_request
from rig.daemon.log import logging_to
from rig.daemon.signals import Signals, StopRequestedError
from rig.daemon.state import DaemonState
from rig.daemon.status import status_json, status_text
from rig.daemon.triggers import Triggers
from rig.errors import ConfigError


class TestLog:
    def lines(self, capfd: pytest.CaptureFixture[str], environment: dict[str, str]) -> list[str]:
        with logging_to(DaemonState(), environment):
            structlog.get_logger("rig.daemon.x").info("capture done", bundle="2026-a", seconds=1.5)
            structlog.get_logger("rig.daemon.x").error("search failed", reason='two\nlines and "quotes"')
            logging.getLogger("rig.other").warning("a sentence of %s", "another module")
        return capfd.readouterr().err.splitlines()

    def test_for_people_each_line_begins_with_the_time(self, capfd: pytest.CaptureFixture[str]) -> None:
        first, second, third = self.lines(capfd, {})
        assert first[20:] == " capture done bundle=2026-a seconds=1.5"
        assert first[10] == "T"
        assert second.endswith(r' error: search failed reason="two\nlines and \"quotes\""')
        assert third.endswith(" warning: a sentence of another module")

    def test_for_the_journal_with_the_priority(self, capfd: pytest.CaptureFixture[str]) -> None:
        status = os.fstat(sys.stderr.fileno())
        lines = self.lines(capfd, {"JOURNAL_STREAM": f"{status.st_dev}:{status.st_ino}"})
        assert [line[:3] for line in lines] == ["<6>", "<3>", "<4>"]
        assert lines[0] == "<6>capture done bundle=2026-a seconds=1.5"

    def test_subscribers_of_the_state_get_it(self) -> None:
        daemon_state = DaemonState()
        with daemon_state.subscribed() as events, logging_to(daemon_state, {}):
            structlog.get_logger("rig.daemon.x").warning("device fails", device="camera")
            event = events.get(1.0)
        assert event is not None
        assert (event.kind, event.data) == (
            "log",
            {"level": "warning", "text": "warning: device fails device=camera"},
        )


class TestStatus:
    def text(self, daemon_state: DaemonState) -> list[str]:
        return status_text(status_json(daemon_state.snapshot())).splitlines()

    def test_what_has_not_been_tried_yet_has_not_failed(self) -> None:
        daemon_state = DaemonState()
        daemon_state.set_device("camera", "connecting", "")
        daemon_state.set_activity("connecting")
        assert self.text(daemon_state)[:3] == [
            "connecting, nothing to locate",
            "camera        connecting",
            "last answer   none since the start",
        ]
        daemon_state.set_activity("idle")
        daemon_state.set_device("camera", "failing", "gone")
        assert self.text(daemon_state)[0] == "idle, degraded, nothing to locate"

    def test_a_fix_has_its_uncertainty_and_stays_behind_an_answer_that_is_none(self) -> None:
        daemon_state = DaemonState()
        daemon_state.set_answer(located.answer_of("a", age_s=100.0))
        daemon_state.set_answer(located.answer_of("b", "ambiguous", age_s=50.0))
        daemon_state.set_locating("c")
        daemon_state.set_waiting(2)
        first, last, fix, *counts = self.text(daemon_state)
        assert first == "starting, locating c, 2 to locate"
        assert last == "last answer   ambiguous, 3 places, 50 s old; b"
        assert fix == "last fix      fix 37.220000, -122.170000, sigma 5.8 m, 100 s old; a"
        assert counts[0].startswith("since the start at 20")
        assert counts[1:] == ["  answers ambiguous            1", "  answers fix                  1"]


class TestSignals:
    @pytest.fixture(autouse=True)
    def _lives_on(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """A process that was told to stop ends itself after some seconds; this one has other tests to do."""
        monkeypatch.setattr("rig.daemon.signals.KILL_AFTER_S", 3600.0)

    def test_a_stop_interrupts_once(self) -> None:
        with Signals() as signals:
            with pytest.raises(StopRequestedError):
                signal.raise_signal(signal.SIGTERM)
            signal.raise_signal(signal.SIGTERM)
            assert signals.stopping

    def test_what_is_shielded_is_ended_first(self) -> None:
        done = []
        with Signals() as signals:
            with pytest.raises(StopRequestedError):  # noqa: PT012, SIM117
                with signals.deferring_stop():
                    signal.raise_signal(signal.SIGINT)
                    done.append("ended")
            assert done == ["ended"]

    def test_requests_are_kept_in_order(self) -> None:
        with Signals() as signals:
            for number in (signal.SIGUSR1, signal.SIGHUP, signal.SIGUSR1):
                signal.raise_signal(number)
        assert [signals.requests.get_nowait() for _ in range(3)] == ["trigger", "reload", "trigger"]


@pytest.fixture
def control(tmp_path: Path) -> Iterator[Path]:
    path, daemon_state, stop = tmp_path / "control.sock", DaemonState(), threading.Event()
    listener = ControlSocket(path, daemon_state, Triggers(daemon_state, lambda: None, lambda source: None))
    thread = threading.Thread(target=listener.run, args=(lambda: None, stop))
    thread.start()
    yield path
    stop.set()
    thread.join()
    listener.close()
    assert not path.exists()


class TestControl:
    def test_trigger_and_status(self, control: Path) -> None:
        assert send_request(control, "trigger") == {"answer": "started"}
        assert send_request(control, "trigger") == {"answer": "busy"}
        assert send_request(control, "status")["counts"]["triggers"] == 2

    @pytest.mark.parametrize("line", [b"", b"\n", b"nonsense\n", b"[1]\n", b'{"do": 5}\n', b"x" * 100_000])
    def test_nonsense_is_answered(self, control: Path, line: bytes) -> None:
        with socket.socket(socket.AF_UNIX) as client:
            client.connect(str(control))
            try:
                client.sendall(line)
                client.shutdown(socket.SHUT_WR)
            except OSError:
                pass  # it has heard enough
            else:
                assert "error" in json.loads(client.makefile().readline() or '{"error": ""}')
        assert send_request(control, "status")["activity"] == "starting"

    def test_a_client_that_says_nothing_does_not_hold_up_the_next(self, control: Path) -> None:
        with socket.socket(socket.AF_UNIX) as silent:
            silent.connect(str(control))
            assert send_request(control, "status")["activity"] == "starting"

    def test_without_a_daemon_one_line_says_so(self, tmp_path: Path) -> None:
        with pytest.raises(ControlError, match="no rig run listens there"):
            send_request(tmp_path / "control.sock", "status")

    def test_a_daemon_can_be_asked_although_its_configuration_is_bad_by_now(self, control: Path) -> None:
        config = control.parent / "vehicle.toml"
        config.write_text('[pan_tlit]\n[run]\ndem = ["terrain.tif"]\ncontrol = "control.sock"\n')
        told = CliRunner().invoke(rig, ["status", "--config", str(config), "--json"])
        assert (told.exit_code, json.loads(told.stdout)["activity"]) == (0, "starting")
        assert "pan_tlit" in told.stderr
        assert told.stderr.count("\n") == 1

    def test_the_socket_is_found_whatever_else_is_bad(self, tmp_path: Path) -> None:
        config = tmp_path / "vehicle.toml"
        for text, control in {
            "[run]\n": "spool/control.sock",
            '[run]\ncontrol = "c.sock"\n[run.spool]\nquota_mb = 5\n': "c.sock",
            '[run.spool]\ndir = "there"\nquota_mb = "much"\n': "there/control.sock",
        }.items():
            config.write_text(text)
            assert control_socket_of_invalid_config(config) == tmp_path / control
        for text in (
            "[pan_tlit]\n",
            "not = [TOML",
            "[run]\ncontrol = 5\n",
            "run = 5\n",
            "[run]\nspool = 5\n",
        ):
            config.write_text(text)
            assert control_socket_of_invalid_config(config) is None

    def test_where_no_daemon_answers_the_configuration_is_what_is_wrong(self, tmp_path: Path) -> None:
        config = tmp_path / "vehicle.toml"
        config.write_text('[run]\ncontrol = "control.sock"\n')
        (tmp_path / "control.sock").touch()  # whose daemon was killed
        told = CliRunner().invoke(rig, ["status", "--config", str(config)])
        assert isinstance(told.exception, ConfigError)
        assert told.stderr == ""

    def test_a_path_that_is_too_long_is_reported(self, tmp_path: Path) -> None:
        daemon_state = DaemonState()
        with pytest.raises(ControlError, match="too long for a socket"):
            ControlSocket(
                tmp_path / ("x" * 120),
                daemon_state,
                Triggers(daemon_state, lambda: None, lambda source: None),
            )

    def test_the_socket_of_a_daemon_that_was_killed_is_replaced(self, tmp_path: Path) -> None:
        path, daemon_state = tmp_path / "control.sock", DaemonState()
        with socket.socket(socket.AF_UNIX) as left:
            left.bind(str(path))
        ControlSocket(path, daemon_state, Triggers(daemon_state, lambda: None, lambda source: None)).close()
        assert not path.exists()
