"""The sentences, read back by pynmeagps, and by arithmetic where its rounding would hide something."""

import dataclasses
import re
from datetime import UTC, datetime, timedelta
from functools import reduce

import pytest
from fakes.answers import CAPTURED_UTC, an_answer
from hypothesis import example, given
from hypothesis import strategies as st
from pynmeagps import NMEAReader

from rig.config.run import NmeaOutput
from rig.daemon.publish.nmea_sentences import degrees_minutes, epoch
from rig.daemon.publish.published import published

ALL = NmeaOutput().sentences
NOW = CAPTURED_UTC + timedelta(seconds=20)  # of the next day
FIX = published(an_answer(covariance_m2=((9.0, 0.0), (0.0, 4.0))))


def parsed(fix, utc=NOW, quality=6, kinds=ALL):
    lines = epoch(fix, utc, quality, kinds).splitlines(keepends=True)
    assert all(line.endswith(b"\r\n") for line in lines)
    return {message.msgID: message for message in (NMEAReader.parse(line, validate=1) for line in lines)}


def fields_of(fix, kind, utc=NOW, quality=6):
    (line,) = epoch(fix, utc, quality, [kind]).decode().splitlines()
    return line[1:].rpartition("*")[0].split(",")[1:]


def test_a_fix_is_in_all_sentences():
    told = parsed(FIX)
    assert list(told) == ["ZDA", "RMC", "GGA", "GBS", "GST", "HDT", "GLL"]
    for kind in ("RMC", "GGA", "GLL"):
        assert (told[kind].lat, told[kind].lon) == pytest.approx((46.199, -122.192), abs=2e-7)
    assert told["GGA"].alt == 1432.6
    assert told["HDT"].headingT == 271.2
    gst = told["GST"]
    assert (gst.stdLat, gst.stdLong) == (2.0, 3.0)
    assert (gst.stdMajor, gst.stdMinor) == pytest.approx((3.0, 2.0), abs=0.01)
    # along the map's east, and its north lies 0.6 degrees east of true north there
    assert gst.orient == pytest.approx(90.6, abs=0.1)
    assert (told["GBS"].errLat, told["GBS"].errLon) == (2.0, 3.0)


def test_a_position_bears_the_time_of_its_capture_however_often_it_is_repeated():
    for later_s in (0.0, 1.0, 25.0):
        told = parsed(FIX, NOW + timedelta(seconds=later_s))
        for kind in ("RMC", "GGA", "GBS", "GST", "GLL"):
            assert told[kind].time == CAPTURED_UTC.time()
        assert told["RMC"].date == CAPTURED_UTC.date()
        assert told["ZDA"].time == (NOW + timedelta(seconds=later_s)).time()
        assert (told["ZDA"].day, told["ZDA"].month, told["ZDA"].year) == (27, 11, 2026)


def test_a_fix_is_called_estimated_unless_gps_is_asked_for():
    told = parsed(FIX)
    assert (told["GGA"].quality, told["RMC"].posMode, told["GLL"].posMode) == (6, "E", "E")
    told = parsed(FIX, quality=1)
    assert (told["GGA"].quality, told["RMC"].posMode, told["GLL"].posMode) == (1, "A", "A")
    assert told["RMC"].status == told["GLL"].status == "A"


def test_nothing_is_claimed_that_a_horizon_does_not_give():
    assert fields_of(FIX, "GGA")[6:8] == ["00", ""]  # satellites, HDOP
    assert fields_of(FIX, "GGA")[10:] == ["", "M", "", ""]  # geoid, differential
    rmc = fields_of(FIX, "RMC")
    assert rmc[6:8] == ["", ""]  # speed, course
    assert rmc[12] == "V"  # no navigational status
    assert fields_of(FIX, "GST")[1] == ""
    assert fields_of(FIX, "GST")[7] == ""


def test_without_a_fix_there_is_quality_0_and_no_position_anywhere():
    lines = [line.rpartition("*")[0] for line in epoch(None, NOW, 6, ALL).decode().splitlines()]
    assert lines == [
        "$GPZDA,000018.47,27,11,2026,00,00",
        "$GPRMC,000018.47,V,,,,,,,271126,,,N,V",
        "$GPGGA,000018.47,,,,,0,00,,,M,,M,,",
        "$GPGBS,000018.47,,,,,,,",
        "$GPGST,000018.47,,,,,,,",
        "$GPGLL,,,,,000018.47,V,N",
    ]
    told = parsed(None)
    assert (told["GGA"].quality, told["RMC"].status, told["GLL"].status) == (0, "V", "V")


