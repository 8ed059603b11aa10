"""The way between captures, and how well it is known."""

import math
import socket
import threading
import time
from contextlib import closing, nullcontext
from types import SimpleNamespace

import numpy as np
import pytest
from structlog.testing import capture_logs

from localizer.track.odometry import parse_leg
from rig.config.run import OdometryInput
from rig.daemon.boot import boot_id
from rig.daemon.captures import Captures
from rig.daemon.odometry.receiver import Odometer, OdometryListener, Velocity, velocity_in
from rig.daemon.spool.store import SpoolError
from rig.daemon.state import DaemonState
from rig.devices.sensors.nmea import checksum, parse_sentence
from rig.errors import MessageError, RigError

SECTION = OdometryInput(listen="127.0.0.1:0", speed_sigma_share=0.03, heading_sigma_deg=3.0)
A_LEG = parse_leg('{"east_m": 10, "north_m": -5, "sigma_m": 3}')


def captured_at(at_s: float) -> Odometer:
    """A way that begins with a capture."""
    odometer = Odometer(SECTION, at_s)
    odometer.begin(at_s)
    odometer.keep()
    return odometer


def sentence(body: str) -> bytes:
    return b"$%s*%02X" % (body.encode(), checksum(body.encode()))


def driven(odometer: Odometer, course_deg: float, speed_m_s: float, begin_s: float, seconds: float) -> float:
    """Speeds twice a second; returns when it ends."""
    for half_seconds in range(round(2 * seconds) + 1):
        odometer.velocity(Velocity(speed_m_s, course_deg), begin_s + half_seconds / 2)
    return begin_s + seconds


class TestSentences:
    @pytest.mark.parametrize(
        ("body", "speed_m_s", "course_deg"),
        [
            ("IIVTG,90.0,T,77.0,M,10.0,N,18.52,K,A", 18.52 / 3.6, 90.0),
            ("IIVTG,90.0,T,,M,10.0,N,,K", 10.0 * 1852 / 3600, 90.0),
            ("GPRMC,060000.00,A,,,,,10.0,350.5,261126,,,A", 10.0 * 1852 / 3600, 350.5),
            ("GPVTG,,T,,M,0.0,N,0.0,K,A", 0.0, 0.0),  # standing, there is no course
            ("IIVTG,,T,,M,10.0,N,18.52,K,A", 18.52 / 3.6, None),
            ("GPRMC,060000.00,A,,,,,10.0,,261126,,,A", 10.0 * 1852 / 3600, None),
        ],
    )
    def test_speed_and_course(self, body: str, speed_m_s: float, course_deg: float | None) -> None:
        velocity = velocity_in(parse_sentence(sentence(body)))
        assert velocity is not None
        assert velocity.speed_m_s == pytest.approx(speed_m_s)
        assert velocity.course_deg == course_deg

    @pytest.mark.parametrize(
        "body",
        [
            "IIVTG,90.0,T,77.0,M,10.0,N,18.52,K,N",
            "GPRMC,060000.00,V,,,,,10.0,350.5,261126,,,N",
            "HCHDG,90.0,,,,",
        ],
    )
    def test_what_is_not_valid_or_says_nothing_counts_for_nothing(self, body: str) -> None:
        assert velocity_in(parse_sentence(sentence(body))) is None

    def test_what_no_vehicle_does_is_refused(self) -> None:
        with pytest.raises(MessageError, match="IIVTG says 900"):
            velocity_in(parse_sentence(sentence("IIVTG,90.0,T,,M,,N,3240.0,K,A")))


