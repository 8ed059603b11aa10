"""What clients of ``[run.nmea]`` receive, over real sockets on loopback."""

import socket
import struct
import threading
import time
from contextlib import ExitStack, contextmanager
from datetime import UTC, datetime

import pytest
from fakes.answers import an_answer
from fakes.timebases import FastClock, on
from pynmeagps import NMEAReader

from rig.config.run import NmeaOutput
from rig.daemon.heartbeat import Heartbeats
from rig.daemon.publish import tcp_broadcast
from rig.daemon.publish.nmea import publishing
from rig.daemon.state import DaemonState
from rig.errors import ConfigError

SOON_S = 30.0
"""A wait that only a failing test lasts out."""


@pytest.fixture(autouse=True)
def clock():
    """Epochs follow each other ten times as fast as they are dated."""
    with on(FastClock(10.0)) as clock:
        yield clock


def section(**changes):
    return NmeaOutput(**{"tcp": "127.0.0.1:0", "every_s": 0.1, **changes})


class Client:
    """Reads sentences, as a plotter does."""

    def __init__(self, address):
        self.socket = socket.create_connection(address, SOON_S)
        self.lines = self.socket.makefile("rb")

    def until(self, kind, wanted=lambda message: True):
        deadline_s = time.monotonic() + SOON_S
        while time.monotonic() < deadline_s:
            message = NMEAReader.parse(self.lines.readline(), validate=1)
            if message.msgID == kind and wanted(message):
                return message
        pytest.fail(f"no such {kind} came")

    def close(self):
        self.lines.close()
        self.socket.close()


@contextmanager
def served(daemon_state=None, **changes):
    daemon_state = daemon_state or DaemonState()
    with publishing(section(**changes), daemon_state) as publisher, ExitStack() as clients:

        def client():
            new = Client(publisher.tcp)
            clients.callback(new.close)
            return new

        yield daemon_state, client, publisher


def a_fix(message):
    return message.quality == 6


def no_fix(message):
    return message.quality == 0


def test_every_client_gets_the_fix_and_then_its_expiry(clock):
    with served(valid_s=1000.0) as (daemon_state, client, _):
        clients = [client() for _ in range(5)]
        for each in clients:
            each.until("GGA", no_fix)
        daemon_state.set_answer(an_answer(age_s=8.0, took_s=8.0))
        clients.append(client())
        for each in clients:
            assert each.until("GGA", a_fix).lat == pytest.approx(46.199, abs=1e-6)
            assert each.until("GST").stdMajor == 3.0
        clock.skip(1000.0)
        for each in clients:
            assert each.until("GGA", no_fix).lat == ""


def test_an_ambiguous_answer_ends_the_fix_at_once():
    with served(valid_s=1000.0) as (daemon_state, client, _):
        each = client()
        daemon_state.set_answer(an_answer("a", age_s=20.0))
        each.until("GGA", a_fix)
        daemon_state.set_answer(an_answer("b", "ambiguous", age_s=10.0))
        each.until("GGA", no_fix)


def test_a_vehicle_that_moves_on_ends_the_fix_at_once():
    with served(valid_s=1000.0) as (daemon_state, client, _):
        each = client()
        daemon_state.set_answer(an_answer(age_s=20.0))
        each.until("GGA", a_fix)
        daemon_state.set_moving()
        each.until("GGA", no_fix)


def test_a_client_that_never_reads_delays_no_other_and_is_dropped(monkeypatch, caplog):
    monkeypatch.setattr(tcp_broadcast, "WAITING_BYTES", 2_000)
    with publishing(section(tcp="127.0.0.1:0"), DaemonState()) as publisher, socket.socket() as deaf:
        deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1024)  # so that little can hide on the way
        deaf.connect(publisher.tcp)
        reader = Client(publisher.tcp)
        deadline_s = time.monotonic() + SOON_S
        while "it does not read" not in caplog.text and time.monotonic() < deadline_s:
            reader.until("ZDA")
        assert "it does not read" in caplog.text
        reader.until("GGA")
        reader.close()


def test_a_client_that_leaves_in_the_middle_is_no_matter():
    with served() as (_, client, publisher):
        stays = client()
        for _ in range(20):
            leaves = socket.create_connection(publisher.tcp)
            # without a farewell: the next that is sent there meets a reset
            leaves.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            leaves.close()
            stays.until("GGA")
        client().until("GGA")


def test_what_a_client_says_is_ignored():
    with served() as (_, client, _):
        talks = client()
        for _ in range(50):
            talks.socket.sendall(b"$PUBX,40,GLL,0,0,0,0*5C\r\n" * 100)
        talks.until("GGA")


def test_more_clients_than_there_is_room_for_are_turned_away(monkeypatch):
    monkeypatch.setattr(tcp_broadcast, "MAX_CLIENTS", 2)
    with served() as (_, client, _):
        first, second = client(), client()
        first.until("GGA")
        second.until("GGA")
        assert client().lines.read() == b""
        first.until("GGA")
        second.close()
        deadline_s = time.monotonic() + SOON_S
        while time.monotonic() < deadline_s:
            if client().lines.readline():
                return
        pytest.fail("no place came free")


