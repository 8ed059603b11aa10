"""One line that comes again and again does not fill the log."""

import logging
import socket
import time

import pytest
import structlog
from fakes.located import answer_of

from rig.config.run import NmeaOutput
from rig.daemon import log_rate_limit
from rig.daemon.log import logging_to
from rig.daemon.log_rate_limit import RateLimitHandler
from rig.daemon.publish import tcp_broadcast
from rig.daemon.publish.nmea import publishing
from rig.daemon.state import DaemonState

SOON_S = 30.0


class Kept(logging.Handler):
    def __init__(self):
        super().__init__()
        self.lines = []

    def emit(self, record):
        self.lines.append(record.getMessage())


@pytest.fixture
def log():
    kept = Kept()
    logger = logging.getLogger("tests.rate_limit")
    handler = RateLimitHandler(kept)
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)
    logger.propagate = False
    logger.lines = kept.lines
    logger.rate_limit = handler
    yield logger
    logger.removeHandler(handler)


def test_the_first_of_a_kind_are_written_and_the_rest_counted(log):
    for number in range(500):
        log.warning("client %d was refused", number)
    log.rate_limit.close()
    assert log.lines[: log_rate_limit.FIRST] == [
        f"client {n} was refused" for n in range(log_rate_limit.FIRST)
    ]
    assert log.lines[log_rate_limit.FIRST :] == ["490 more lines like this left out: client %d was refused"]


def test_another_kind_is_written_all_the_same(log):
    for _ in range(50):
        log.warning("noise")
    log.warning("something else")
    log.error("noise")  # is not a warning of it
    assert log.lines[log_rate_limit.FIRST :] == ["something else", "noise"]


def test_after_a_while_one_more_is_written_with_the_number_left_out(log, monkeypatch):
    for _ in range(50):
        log.warning("noise")
    later_s = time.monotonic() + 2.5 * log_rate_limit.EVERY_S
    monkeypatch.setattr("rig.timebase.monotonic_s", lambda: later_s)
    log.info("good morning")
    assert log.lines[log_rate_limit.FIRST :] == ["40 more lines like this left out: noise", "good morning"]


def test_lines_of_values_only_are_distinguished_by_them(log):
    for number in range(50):
        log.error("%s", f"line {number} of a stack")
    assert len(log.lines) == 50


def test_events_of_different_devices_and_bundles_are_different_ones(capsys):
    daemon_state = DaemonState()
    with logging_to(daemon_state, {}):
        events = structlog.get_logger("tests")
        for number in range(100):
            events.info("located", bundle=f"bundle-{number}")
            events.warning("device fails", device=f"sensor-{number % 20}", problem="gone")
    lines = capsys.readouterr().err.splitlines()
    assert sum("located" in line for line in lines) == 100
    assert sum("device fails" in line for line in lines) == 100
    assert "log lines left out" not in daemon_state.snapshot().counts


def test_refused_clients_do_not_fill_the_journal(monkeypatch, capsys):
    monkeypatch.setattr(tcp_broadcast, "MAX_CLIENTS", 1)
    daemon_state = DaemonState()
    with (
        logging_to(daemon_state, {}),
        publishing(NmeaOutput(tcp="127.0.0.1:0", every_s=0.1), daemon_state) as publisher,
        socket.create_connection(publisher.tcp, SOON_S) as stays,
    ):
        stays.recv(1)
        for _ in range(100):
            with socket.create_connection(publisher.tcp, SOON_S) as refused:
                assert refused.recv(1) == b""
        daemon_state.set_answer(answer_of("a"))
    lines = capsys.readouterr().err.splitlines()
    told = [line for line in lines if "turned away" in line]
    assert len(told) == log_rate_limit.FIRST + 1
    assert "127.0.0.1 was turned away: 1 clients are connected" in told[0]
    assert "90 more lines like this left out" in told[-1]
    assert daemon_state.snapshot().counts["log lines left out"] == 90


def test_garbage_over_http_does_not_fill_it_either(capsys):
    """The server's own warning, one for each request that is none."""
    daemon_state = DaemonState()
    with logging_to(daemon_state, {}):
        for _ in range(1000):
            logging.getLogger("uvicorn.error").warning("Invalid HTTP request received.")
    lines = capsys.readouterr().err.splitlines()
    assert sum("Invalid HTTP request" in line for line in lines) == log_rate_limit.FIRST + 1