class TestWay:
    def test_nothing_heard_is_an_unknown_way(self) -> None:
        assert captured_at(0.0).movement(10.0) is None

    def test_a_drive_adds_up_with_a_sigma_that_grows(self) -> None:
        odometer = captured_at(100.0)
        end_s = driven(odometer, 90.0, 10.0, 100.0, 20.0)
        leg = odometer.movement(end_s)
        assert leg is not None
        assert leg.step_m == pytest.approx([200.0, 0.0], abs=1e-9)
        along_m, across_m = np.sqrt(np.diag(leg.covariance_m2))
        assert 0.03 * 200.0 < along_m < 0.06 * 200.0
        assert math.radians(3.0) * 200.0 < across_m < 2.0 * math.radians(3.0) * 200.0
        farther = odometer.movement(driven(odometer, 90.0, 10.0, end_s, 20.0))
        assert farther is not None
        assert (np.diag(farther.covariance_m2) > np.diag(leg.covariance_m2)).all()

    def test_a_round_trip_ends_where_it_began_but_not_exactly(self) -> None:
        odometer = captured_at(0.0)
        end_s = driven(odometer, 0.0, 10.0, 0.0, 60.0)
        leg = odometer.movement(driven(odometer, 180.0, 10.0, end_s + 0.001, 60.0))
        assert leg is not None
        assert np.hypot(*leg.step_m) < 1.0
        assert np.sqrt(np.diag(leg.covariance_m2)).min() > 5.0

    def test_a_silence_is_bridged_for_a_while_and_then_nothing_is_known(self) -> None:
        odometer = captured_at(0.0)
        end_s = driven(odometer, 0.0, 0.0, 0.0, 5.0)
        short = odometer.movement(end_s + 20.0)
        assert short is not None
        assert np.sqrt(np.diag(short.covariance_m2)).min() >= 20.0
        assert odometer.movement(end_s + 20.0 + 61.0) is None

    def test_a_way_without_a_course_leads_in_any_direction(self) -> None:
        odometer = captured_at(0.0)
        end_s = driven(odometer, 90.0, 10.0, 0.0, 10.0)
        for second in range(1, 11):
            odometer.velocity(Velocity(10.0, None), end_s + second)
        leg = odometer.movement(end_s + 10.0)
        assert leg is not None
        assert leg.step_m == pytest.approx([100.0, 0.0], abs=1e-9)  # of these 100 m nothing else is known
        sigmas_m = np.sqrt(np.diag(leg.covariance_m2))
        assert sigmas_m == pytest.approx(100.0 / math.sqrt(2.0), rel=0.02)
        odometer.begin(end_s + 10.0)
        odometer.velocity(Velocity(0.0, 0.0), end_s + 10.1)
        odometer.undo_capture()
        whole = odometer.movement(end_s + 10.1)
        assert whole is not None
        assert np.sqrt(np.diag(whole.covariance_m2)).min() > 0.99 * 100.5 / math.sqrt(2.0)

    def test_legs_add_up(self) -> None:
        odometer = captured_at(0.0)
        for _ in range(2):
            odometer.leg(A_LEG, 1.0)
        leg = odometer.movement(1.0)
        assert leg is not None
        assert leg.step_m.tolist() == [20.0, -10.0]
        assert np.diag(leg.covariance_m2) == pytest.approx(18.0, abs=0.5)
        odometer.leg(parse_leg('{"unknown": true}'), 1.0)
        assert odometer.movement(1.0) is None

    def test_a_capture_begins_a_new_way_and_a_failed_one_does_not(self) -> None:
        odometer = captured_at(0.0)
        end_s = driven(odometer, 90.0, 10.0, 0.0, 10.0)
        assert odometer.begin(end_s) is not None
        end_s = driven(odometer, 90.0, 10.0, end_s, 3.0)
        since = odometer.movement(end_s)
        assert since is not None
        assert since.step_m[0] == pytest.approx(30.0)
        odometer.undo_capture()
        whole = odometer.movement(end_s)
        assert whole is not None
        assert whole.step_m[0] == pytest.approx(130.0)

    def test_a_restart_goes_on_where_speeds_are_heard(self) -> None:
        now_s = time.monotonic()
        odometer = captured_at(now_s)
        driven(odometer, 90.0, 10.0, now_s, 10.0)
        after = Odometer(SECTION, now_s + 11.0, odometer.to_json())
        after.velocity(Velocity(10.0, 90.0), now_s + 12.0)
        leg = after.movement(now_s + 12.0)
        assert leg is not None
        assert leg.step_m[0] == pytest.approx(120.0)

    def test_a_silence_before_the_first_speed_counts_like_any_other(self) -> None:
        odometer = captured_at(0.0)
        odometer.velocity(Velocity(5.0, 90.0), 20.0)
        leg = odometer.movement(20.0)
        assert leg is not None
        assert np.sqrt(np.diag(leg.covariance_m2)).min() >= 100.0
        odometer = captured_at(0.0)
        odometer.velocity(Velocity(5.0, 90.0), 61.0)
        assert odometer.movement(61.0) is None

    @pytest.mark.parametrize(("heard_before_s", "sigma_m"), [(0.1, 3.4), (10.0, 150.0), (60.0, 900.0)])
    def test_legs_go_on_over_a_restart_as_if_others_had_been_missed(
        self, heard_before_s: float, sigma_m: float
    ) -> None:
        odometer = captured_at(0.0)
        odometer.leg(A_LEG, 100.0)
        after = Odometer(SECTION, 100.0 + heard_before_s, odometer.to_json())
        after.leg(A_LEG, 200.0)
        leg = after.movement(200.0)
        assert leg is not None
        assert leg.step_m.tolist() == [20.0, -10.0]
        assert np.sqrt(np.diag(leg.covariance_m2)) == pytest.approx(sigma_m, rel=0.5)
        assert np.sqrt(np.diag(leg.covariance_m2)).min() >= 15.0 * heard_before_s

    @pytest.mark.parametrize("legs", [0, 1])
    def test_after_a_longer_while_without_legs_a_restart_knows_nothing_until_the_next_capture(
        self, legs: int
    ) -> None:
        odometer = captured_at(0.0)
        for _ in range(legs):
            odometer.leg(A_LEG, 0.0)
        after = Odometer(SECTION, 61.0, odometer.to_json())
        after.leg(A_LEG, 70.0)
        assert after.movement(70.0) is None
        after.begin(70.0)
        after.leg(A_LEG, 80.0)
        assert after.movement(80.0) is not None

    @pytest.mark.parametrize(
        "state",
        [
            None,
            '{"boot": "of another version"}',
            captured_at(0.0).to_json().replace(boot_id(), "another boot"),
        ],
        ids=["none", "another version", "another boot"],
    )
    def test_what_is_heard_after_a_restart_that_knows_nothing_is_not_taken_for_the_whole_way(
        self, state: str | None
    ) -> None:
        after = Odometer(SECTION, 1.0, state)
        after.leg(A_LEG, 2.0)
        driven(after, 90.0, 10.0, 2.0, 5.0)
        assert after.movement(7.0) is None

    def test_a_capture_whose_outcome_is_not_known_leaves_no_way_to_the_next(self) -> None:
        odometer = captured_at(0.0)
        odometer.leg(A_LEG, 1.0)
        odometer.begin(2.0)
        odometer.mark_unknown()
        odometer.undo_capture()
        assert odometer.movement(3.0) is None

    def test_only_the_capture_that_goes_on_can_be_taken_back(self) -> None:
        odometer = captured_at(0.0)
        odometer.leg(A_LEG, 1.0)
        odometer.begin(2.0)
        odometer.keep()
        odometer.undo_capture()
        odometer.leg(A_LEG, 3.0)
        leg = odometer.movement(3.0)
        assert leg is not None
        assert leg.step_m.tolist() == [10.0, -5.0]