def test_datagrams_go_to_each_address_an_epoch_in_each():
    with socket.socket(type=socket.SOCK_DGRAM) as one, socket.socket(type=socket.SOCK_DGRAM) as other:
        for sock in (one, other):
            sock.bind(("127.0.0.1", 0))
            sock.settimeout(SOON_S)
        addresses = tuple(f"127.0.0.1:{sock.getsockname()[1]}" for sock in (one, other))
        daemon_state = DaemonState()
        with publishing(section(tcp=None, udp=addresses), daemon_state) as publisher:
            assert publisher.tcp is None
            for sock in (one, other):
                lines = sock.recv(65536).splitlines(keepends=True)
                assert [NMEAReader.parse(line, validate=1).msgID for line in lines][:3] == [
                    "ZDA",
                    "RMC",
                    "GGA",
                ]
            other.recv(65536)  # the first one's success is told after it was sent
            told = {device.name: device.state for device in daemon_state.snapshot().devices}
            assert told == {f"nmea to {address}": "ok" for address in addresses}


def test_a_name_that_is_not_known_yet_is_looked_up_aside(monkeypatch):
    asked, known = threading.Event(), threading.Event()
    look_up = socket.getaddrinfo

    def slow(host, *args, **options):
        if host != "plotter.example" or options["flags"] == socket.AI_NUMERICHOST:
            return look_up(host, *args, **options)
        asked.set()
        if not known.wait(SOON_S):
            raise socket.gaierror(socket.EAI_AGAIN, "Temporary failure in name resolution")
        return look_up("127.0.0.1", *args, **options)

    monkeypatch.setattr(socket, "getaddrinfo", slow)
    with socket.socket(type=socket.SOCK_DGRAM) as plotter:
        plotter.bind(("127.0.0.1", 0))
        plotter.settimeout(SOON_S)
        with served(udp=(f"plotter.example:{plotter.getsockname()[1]}",)) as (_, client, _):
            assert asked.wait(SOON_S)
            client().until("GGA")  # while the question hangs
            known.set()
            assert plotter.recv(65536).startswith(b"$GPZDA")


def test_an_unsent_datagram_is_a_fault_in_the_state_and_sent_again():
    address = "127.0.0.1:9"
    daemon_state = DaemonState()
    with publishing(section(tcp=None, udp=("[::1]:9", address)), daemon_state):
        deadline_s = time.monotonic() + SOON_S
        while len(daemon_state.snapshot().devices) < 2 and time.monotonic() < deadline_s:
            time.sleep(0.01)
    told = {device.name: device.state for device in daemon_state.snapshot().devices}
    assert told[f"nmea to {address}"] == "ok"
    assert told["nmea to [::1]:9"] in ("ok", "failing")  # a machine may have no IPv6


def test_an_address_that_is_taken_is_a_fault_of_the_configuration():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        address = f"127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(
            ConfigError, match=rf"\[run.nmea\] tcp: cannot listen on {address}: Address already in use"
        ):
            publishing(section(tcp=address), DaemonState()).__enter__()


def test_a_fix_that_comes_too_late_is_counted_and_said(caplog):
    with served(valid_s=5.0) as (daemon_state, client, _):
        each = client()
        each.until("GGA", no_fix)
        daemon_state.set_answer(an_answer(age_s=8.0, took_s=8.0))
        deadline_s = time.monotonic() + SOON_S
        while (
            not daemon_state.snapshot().counts.get("nmea fixes never current")
            and time.monotonic() < deadline_s
        ):
            assert each.until("GGA").quality == 0
        assert daemon_state.snapshot().counts["nmea fixes never current"] == 1
    assert "the fix of 20261126T235958Z-3f9a is not published: captured 8 s ago" in caplog.text


def test_the_loop_gives_proof_of_its_work_and_ends_with_the_context():
    heartbeats, before = Heartbeats(), threading.active_count()
    with publishing(section(), DaemonState(), heartbeats) as publisher:
        Client(publisher.tcp).until("GGA")
        assert heartbeats.stalled() == ()
        with pytest.raises(ValueError, match="two loops are called 'nmea'"), heartbeats.watched("nmea", 1.0):
            pass
    assert threading.active_count() == before
    with pytest.raises(OSError, match="refused"):
        socket.create_connection(publisher.tcp)


def test_a_date_of_a_clock_that_cannot_be_right_is_not_passed_on():
    with served(valid_s=1000.0) as (daemon_state, client, _):
        each = client()
        each.until("ZDA")
        daemon_state.set_answer(an_answer(utc=datetime(1970, 1, 1, 0, 1, tzinfo=UTC)))
        each.until("RMC", lambda message: message.status == "A" and message.date == "")
        kinds = [each.lines.readline()[3:6] for _ in range(14)]
        assert kinds.count(b"RMC") == 2
        assert b"ZDA" not in kinds
