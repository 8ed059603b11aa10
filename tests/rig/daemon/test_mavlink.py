"""``[run.mavlink]`` as received by an autopilot, decoded by pymavlink from real sockets and ports."""

import math
import os
import pty
import socket
import sys
import tty
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta

import pytest
from fakes.answers import an_answer
from fakes.timebases import SteppedClock, on
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common

from rig.clock import Instant
from rig.config.run import MavlinkOutput
from rig.daemon.heartbeat import Heartbeats
from rig.daemon.publish import mavlink
from rig.daemon.publish.mavlink import publishing
from rig.daemon.publish.mavlink_messages import external_position_estimate, gps_input
from rig.daemon.publish.published import published
from rig.daemon.state import DaemonState
from rig.errors import ConfigError

SOON_S = 30.0
"""A wait that only a failing test lasts out."""
STEP_S = 0.1
BOTH = ("EXTERNAL_POSITION_ESTIMATE", "GPS_INPUT")


def decoded(message):
    """The message after a journey as bytes."""
    packed = message.pack(common.MAVLink(None, srcSystem=1, srcComponent=197))
    return common.MAVLink(None).parse_buffer(packed)[0]


@pytest.fixture
def clock():
    """Time passes while something is waited for, and only then."""
    with on(SteppedClock()) as clock:
        yield clock


