"""gpsd that connects before, during and after a fix, or again: it reports correctly, without alternating."""

import socket
import time
from contextlib import closing, contextmanager
from datetime import UTC, datetime, timedelta

import pytest
from fakes.answers import an_answer
from fakes.gpsd import no_position, position, reports_of, time_of

from rig.config.run import NmeaOutput
from rig.daemon.publish.nmea import publishing
from rig.daemon.state import DaemonState

pytestmark = pytest.mark.system

STEADY_S = 8.0
UNSETTLED = 3
"""Reports that a program may make before it has seen a whole epoch."""


def a_fix(bundle="a"):
    return an_answer(bundle, age_s=10.0, utc=datetime.now(UTC) - timedelta(seconds=10))


@contextmanager
def published_over(way, daemon_state):
    """Yields the source that gpsd is given."""
    if way == "tcp":
        with publishing(
            NmeaOutput(tcp="127.0.0.1:0", every_s=0.5, valid_s=1000.0), daemon_state
        ) as publisher:
            yield "tcp://{}:{}".format(*publisher.tcp)
    else:
        with closing(socket.socket(type=socket.SOCK_DGRAM)) as free:
            free.bind(("127.0.0.1", 0))
            address = f"127.0.0.1:{free.getsockname()[1]}"
        with publishing(NmeaOutput(tcp=None, udp=(address,), every_s=0.5, valid_s=1000.0), daemon_state):
            yield f"udp://{address}"


def modes(reports, seconds):
    """Of the position reports that come meanwhile."""
    before = len(reports.all)
    time.sleep(seconds)
    return [report["mode"] for _, report in reports.all[before:] if report["class"] == "TPV"]


@pytest.mark.parametrize("way", ["tcp", "udp"])
@pytest.mark.parametrize("begins", ["before", "during", "again", "after"])
def test_gpsd_reports_what_holds_however_it_came_to_listen(program, way, begins):
    daemon_state = DaemonState()
    if begins != "before":
        daemon_state.set_answer(a_fix())
    if begins == "after":
        daemon_state.set_moving()
    with published_over(way, daemon_state) as source:
        if begins == "again":
            with reports_of(program, source) as reports:
                reports.until(position)
        with reports_of(program, source) as reports:
            if begins == "after":
                reports.until(no_position)
                assert set(modes(reports, STEADY_S)) == {1}
                return
            if begins == "before":
                reports.until(no_position)
                daemon_state.set_answer(a_fix())
            tpv = reports.until(lambda report: position(report) and report["mode"] == 3)
            assert (tpv["lat"], tpv["lon"]) == pytest.approx((46.199, -122.192), abs=2e-7)
            reports.until(position)
            steady = modes(reports, STEADY_S)
            assert len(steady) >= STEADY_S  # one an epoch
            assert set(steady) == {3}
            last = [report for _, report in reports.all if report["class"] == "TPV"][-1]
            assert (last["epy"], last["epx"]) == (2.0, 3.0)
            assert datetime.now(UTC) - time_of(last) > timedelta(seconds=10)
            assert [r["mode"] for _, r in reports.all if r["class"] == "TPV"].count(1) <= UNSETTLED + (
                begins == "before"
            ) * 10
            daemon_state.set_moving()
            reports.until(no_position)
            assert set(modes(reports, 3.0)) == {1}


def test_a_later_fix_is_reported_as_steadily_as_the_first(program):
    daemon_state = DaemonState()
    daemon_state.set_answer(a_fix())
    with published_over("udp", daemon_state) as source, reports_of(program, source) as reports:
        first = reports.until(lambda report: position(report) and report["mode"] == 3)
        daemon_state.set_answer(an_answer("b", age_s=2.0, utc=datetime.now(UTC) - timedelta(seconds=2)))
        later = reports.until(lambda report: position(report) and time_of(report) > time_of(first))
        assert later["mode"] == 3
        reports.until(position)
        assert set(modes(reports, STEADY_S)) == {3}
