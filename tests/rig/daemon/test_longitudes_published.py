"""Longitudes as NMEA and MAVLink have them, whatever those of the elevation model are."""

import dataclasses

import pytest
from fakes.answers import CAPTURED_UTC, an_answer
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common
from pynmeagps import NMEAReader
from pyproj import Transformer

from localizer.fix import Fix, Position
from rig.calibrate.boresight.known_place import parse_place
from rig.clock import Instant
from rig.config.run import NmeaOutput
from rig.config.sections import Place
from rig.daemon.publish.mavlink_messages import external_position_estimate, gps_input
from rig.daemon.publish.nmea_sentences import epoch
from rig.daemon.publish.published import published
from rig.daemon.spool.index import ANSWER

ALL = NmeaOutput().sentences


def at(lon_deg, lat_deg=34.3, crs="EPSG:32611"):
    x, y = Transformer.from_crs("EPSG:4326", crs, always_xy=True).transform(lon_deg, lat_deg)
    place = Position(
        easting_m=x, northing_m=y, crs=crs, lat_deg=lat_deg, lon_deg=lon_deg, ground_m=1.0, row=1.0, col=1.0
    )
    return an_answer(position=place)


@pytest.mark.parametrize(
    ("lon_deg", "crs", "east", "minutes"),
    [
        (241.78, "EPSG:32611", "W", "11813.20000"),
        (180.01, "EPSG:32601", "W", "17959.40000"),
        (-180.01, "EPSG:32660", "E", "17959.40000"),
        (179.99, "EPSG:32660", "E", "17959.40000"),
    ],
)
def test_nmea_has_no_longitude_beyond_180(lon_deg, crs, east, minutes):
    lines = epoch(published(at(lon_deg, crs=crs)), CAPTURED_UTC, 6, ALL).splitlines(keepends=True)
    for kind, index in (("RMC", 5), ("GGA", 4), ("GLL", 3)):
        (line,) = [line for line in lines if line[3:6] == kind.encode()]
        fields = line.decode().partition("*")[0].split(",")
        assert (fields[index], fields[index + 1]) == (minutes, east)
        assert NMEAReader.parse(line, validate=1).lon == pytest.approx(
            (lon_deg + 180.0) % 360.0 - 180.0, abs=1e-6
        )


@given(st.floats(-720.0, 720.0))
def test_mavlink_s_integer_always_fits(lon_deg):
    fix = dataclasses.replace(published(an_answer()), lon_deg=(lon_deg + 180.0) % 360.0 - 180.0)
    now = Instant.now()
    for message, field in (
        (external_position_estimate(common, fix, now, 1), "y"),
        (gps_input(common, fix, now.utc), "lon"),
    ):
        packed = message.pack(common.MAVLink(None, srcSystem=1, srcComponent=197))
        read = getattr(common.MAVLink(None).parse_buffer(packed)[0], field)
        assert -1_800_000_000 <= read < 1_800_000_000
        turns = (read / 1e7 - lon_deg) / 360.0
        assert turns == pytest.approx(round(turns), abs=1e-9)


def test_an_answer_that_was_stored_by_an_earlier_version_is_wrapped_when_it_is_read():
    text = ANSWER.dump_json(at(-118.22), by_alias=True).decode()
    old = text.replace('"lon_deg":-118.22', '"lon_deg":241.78')
    assert old != text
    answer = ANSWER.validate_json(old)
    assert answer.fix.position.lon_deg == pytest.approx(-118.22)
    assert Fix.model_validate_json(answer.fix.to_json()).position.lon_deg == pytest.approx(-118.22)
    assert published(answer).lon_deg == pytest.approx(-118.22)


def test_a_place_may_be_configured_and_named_in_either_convention():
    assert Place(lat_deg=34.3, lon_deg=241.8).lon_deg == pytest.approx(-118.2)
    assert Place(lat_deg=34.3, lon_deg=180.0).lon_deg == -180.0
    for text in ("34.3,241.8", "34.3,-118.2"):
        assert parse_place(text) == pytest.approx((34.3, -118.2))
    with pytest.raises(ValueError, match="no place on Earth"):
        parse_place("34.3,541.8")