class Autopilot:
    """The other end of a UDP link."""

    def __init__(self, clock, port=0):
        self.clock = clock
        self.socket = socket.socket(type=socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", port))
        self.socket.setblocking(False)
        self.port = self.socket.getsockname()[1]
        self.mav = common.MAVLink(None, srcSystem=1, srcComponent=1)
        self.heard = []

    def until(self, kind, wanted=lambda message: True):
        end_s = self.clock.monotonic_s() + SOON_S
        while self.clock.monotonic_s() < end_s:
            while data := self._datagram():
                for message in self.mav.parse_buffer(data):
                    self.heard.append(message)
                    if message.get_type() == kind and wanted(message):
                        return message
            self.clock.advance(STEP_S)
        return pytest.fail(f"no such {kind} came")

    def _datagram(self):
        try:
            data, self.companion = self.socket.recvfrom(65536)
        except BlockingIOError:
            return b""
        return data

    def say(self, message):
        self.socket.sendto(message.pack(self.mav), self.companion)

    def beat(self):
        self.say(
            common.MAVLink_heartbeat_message(
                common.MAV_TYPE_GROUND_ROVER, common.MAV_AUTOPILOT_ARDUPILOTMEGA, 0, 0, 0, 3
            )
        )

    def count(self, kind, wanted=lambda message: True):
        return len([message for message in self.heard if message.get_type() == kind and wanted(message)])


@contextmanager
def linked(clock, daemon_state, **changes):
    autopilot = Autopilot(clock)
    section = MavlinkOutput(**{"connection": f"udpout:127.0.0.1:{autopilot.port}", **changes})
    try:
        with publishing(section, daemon_state):
            clock.until_waiting(1)
            yield autopilot
    finally:
        autopilot.socket.close()


def until(clock, condition):
    end_s = clock.monotonic_s() + SOON_S
    while not condition():
        assert clock.monotonic_s() < end_s, "it did not come to that"
        clock.advance(STEP_S)


def link_of(daemon_state):
    return next(device for device in daemon_state.snapshot().devices if device.name == "mavlink")


def test_a_fix_is_sent_once_with_its_age_and_accuracy(clock):
    daemon_state = DaemonState()
    with linked(clock, daemon_state) as autopilot:
        beat = autopilot.until("HEARTBEAT")
        assert (beat.get_srcSystem(), beat.get_srcComponent()) == (1, 197)
        assert beat.autopilot == common.MAV_AUTOPILOT_INVALID
        daemon_state.set_answer(an_answer("a", age_s=12.0))
        command = autopilot.until("COMMAND_INT")
        assert command.command == 43003
        assert (command.target_system, command.target_component) == (1, 1)
        assert command.frame == common.MAV_FRAME_GLOBAL
        assert (command.x, command.y) == (461990000, -1221920000)
        assert 12.0 <= command.param2 <= 12.0 + 2 * mavlink.POLL_EVERY_S
        assert command.param3 == pytest.approx(3.0, rel=1e-3)  # the longer axis
        assert math.isnan(command.z)
        for _ in range(2):
            autopilot.until("HEARTBEAT")
        assert autopilot.count("COMMAND_INT") == 1
        daemon_state.set_answer(an_answer("b", age_s=5.0))
        assert 5.0 <= autopilot.until("COMMAND_INT").param2 <= 12.0


def test_only_a_current_fix_is_sent(clock):
    daemon_state = DaemonState()
    with linked(clock, daemon_state, messages=BOTH) as autopilot:
        for answer in (
            an_answer("a", "ambiguous", age_s=10.0),
            an_answer("b", "none", age_s=9.0),
            an_answer("from the spool", age_s=4000.0),
        ):
            daemon_state.set_answer(answer)
            autopilot.until("HEARTBEAT")
        autopilot.until("HEARTBEAT")
        assert autopilot.count("COMMAND_INT") == 0
        assert autopilot.count("GPS_INPUT", lambda message: message.fix_type > 1) == 0
        daemon_state.set_answer(an_answer("c", age_s=5.0))
        autopilot.until("COMMAND_INT")
        autopilot.until("GPS_INPUT", lambda message: message.fix_type == 3)
        daemon_state.set_answer(an_answer("older, but still current", age_s=20.0))
        for _ in range(2):
            autopilot.until("HEARTBEAT")
        assert autopilot.count("COMMAND_INT") == 1


def test_a_fix_of_a_place_that_the_vehicle_has_left_is_withheld_and_the_log_says_so(clock, caplog):
    daemon_state = DaemonState()
    with linked(clock, daemon_state) as autopilot:
        autopilot.until("HEARTBEAT")
        daemon_state.set_moving()
        daemon_state.set_answer(an_answer(age_s=5.0))
        until(clock, lambda: daemon_state.snapshot().counts.get("mavlink fixes not sent") == 1)
        autopilot.until("HEARTBEAT")
        assert autopilot.count("COMMAND_INT") == 0
    assert "is not sent: the vehicle has moved on" in caplog.text


def test_a_fix_of_before_the_link_began_is_not_repeated(clock):
    daemon_state = DaemonState()
    daemon_state.set_answer(an_answer(age_s=5.0))
    with linked(clock, daemon_state) as autopilot:
        for _ in range(3):
            autopilot.until("HEARTBEAT")
        assert autopilot.count("COMMAND_INT") == 0


def test_the_state_shows_whether_the_autopilot_is_present_and_accepts_fixes(clock, monkeypatch, caplog):
    monkeypatch.setattr(mavlink, "HEARTBEAT_TIMEOUT_S", 1.5)
    daemon_state = DaemonState()
    with linked(clock, daemon_state) as autopilot:
        autopilot.until("HEARTBEAT")
        until(clock, lambda: link_of(daemon_state).state == "failing")
        assert "no heartbeat of system 1" in link_of(daemon_state).detail
        autopilot.beat()
        until(clock, lambda: link_of(daemon_state).state == "ok")
        daemon_state.set_answer(an_answer("a", age_s=9.0))
        for number, result in enumerate((common.MAV_RESULT_ACCEPTED, common.MAV_RESULT_FAILED)):
            daemon_state.set_answer(an_answer(f"fix {number}", age_s=8.0 - number))
            autopilot.until("COMMAND_INT")
            autopilot.say(common.MAVLink_command_ack_message(43003, result))
        until(clock, lambda: daemon_state.snapshot().counts.get("mavlink fixes refused") == 1)
        assert daemon_state.snapshot().counts["mavlink fixes accepted"] == 1
        assert "did not take a fix: MAV_RESULT_FAILED" in caplog.text
        until(clock, lambda: link_of(daemon_state).state == "failing")


def test_a_command_that_is_not_answered_is_sent_again_with_its_age_then(clock, monkeypatch, caplog):
    monkeypatch.setattr(mavlink, "ACK_TIMEOUT_S", 0.3)
    monkeypatch.setattr(mavlink, "HEARTBEAT_TIMEOUT_S", SOON_S)
    daemon_state = DaemonState()
    with linked(clock, daemon_state) as autopilot:
        autopilot.until("HEARTBEAT")
        autopilot.beat()
        until(clock, lambda: link_of(daemon_state).state == "ok")
        daemon_state.set_answer(an_answer("a", age_s=9.0))
        first, second = autopilot.until("COMMAND_INT"), autopilot.until("COMMAND_INT")
        assert (first.x, first.y) == (second.x, second.y)
        assert second.param2 > first.param2 + 0.25
        for _ in range(2):  # one to each
            autopilot.say(common.MAVLink_command_ack_message(43003, common.MAV_RESULT_ACCEPTED))
        until(clock, lambda: daemon_state.snapshot().counts.get("mavlink fixes accepted"))
        daemon_state.set_answer(an_answer("b", age_s=5.0))
        until(clock, lambda: daemon_state.snapshot().counts.get("mavlink fixes unanswered"))
        for _ in range(2):
            autopilot.until("HEARTBEAT")
        assert autopilot.count("COMMAND_INT") <= 2 + 1 + mavlink.MAX_SENDS
        counts = daemon_state.snapshot().counts
        assert (counts["mavlink fixes sent"], counts["mavlink fixes accepted"]) == (2, 1)
    assert "does not answer the fix of b" in caplog.text


def test_a_link_that_breaks_is_opened_again_and_a_current_fix_still_sent(clock, monkeypatch):
    monkeypatch.setattr(mavlink, "MIN_RETRY_S", 0.05)
    daemon_state = DaemonState()
    autopilot = Autopilot(clock)
    with publishing(MavlinkOutput(connection=f"udpout:127.0.0.1:{autopilot.port}"), daemon_state):
        clock.until_waiting(1)
        autopilot.until("HEARTBEAT")
        autopilot.beat()
        until(clock, lambda: link_of(daemon_state).state == "ok")
        autopilot.socket.close()
        until(clock, lambda: "Connection refused" in link_of(daemon_state).detail)
        assert link_of(daemon_state).state == "failing"
        daemon_state.set_answer(an_answer(age_s=2.0))
        back = Autopilot(clock, autopilot.port)
        assert back.until("COMMAND_INT").x == 461990000
        back.socket.close()


def test_tcp_and_an_autopilot_that_hangs_up(clock, monkeypatch):
    monkeypatch.setattr(mavlink, "MIN_RETRY_S", 0.05)
    daemon_state = DaemonState()
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(SOON_S)
        with publishing(MavlinkOutput(connection=f"tcp:127.0.0.1:{server.getsockname()[1]}"), daemon_state):
            clock.until_waiting(1)
            for _ in range(2):
                peer, _ = server.accept()
                assert common.MAVLink(None).parse_buffer(peer.recv(65536))[0].get_type() == "HEARTBEAT"
                peer.close()
                until(clock, lambda: "closed the connection" in link_of(daemon_state).detail)
                clock.advance(1.0)


def test_a_sender_to_udpin_is_answered(clock):
    with socket.socket(type=socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    autopilot = Autopilot(clock)
    autopilot.companion = ("127.0.0.1", port)
    with publishing(MavlinkOutput(connection=f"udpin:127.0.0.1:{port}"), daemon_state := DaemonState()):
        clock.until_waiting(1)
        until(clock, lambda: autopilot.beat() or link_of(daemon_state).state == "ok")
        autopilot.until("HEARTBEAT")
    autopilot.socket.close()


@pytest.mark.parametrize("messages", [("GPS_INPUT",), ("EXTERNAL_POSITION_ESTIMATE",)])
def test_an_autopilot_that_comes_in_the_middle_of_a_fix_still_gets_it(clock, messages):
    """GPS_INPUT has no acknowledgement, so a fix sent without a receiver would be lost."""
    kind = "GPS_INPUT" if messages == ("GPS_INPUT",) else "COMMAND_INT"

    def is_fix(message):
        return kind == "COMMAND_INT" or message.fix_type == 3

    with socket.socket(type=socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    daemon_state = DaemonState()
    section = MavlinkOutput(connection=f"udpin:127.0.0.1:{port}", messages=messages)
    with publishing(section, daemon_state):
        clock.until_waiting(1)
        daemon_state.set_answer(an_answer(age_s=2.0))
        until(clock, lambda: daemon_state.snapshot().counts.get("mavlink fixes sent") == 1)
        autopilot = Autopilot(clock)
        autopilot.companion = ("127.0.0.1", port)
        autopilot.beat()
        autopilot.until(kind, is_fix)
        for _ in range(2):
            autopilot.until("HEARTBEAT")
            autopilot.beat()
        if kind == "GPS_INPUT":
            assert autopilot.count(kind, is_fix) == 1
        assert daemon_state.snapshot().counts["mavlink fixes sent"] == 1
    autopilot.socket.close()


def test_an_autopilot_that_was_restarted_gets_the_current_fix_again(clock, monkeypatch):
    monkeypatch.setattr(mavlink, "HEARTBEAT_TIMEOUT_S", 1.5)
    daemon_state = DaemonState()
    with linked(clock, daemon_state, messages=("GPS_INPUT",)) as autopilot:
        autopilot.until("HEARTBEAT")
        autopilot.beat()
        until(clock, lambda: link_of(daemon_state).state == "ok")
        daemon_state.set_answer(an_answer(age_s=2.0))
        autopilot.until("GPS_INPUT", lambda message: message.fix_type == 3)
        until(clock, lambda: link_of(daemon_state).state == "failing")
        assert autopilot.count("GPS_INPUT", lambda message: message.fix_type == 3) == 1
        autopilot.beat()
        autopilot.until("GPS_INPUT", lambda message: message.fix_type == 3)


def test_an_unplugged_serial_port_is_a_fault_in_the_state(clock, monkeypatch):
    monkeypatch.setattr(mavlink, "MIN_RETRY_S", 0.05)
    controller, port = pty.openpty()
    tty.setraw(controller)
    tty.setraw(port)
    daemon_state = DaemonState()
    with publishing(MavlinkOutput(connection=os.ttyname(port)), daemon_state):
        clock.until_waiting(1)
        autopilot_present = common.MAVLink(None).parse_buffer(os.read(controller, 65536))
        assert autopilot_present[0].get_type() == "HEARTBEAT"
        os.close(port)
        os.close(controller)
        until(clock, lambda: link_of(daemon_state).state == "failing")
    assert "serial port" in link_of(daemon_state).detail


def test_noise_on_the_link_is_no_matter(clock):
    daemon_state = DaemonState()
    with linked(clock, daemon_state) as autopilot:
        autopilot.until("HEARTBEAT")
        for noise in (b"", b"\xfd" * 300, bytes(range(256)) * 4, b"\xfe\x09\x00\x01\x01\x00" + bytes(20)):
            autopilot.socket.sendto(noise, autopilot.companion)
        until(clock, lambda: autopilot.beat() or link_of(daemon_state).state == "ok")


def test_an_autopilot_that_streams_is_kept_up_with(clock):
    daemon_state = DaemonState()
    with linked(clock, daemon_state) as autopilot:
        autopilot.until("HEARTBEAT")
        for _ in range(100):  # datagrams of which one in each round would take 20 s
            autopilot.say(common.MAVLink_attitude_message(0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
        daemon_state.set_answer(an_answer(age_s=5.0))
        autopilot.until("COMMAND_INT")
        autopilot.say(common.MAVLink_command_ack_message(43003, common.MAV_RESULT_ACCEPTED))
        began_s = clock.monotonic_s()
        until(clock, lambda: daemon_state.snapshot().counts.get("mavlink fixes accepted") == 1)
        assert clock.monotonic_s() - began_s < 1.0


@given(st.binary(max_size=400), st.data())
@settings(max_examples=60)
def test_no_bytes_whatever_make_the_parser_give_up(noise, data):
    mav = common.MAVLink(None)
    mav.robust_parsing = True
    beat = decoded(common.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3)).get_msgbuf()
    mangled = bytearray(beat)
    mangled[data.draw(st.integers(0, len(beat) - 1))] = data.draw(st.integers(0, 255))
    mav.parse_buffer(noise)
    mav.parse_buffer(bytes(mangled))
    found = [message for _ in range(30) for message in mav.parse_buffer(bytes(beat)) or ()]
    assert "HEARTBEAT" in {message.get_type() for message in found}


def test_a_missing_pymavlink_is_one_clear_line(monkeypatch):
    monkeypatch.setitem(sys.modules, "pymavlink.dialects.v20", None)
    with pytest.raises(
        ConfigError, match=r"\[run.mavlink\] needs pymavlink: pip install 'skyfix\[mavlink\]'"
    ):
        publishing(MavlinkOutput(connection="udpout:127.0.0.1:1"), DaemonState()).__enter__()


@pytest.mark.parametrize(
    "connection", ["udpout:127.0.0.1", "carrier pigeon", "tcp:host:70000", "COM3", "udpout::14550"]
)
def test_a_connection_of_no_kind_is_refused(connection):
    with pytest.raises(ConfigError, match=r"\[run.mavlink\] connection: .* is none of udpout:HOST:PORT"):
        publishing(MavlinkOutput(connection=connection), DaemonState()).__enter__()


def test_the_loop_gives_proof_of_its_work(clock, monkeypatch):
    heartbeats, daemon_state = Heartbeats(), DaemonState()
    with publishing(MavlinkOutput(connection="udpout:127.0.0.1:1"), daemon_state, heartbeats):
        clock.until_waiting(1)
        until(clock, lambda: link_of(daemon_state).state == "failing")
        assert heartbeats.stalled() == ()
    assert heartbeats.stalled() == ()


FIX = published(
    an_answer(age_s=3.0, utc=datetime(2026, 11, 26, 12, 0, 0, 250_000, tzinfo=UTC), heading_deg=271.25)
)


def test_gps_input_says_what_is_known_and_that_the_rest_is_not():
    told = decoded(gps_input(common, FIX, FIX.utc + timedelta(seconds=3)))
    assert (told.fix_type, told.lat, told.lon) == (3, 461990000, -1221920000)
    assert told.alt == pytest.approx(1432.6, abs=1e-3)
    assert told.horiz_accuracy == pytest.approx(3.0, rel=1e-3)
    assert told.satellites_visible == 0
    assert told.yaw == 27125
    assert told.time_usec == 1795694400250000
    # 2026-11-26 is a Thursday, noon UTC is 18 s earlier than GPS has it
    assert told.time_week == 2446
    assert told.time_week_ms == (4 * 86400 + 12 * 3600 + 18) * 1000 + 250
    named = {
        flag
        for bit, flag in (
            (common.GPS_INPUT_IGNORE_FLAG_ALT, "altitude"),
            (common.GPS_INPUT_IGNORE_FLAG_HORIZONTAL_ACCURACY, "accuracy"),
            (common.GPS_INPUT_IGNORE_FLAG_HDOP, "hdop"),
            (common.GPS_INPUT_IGNORE_FLAG_VDOP, "vdop"),
            (common.GPS_INPUT_IGNORE_FLAG_VEL_HORIZ, "speed"),
            (common.GPS_INPUT_IGNORE_FLAG_VEL_VERT, "climb"),
            (common.GPS_INPUT_IGNORE_FLAG_SPEED_ACCURACY, "speed accuracy"),
            (common.GPS_INPUT_IGNORE_FLAG_VERTICAL_ACCURACY, "vertical accuracy"),
        )
        if told.ignore_flags & bit
    }
    assert named == {"hdop", "vdop", "speed", "climb", "speed accuracy", "vertical accuracy"}


def test_gps_input_without_a_fix_gives_no_position():
    told = decoded(gps_input(common, None, datetime(2026, 11, 29, tzinfo=UTC)))
    assert told.fix_type == common.GPS_FIX_TYPE_NO_FIX
    assert (told.lat, told.lon, told.yaw) == (0, 0, 0)
    assert told.ignore_flags & common.GPS_INPUT_IGNORE_FLAG_ALT
    assert told.ignore_flags & common.GPS_INPUT_IGNORE_FLAG_HORIZONTAL_ACCURACY
    assert (told.time_week, told.time_week_ms) == (2447, 18_000)


@pytest.mark.parametrize(
    ("heading_deg", "yaw"), [(0.0, 36000), (359.999, 36000), (0.01, 1), (180.0, 18000), (None, 0)]
)
def test_yaw_has_no_zero_for_north(heading_deg, yaw):
    fix = published(an_answer(heading_deg=heading_deg))
    assert decoded(gps_input(common, fix, fix.utc)).yaw == yaw


def test_a_fix_without_an_altitude_is_a_flat_one():
    fix = published(an_answer(altitude_m=None))
    told = decoded(gps_input(common, fix, fix.utc))
    assert told.fix_type == common.GPS_FIX_TYPE_2D_FIX
    assert told.ignore_flags & common.GPS_INPUT_IGNORE_FLAG_ALT


def test_the_transmission_time_wraps_and_keeps_its_digits():
    for at_s in (0.0, 249.999, 250.0, 1e7 + 0.125):
        now = Instant(at_s, FIX.utc)
        told = decoded(external_position_estimate(common, FIX, now, 7))
        assert 0.0 <= told.param1 < 250.0
        assert told.param1 == pytest.approx(math.fmod(at_s, 250.0), abs=2e-5)
        assert told.target_system == 7


@pytest.mark.parametrize("year", [1970, 2016])
def test_gps_input_has_no_time_of_a_clock_that_cannot_be_right(year):
    told = decoded(gps_input(common, FIX, datetime(2026, 11, 29, tzinfo=UTC)))
    wrong = datetime(year, 1, 1, tzinfo=UTC)
    untold = decoded(gps_input(common, published(an_answer(utc=wrong)), wrong))
    assert (untold.time_usec, untold.time_week, untold.time_week_ms) == (0, 0, 0)
    assert (untold.lat, untold.lon, untold.fix_type) == (told.lat, told.lon, told.fix_type)
