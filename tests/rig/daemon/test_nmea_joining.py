"""Clients of ``[run.nmea]`` that begin to listen before, during and after a fix, and again."""

import socket
from contextlib import closing

import pytest
from fakes.answers import CAPTURED_UTC, an_answer
from fakes.qgis import Qgis
from fakes.timebases import FastClock, on
from pynmeagps import NMEAReader

from rig.config.run import NmeaOutput
from rig.daemon.publish.nmea import publishing
from rig.daemon.publish.nmea_sentences import epoch_for_datagrams
from rig.daemon.publish.published import published
from rig.daemon.state import DaemonState

SOON_S = 30.0
ALL = NmeaOutput().sentences


@pytest.fixture(autouse=True)
def clock():
    """Epochs follow each other ten times as fast as they are dated."""
    with on(FastClock(10.0)) as clock:
        yield clock


def section(**changes):
    return NmeaOutput(**{"tcp": "127.0.0.1:0", "every_s": 0.1, "valid_s": 1000.0, **changes})


def first_epochs(address, count):
    """The kinds of the first sentences, and quality of each GGA, that a new client receives."""
    with socket.create_connection(address, SOON_S) as client, client.makefile("rb") as lines:
        qualities = []
        while len(qualities) < count:
            message = NMEAReader.parse(lines.readline(), validate=1)
            if message.msgID == "GGA":
                qualities.append(message.quality)
        return qualities


def test_a_client_that_connects_during_a_fix_gets_an_empty_epoch_then_the_fix():
    daemon_state = DaemonState()
    daemon_state.set_answer(an_answer(age_s=10.0))
    with publishing(section(every_s=0.5), daemon_state) as publisher:
        assert first_epochs(publisher.tcp, 4) == [0, 6, 6, 6]
        assert first_epochs(publisher.tcp, 3) == [0, 6, 6]  # and again after a restart


def test_who_has_been_there_before_is_not_disturbed_by_who_comes():
    daemon_state = DaemonState()
    with publishing(section(), daemon_state) as publisher, closing(Qgis(publisher.tcp)) as stays:
        daemon_state.set_answer(an_answer(age_s=10.0))
        stays.until(lambda shown: shown.valid)
        for _ in range(3):
            first_epochs(publisher.tcp, 2)
            assert all(shown.valid for shown in stays.more(2))


def test_without_a_fix_nothing_is_said_twice():
    with (
        publishing(section(every_s=0.3), DaemonState()) as publisher,
        socket.create_connection(publisher.tcp, SOON_S) as client,
        client.makefile("rb") as lines,
    ):
        kinds = [NMEAReader.parse(lines.readline()).msgID for _ in range(7)]
    assert kinds == ["ZDA", "RMC", "GGA", "GBS", "GST", "GLL", "ZDA"]


@pytest.mark.parametrize("begins", ["before", "during", "after", "again"])
def test_qgis_shows_the_fix_steadily_and_nothing_without_one(begins):
    daemon_state = DaemonState()
    with publishing(section(), daemon_state) as publisher:
        if begins == "before":
            qgis = Qgis(publisher.tcp)
            qgis.until(lambda shown: not shown.valid)
            daemon_state.set_answer(an_answer(age_s=10.0))
        else:
            daemon_state.set_answer(an_answer(age_s=10.0))
            if begins == "again":
                with closing(Qgis(publisher.tcp)) as earlier:
                    earlier.until(lambda shown: shown.valid)
            if begins == "after":
                daemon_state.set_moving()
            qgis = Qgis(publisher.tcp)
        with closing(qgis):
            if begins == "after":
                assert not any(shown.valid for shown in qgis.more(6))
                return
            at = qgis.until(lambda shown: shown.valid)
            assert (at.lat_deg, at.lon_deg) == pytest.approx((46.199, -122.192), abs=2e-7)
            assert {(shown.valid, shown.lat_deg) for shown in qgis.more(6)} == {(True, at.lat_deg)}
            daemon_state.set_moving()
            qgis.until(lambda shown: not shown.valid)
            assert not any(shown.valid for shown in qgis.more(4))


def test_a_datagram_closes_the_epoch_by_itself():
    fix = published(an_answer())
    lines = epoch_for_datagrams(fix, CAPTURED_UTC.replace(hour=12), 6, ALL).splitlines(keepends=True)
    told = [NMEAReader.parse(line, validate=1) for line in lines]
    assert [m.msgID for m in told] == ["ZDA", "RMC", "GGA", "GST", "HDT", "GLL", "GBS", "GBS"]
    of_the_fix, of_now = told[-2:]
    assert of_the_fix.time == told[1].time == CAPTURED_UTC.time()
    assert (of_the_fix.errLat, of_the_fix.errLon) == (2.0, 3.0)
    assert of_now.time == told[0].time  # the present: the next epoch's time differs from it
    assert of_now.errLat == ""


def test_a_datagram_holds_only_the_sentences_asked_for():
    fix = published(an_answer())
    for kinds in (("RMC", "GGA"), ("GGA", "GBS")):
        told = [
            NMEAReader.parse(line).msgID
            for line in epoch_for_datagrams(fix, CAPTURED_UTC, 6, kinds).splitlines(keepends=True)
        ]
        assert set(told) == set(kinds)