def test_what_the_fix_lacks_is_left_out():
    bare = dataclasses.replace(FIX, heading_deg=None, altitude_m=None)
    told = parsed(bare)
    assert "HDT" not in told
    assert fields_of(bare, "GGA")[8] == ""


def test_only_the_sentences_asked_for_are_sent():
    assert list(parsed(FIX, kinds=("GST", "GGA"))) == ["GGA", "GST"]


@pytest.mark.parametrize("heading_deg", [359.96, 0.0, 0.04])
def test_a_heading_of_north_is_never_360(heading_deg):
    assert fields_of(dataclasses.replace(FIX, heading_deg=heading_deg), "HDT") == ["0.0", "T"]


def test_a_second_is_cut_off_and_not_rounded_up_to_60():
    late = datetime(2026, 12, 31, 23, 59, 59, 999_999, tzinfo=UTC)
    assert fields_of(None, "ZDA", late) == ["235959.99", "31", "12", "2026", "00", "00"]


@given(
    lat_deg=st.floats(-90.0, 90.0),
    lon_deg=st.floats(-180.0, 180.0),
    utc=st.datetimes(datetime(2000, 1, 1), datetime(2068, 12, 31), timezones=st.just(UTC)),
    sigma_m=st.floats(0.001, 99_999.0),
    altitude_m=st.floats(-500.0, 9000.0),
)
@example(lat_deg=45.9999999999, lon_deg=-122.99999999999, utc=NOW, sigma_m=1.0, altitude_m=0.0)
@example(lat_deg=90.0, lon_deg=180.0, utc=NOW, sigma_m=1.0, altitude_m=-0.04)
@example(lat_deg=-90.0, lon_deg=-180.0, utc=NOW, sigma_m=1.0, altitude_m=0.0)
@example(lat_deg=0.0, lon_deg=-1e-9, utc=NOW, sigma_m=1.0, altitude_m=0.0)
def test_every_place_and_time_makes_sentences_that_read_back(lat_deg, lon_deg, utc, sigma_m, altitude_m):
    fix = dataclasses.replace(
        FIX,
        captured=dataclasses.replace(FIX.captured, utc=utc),
        lat_deg=lat_deg,
        lon_deg=lon_deg,
        altitude_m=altitude_m,
        sigma_major_m=sigma_m,
    )
    for line in epoch(fix, utc, 6, ALL).decode("ascii").splitlines():
        assert len(line) + 2 <= 82  # NMEA 0183's longest sentence
        body, _, check = line[1:].partition("*")
        assert int(check, 16) == reduce(lambda xor, letter: xor ^ ord(letter), body, 0)
    told = parsed(fix, utc)
    for kind in ("GGA", "RMC", "GLL"):
        assert told[kind].lat == pytest.approx(lat_deg, abs=0.51e-5 / 60 + 1e-9)
        assert told[kind].lon == pytest.approx(lon_deg, abs=0.51e-5 / 60 + 1e-9)
    assert utc - datetime.combine(told["RMC"].date, told["RMC"].time, UTC) < timedelta(milliseconds=10)


@given(st.floats(0.0, 180.0))
@example(59.999999999 / 60.0)
@example(179.99999999999)
def test_minutes_stay_below_60(angle_deg):
    text = degrees_minutes(angle_deg, 3)
    assert re.fullmatch(r"\d{5}\.\d{5}", text)
    assert float(text[3:]) < 60.0
    assert int(text[:3]) + float(text[3:]) / 60.0 == pytest.approx(angle_deg, abs=0.51e-5 / 60 + 1e-12)


@pytest.mark.parametrize("year", [1970, 2016, 2106])
def test_a_clock_that_cannot_be_right_gives_no_date_to_set_another_by(year):
    wrong = datetime(year, 1, 1, 0, 2, 3, tzinfo=UTC)
    for fix in (published(an_answer(utc=wrong)), None):
        told = epoch(fix, wrong + timedelta(seconds=20), 6, ALL, dated=False).decode()
        assert "ZDA" not in told
        rmc = next(line for line in told.splitlines() if "RMC" in line).split(",")
        assert (rmc[1][:6], rmc[9]) == ("000203" if fix else "000223", "")