def test_datagrams_of_several_lines_are_heard_and_nonsense_is_passed_over() -> None:
    odometer, stop = captured_at(0.0), threading.Event()
    listener = OdometryListener(SECTION, odometer)
    thread = threading.Thread(target=listener.run, args=(lambda: None, stop))
    thread.start()
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
            for datagram in (
                b"\xff\x00$GPVTG,no*00\r\n",
                b'{"east_m": "far"}',
                b'{"east_m": 4, "north_m": 0, "sigma_m": 1}\n\n{"east_m": 3, "north_m": 0, "sigma_m": 1}\r\n',
            ):
                out.sendto(datagram, listener.address)
        deadline_s = time.monotonic() + 60.0
        while time.monotonic() < deadline_s:
            leg = odometer.movement(0.0)
            if leg is not None and leg.step_m[0] == 7.0:
                break
            time.sleep(0.01)
        else:
            pytest.fail(f"heard {leg}")
        with pytest.raises(RigError, match=r"\[run.odometry\] listen: cannot listen on 127.0.0.1"):
            OdometryListener(OdometryInput(listen=f"127.0.0.1:{listener.address[1]}"), odometer)
    finally:
        stop.set()
        thread.join()
        listener.close()


def test_motion_is_reported_and_standstill_is_not() -> None:
    moving: list[None] = []
    stop, odometer = threading.Event(), captured_at(time.monotonic())
    listener = OdometryListener(SECTION, odometer, lambda: moving.append(None))
    thread = threading.Thread(target=listener.run, args=(lambda: None, stop))
    thread.start()
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
            for speed_kmh in (0.0, 0.9, 7.0, 8.0, 0.0):
                out.sendto(sentence(f"IIVTG,90.0,T,,M,,N,{speed_kmh},K,A"), listener.address)
            out.sendto(b'{"unknown": true}', listener.address)  # the last: unknown is what follows
        deadline_s = time.monotonic() + 60.0
        while odometer.movement(time.monotonic()) is not None or not moving:
            assert time.monotonic() < deadline_s
            time.sleep(0.01)
    finally:
        stop.set()
        thread.join()
        listener.close()
    assert len(moving) == 2


