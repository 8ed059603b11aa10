"""What gpsd, the program of Debian, makes of our NMEA: read with gpspipe as any client would."""

import socket
from datetime import UTC, datetime, timedelta

import pytest
from fakes.answers import an_answer
from fakes.gpsd import ellipse, no_position, position, reports_of, time_of

from rig import clock
from rig.config.run import NmeaOutput
from rig.daemon.publish.nmea import publishing
from rig.daemon.state import DaemonState

pytestmark = pytest.mark.system


@pytest.fixture
def daemon_state():
    return DaemonState()


def test_a_fix_arrives_with_its_ellipse_and_the_time_of_its_capture(program, daemon_state):
    section = NmeaOutput(tcp="127.0.0.1:0", every_s=0.5, valid_s=1000.0)
    captured = datetime.now(UTC).replace(microsecond=470_000) - timedelta(seconds=15)
    with publishing(section, daemon_state) as publisher:
        host, port = publisher.tcp
        with reports_of(program, f"tcp://{host}:{port}") as reports:
            assert "lat" not in reports.until(no_position)
            daemon_state.set_answer(an_answer(age_s=15.0, utc=captured))
            gst = reports.until(ellipse)
            assert (gst["major"], gst["minor"]) == (3.0, 2.0)
            assert gst["orient"] == pytest.approx(90.6, abs=0.1)
            assert (gst["lat"], gst["lon"]) == (2.0, 3.0)
            tpv = reports.until(position)
            assert (tpv["lat"], tpv["lon"]) == pytest.approx((46.199, -122.192), abs=2e-7)
            assert (tpv["mode"], tpv["status"]) == (3, 5)  # dead reckoning, as gpsd calls what is estimated
            assert tpv["altMSL"] == pytest.approx(1432.6)
            assert (tpv["epy"], tpv["epx"]) == (2.0, 3.0)
            repeated = [reports.until(lambda report: report["class"] == "TPV") for _ in range(4)]
            assert [report["mode"] for report in repeated] == [3] * 4
            assert {time_of(report) for report in repeated} == {captured}


def test_without_a_current_fix_there_is_mode_1_until_the_next_one(program, daemon_state):
    section = NmeaOutput(tcp="127.0.0.1:0", every_s=0.5, valid_s=30.0)
    with publishing(section, daemon_state) as publisher:
        host, port = publisher.tcp
        with reports_of(program, f"tcp://{host}:{port}") as reports:
            reports.until(no_position)
            daemon_state.set_answer(an_answer("a", age_s=26.0, utc=datetime.now(UTC) - timedelta(seconds=26)))
            reports.until(position)
            over = reports.until(no_position)
            assert "lat" not in over
            seen = []
            daemon_state.set_answer(an_answer("b", "ambiguous", age_s=1.0))
            daemon_state.set_answer(an_answer("c", "none", age_s=0.5))
            for _ in range(4):
                reports.until(no_position, seen)
            assert not [report for report in seen if position(report) or ellipse(report)]
            daemon_state.set_answer(an_answer("d", age_s=0.1, utc=datetime.now(UTC)))
            assert reports.until(position)["lat"] == pytest.approx(46.199, abs=2e-7)


def test_a_capture_before_midnight_keeps_its_date_after_it(program, daemon_state, monkeypatch):
    """gpsd moves on by a day where the hour runs backwards, unless RMC's date follows at once."""
    now = datetime.now(UTC)
    to_midnight = now.replace(hour=0, minute=0, second=2) + timedelta(days=1) - now
    monkeypatch.setattr(clock, "wall_clock", lambda: datetime.now(UTC) + to_midnight)
    monkeypatch.setattr(clock, "_session", clock._session)  # for monkeypatch to put back
    clock.begin_session()
    section = NmeaOutput(tcp="127.0.0.1:0", every_s=0.5, valid_s=1000.0)
    captured = clock.wall_clock().replace(microsecond=0) - timedelta(seconds=15)
    with publishing(section, daemon_state) as publisher:
        host, port = publisher.tcp
        with reports_of(program, f"tcp://{host}:{port}") as reports:
            assert time_of(reports.until(lambda report: no_position(report) and "time" in report)) > captured
            daemon_state.set_answer(an_answer(age_s=15.0, utc=captured))
            for _ in range(3):
                assert time_of(reports.until(position)) == captured


def test_datagrams_do_as_well(program, daemon_state):
    with socket.socket(type=socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
    with publishing(NmeaOutput(tcp=None, udp=(address,), every_s=0.5, valid_s=1000.0), daemon_state):
        daemon_state.set_answer(an_answer(age_s=10.0, utc=datetime.now(UTC) - timedelta(seconds=10)))
        with reports_of(program, f"udp://{address}") as reports:
            assert reports.until(position)["lat"] == pytest.approx(46.199, abs=2e-7)
            assert reports.until(ellipse)["major"] == 3.0