def test_a_capture_that_the_spool_refuses_takes_nothing_off_the_way() -> None:
    class FullDisk:
        refuses_room = False

        def make_room(self) -> list[str]:
            if self.refuses_room:
                raise SpoolError("spool: full")
            return []

        def begin_capture(self, *_: object) -> None:
            raise SpoolError("index.sqlite: disk I/O error; look at the disk")

    now_s = time.monotonic()
    odometer, spool, daemon_state = captured_at(now_s - 20.0), FullDisk(), DaemonState()
    signals = SimpleNamespace(deferring_stop=nullcontext)
    captures = Captures(None, daemon_state, spool, signals, None, None, odometer)  # type: ignore[arg-type]
    driven(odometer, 90.0, 10.0, now_s - 20.0, 20.0)
    for spool.refuses_room in (False, True, False):
        assert captures.take("rest", lambda: None) is None
    assert daemon_state.snapshot().counts["captures refused"] == 3
    way = odometer.movement(now_s)
    assert way is not None
    assert way.step_m[0] == pytest.approx(200.0)


def test_a_talker_without_a_course_is_logged_once() -> None:
    listener = OdometryListener(SECTION, captured_at(0.0))
    moving, turning = sentence("IIVTG,,T,,M,10.0,N,18.52,K,A"), sentence("IIVTG,90.0,T,,M,10.0,N,18.52,K,A")
    standing = sentence("IIVTG,,T,,M,0.0,N,0.0,K,A")
    with capture_logs() as lines, closing(listener):
        for line in (standing, moving, moving, standing, moving, turning, turning):
            listener._take(line, time.monotonic())
    assert [line["event"] for line in lines] == [
        "odometry says no course",
        "odometry says its course again",
    ]


@pytest.mark.parametrize(
    ("line", "keys", "moves"),
    [
        (b"\\s:ODO*01\\" + sentence("IIVTG,90.0,T,,M,10.0,N,18.52,K,A") + b"\x00", {}, True),
        (sentence("IIVTG,90.0,T,,M,10.0,N,18.52,K,S"), {}, False),
        (sentence("IIVTG,90.0,T,,M,10.0,N,18.52,K,E"), {}, False),
        (sentence("IIVTG,90.0,T,,M,10.0,N,18.52,K,E"), {"accept_estimated": True}, True),
        (b"$IIVTG,90.0,T,,M,10.0,N,18.52,K,A", {}, False),
        (b"$IIVTG,90.0,T,,M,10.0,N,18.52,K,A", {"require_checksum": False}, True),
    ],
)
def test_what_counts_as_a_movement_on_the_line(line: bytes, keys: dict[str, bool], moves: bool) -> None:
    told: list[None] = []
    section = SECTION.model_copy(update=keys)
    with closing(OdometryListener(section, captured_at(0.0), lambda: told.append(None))) as listener:
        listener._take(line, 1.0)
    assert bool(told) == moves
