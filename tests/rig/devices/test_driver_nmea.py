"""NMEA and Vaisala messages: golden sentences, what must not be trusted, an independent parser as oracle."""

from datetime import UTC, datetime

import pynmeagps
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.clock import Instant
from rig.devices.readings import HeadingReading, PressureReading
from rig.devices.sensors.nmea import checksum, parse_heading, parse_pressure, parse_sentence
from rig.devices.sensors.vaisala import parse_pa50
from rig.errors import MessageError

AT = Instant(12.5, datetime(2026, 11, 23, 4, 31, 51, tzinfo=UTC))


def heading(line: str) -> HeadingReading | None:
    return parse_heading(parse_sentence(line.encode()), AT)


def pressure(line: str) -> PressureReading | None:
    return parse_pressure(parse_sentence(line.encode()), AT)


def has_checksum(body: str) -> str:
    """The sentence with that body and the right checksum."""
    return f"${body}*{checksum(body.encode()):02X}"


HEADINGS = [
    ("$HCHDG,98.3,0.0,E,12.6,W*57", 98.3, "magnetic", -12.6),
    ("$HCHDG,101.1,,,7.1,W*3C", 101.1, "magnetic", -7.1),
    ("$HCHDG,359.9,,,2.5,E*28", 359.9, "magnetic", 2.5),
    ("$HCHDG,0.1,,,2.5,E*2F", 0.1, "magnetic", 2.5),
    ("$HCHDM,238.5,M*25", 238.5, "magnetic", None),
    ("$GPHDT,274.07,T*03", 274.07, "true", None),
    ("$GPHDT,123.456,T*32", 123.456, "true", None),
    ("$HCHDT,128.0,T*22", 128.0, "true", None),
    ("$HCTHS,77.5,E*1A", 77.5, "true", None),
    ("$PTNTHPR,85.9,N,-0.9,N,0.8,N*2C", 85.9, "magnetic", None),
    ("$OHPR,237.7,-14.3,175.5,30.1*2B", 237.7, "magnetic", None),
    ("$OHPR,78.8,-0.5,-1.4,-0.009,-0.025,0.976*34", 78.8, "magnetic", None),
]


@pytest.mark.parametrize(("line", "heading_deg", "reference", "variation_deg"), HEADINGS)
def test_golden_headings(line, heading_deg, reference, variation_deg):
    reading = heading(line)
    assert reading is not None
    assert reading.heading_deg == pytest.approx(heading_deg)
    assert (reading.reference, reading.variation_deg) == (reference, variation_deg)
    assert (reading.monotonic_s, reading.utc) == (AT.monotonic_s, AT.utc)


@pytest.mark.parametrize(
    ("line", "pitch_deg", "roll_deg"),
    [
        ("$PTNTHPR,85.9,N,-0.9,N,0.8,N*2C", -0.9, 0.8),
        ("$PTNTHPR,354.9,N,5.2,N,0.2,N*3A", 5.2, 0.2),
        ("$PTNTHPR,240.1,N,0.8,N,2.2,N*3B", 0.8, 2.2),
        ("$PTNTHPR,130.7,N,-9.1,N,1.2,N*17", -9.1, 1.2),
        ("$OHPR,237.7,-14.3,175.5,30.1*2B", -14.3, 175.5),
        ("$OHPR,78.8,-0.5,-1.4,-0.009,-0.025,0.976*34", -0.5, -1.4),
        ("$HCHDM,238.5,M*25", None, None),
    ],
)
def test_pitch_and_roll_where_they_are_sent(line, pitch_deg, roll_deg):
    reading = heading(line)
    assert reading is not None
    assert (reading.pitch_deg, reading.roll_deg) == (pitch_deg, roll_deg)


@pytest.mark.parametrize(
    ("body", "heading_deg"),
    [
        ("HCHDG,10.0,2.5,E,,", 12.5),
        ("HCHDG,10.0,2.5,W,,", 7.5),
        ("HCHDG,1.0,2.5,W,,", 358.5),
        ("HCHDG,359.0,2.5,E,,", 1.5),
        ("HCHDM,360.0,M", 0.0),
    ],
)
def test_deviation_is_applied_and_the_heading_stays_below_360(body, heading_deg):
    reading = heading(has_checksum(body))
    assert reading is not None
    assert reading.heading_deg == pytest.approx(heading_deg)


@pytest.mark.parametrize(
    ("body", "problem"),
    [
        ("HEHDT,,T", "HEHDT has no value in field 1"),
        ("HCHDM", "has no value"),
        ("HCHDM,abc,M", "'abc' in field 1 instead of a number"),
        ("HCHDM,nan,M", "instead of a number"),
        ("HCHDM,1e5,M", "instead of a number"),
        ("HCHDM,360.1,M", "the heading 360.1, not 0 to 360"),
        ("HCHDM,-0.1,M", "not 0 to 360"),
        ("PTNTHPR,6400,N,0,N,0,N", "not 0 to 360"),  # mils
        ("HCHDG,10.0,2.5,,,", "'' in field 3 instead of E or W"),
        ("HCHDG,10.0,,,3.0,X", "'X' in field 5 instead of E or W"),
        ("HCTHS,77.5,V", "the mode 'V'"),
        ("HCTHS,77.5,S", "the mode 'S'"),
        ("HCTHS,77.5", "the mode ''"),
        ("PTNTHPR,85.9,P,-0.9,N,0.8,N", "the heading status 'P'"),
        ("PTNTHPR,85.9,N,-0.9,L,0.8,N", "the pitch status 'L'"),
        ("PTNTHPR,85.9,N,-0.9,N,0.8,C", "the roll status 'C'"),
        ("OHPR,237.7,-14.3", "OHPR has no value in field 3"),
    ],
)
def test_headings_that_must_not_be_trusted(body, problem):
    with pytest.raises(MessageError, match=problem):
        heading(has_checksum(body))


@pytest.mark.parametrize(
    ("body", "variation_deg"),
    [
        ("HCHDG,98.3,0.0,,0.0,", None),
        ("HCHDG,98.3,,,12.6,", None),
        ("HCHDG,98.3,0.0,,12.6,E", 12.6),
        ("HCHDG,98.3,180.0,E,12.6,W", -12.6),
        ("HCHDG,98.3,999.9,E,999.9,E", None),
    ],
)
def test_a_filler_beside_a_heading_leaves_the_heading_as_it_is(body, variation_deg):
    found = heading(has_checksum(body))
    assert (found.heading_deg, found.deviation_deg, found.variation_deg) == (98.3, 0.0, variation_deg)


@pytest.mark.parametrize("body", ["GPGGA,1,2,3", "WIMDA,29.3,I", "PTNTHTM,14223,N,169,N", "HCXHDT,1", ""])
def test_other_sentences_are_no_heading(body):
    assert heading(has_checksum(body)) is None


PRESSURES = [
    ("$IIXDR,P,1.02481,B,Barometer*29", 1024.81, None),
    ("$WIXDR,C,+023.0,C,TEMP,P,1.0199,B,PRESS,H,039.6,P,RH*33", 1019.9, 23.0),
    ("$WIXDR,P,1028.1,H,0*6C", 1028.1, None),
    ("$WIXDR,P,101325,P,BARO*4A", 1013.25, None),
    ("$WIMDA,29.2878,I,0.9918,B,18.8,C,,,,,,,,,,,,,,*36", 991.8, 18.8),
]


@pytest.mark.parametrize(("line", "pressure_hpa", "temperature_c"), PRESSURES)
def test_golden_pressures(line, pressure_hpa, temperature_c):
    reading = pressure(line)
    assert reading is not None
    assert reading.pressure_hpa == pytest.approx(pressure_hpa)
    assert reading.temperature_c == temperature_c


def test_mda_without_bar_has_inches_of_mercury():
    reading = pressure(has_checksum("WIMDA,29.2878,I,,,18.8,C"))
    assert reading is not None
    assert reading.pressure_hpa == pytest.approx(991.8, abs=0.05)


@pytest.mark.parametrize(
    "line", ["$YXXDR,A,-0.5,D,PITCH,A,1.2,D,ROLL*3F", has_checksum("WIXDR,H,039.6,P,RH")]
)
def test_an_xdr_of_other_transducers_has_no_pressure(line):
    assert pressure(line) is None


@pytest.mark.parametrize(
    "body", ["WIXDR,P,,B,X", "WIXDR,P,101.3,B,X", "WIXDR,P,0,H,X", "WIMDA,,I,,B,18.8,C", "WIMDA,0.0,I,0.0,B"]
)
def test_pressures_that_must_not_be_trusted(body):
    with pytest.raises(MessageError):
        pressure(has_checksum(body))


@pytest.mark.parametrize(
    ("line", "problem"),
    [
        ("$IIXDR,P,1.02481,B,Barometer*0D", "has the checksum 29"),
        ("$HCHDM,238.5,M", "no NMEA sentence with a checksum"),
        ("HCHDM,238.5,M*25", "no NMEA sentence"),
        ("$HCHDM,238.5,M*2", "no NMEA sentence"),
        ("$HCHDM,23*8.5,M*25", "no NMEA sentence"),
        ("", "no NMEA sentence"),
    ],
)
def test_lines_that_are_damaged(line, problem):
    with pytest.raises(MessageError, match=problem):
        parse_sentence(line.encode())


@pytest.mark.parametrize("before", [b"", b"\x00\xff\xfe", b"8.5,M*25", b"$HCHDM,2", b"$GPGGA,1*00"])
def test_a_sentence_is_found_after_garbage_on_its_line(before):
    assert parse_sentence(before + b"$HCHDM,238.5,M*25\r\n").fields == ("238.5", "M")


@given(st.binary(max_size=120))
def test_any_bytes_give_a_sentence_or_a_message_error(line):
    try:
        sentence = parse_sentence(line)
    except MessageError:
        return
    assert has_checksum(",".join([sentence.address, *sentence.fields])).encode()[:-2] in line


field_text = st.text("0123456789.-+,NEWTMABCHP ", max_size=40)


@given(st.sampled_from(["HCHDG", "HCHDM", "HCHDT", "HCTHS", "PTNTHPR", "OHPR", "WIXDR", "WIMDA"]), field_text)
def test_any_fields_give_a_reading_in_range_or_a_message_error(address, fields):
    try:
        sentence = parse_sentence(has_checksum(f"{address},{fields}").encode())
        reading, barometer = parse_heading(sentence, AT), parse_pressure(sentence, AT)
    except MessageError:
        return
    assert reading is None or 0.0 <= reading.heading_deg < 360.0
    assert barometer is None or 300.0 <= barometer.pressure_hpa <= 1250.0


@given(st.floats(0, 359.9), st.floats(-30, 30), st.sampled_from(["HDG", "HDM", "HDT", "THS"]))
def test_an_independent_library_reads_the_same(heading_deg, variation_deg, kind):
    side = "E" if variation_deg >= 0 else "W"
    body = {
        "HDG": f"HCHDG,{heading_deg:.1f},,,{abs(variation_deg):.1f},{side}",
        "HDM": f"HCHDM,{heading_deg:.1f},M",
        "HDT": f"HCHDT,{heading_deg:.1f},T",
        "THS": f"HCTHS,{heading_deg:.1f},A",
    }[kind]
    line = has_checksum(body)
    theirs = pynmeagps.NMEAReader.parse(line + "\r\n")
    ours = heading(line)
    assert ours is not None
    names = {"HDG": "headingM", "HDM": "headingM", "HDT": "headingT", "THS": "headt"}
    assert ours.heading_deg == pytest.approx(vars(theirs)[names[kind]])


def test_an_independent_library_refuses_the_same_checksum():
    with pytest.raises(pynmeagps.NMEAParseError):
        pynmeagps.NMEAReader.parse("$IIXDR,P,1.02481,B,Barometer*0D\r\n")


PA50 = [
    (b"\x01P\x021 1009.18 ***.* * 1009.2 1009.2 1009.2 000\x03D6", 1009.18),
    (b"\x01P\x021  1007.14 ***.* * 1007.2 1007.1 1007.1 000\x03E8", 1007.14),
]


def pa50(body: bytes) -> bytes:
    message = b"\x01P\x02" + body + b"\x03"
    return message + f"{sum(message) % 256:02X}".encode()


@pytest.mark.parametrize(("line", "pressure_hpa"), PA50)
def test_golden_pa50(line, pressure_hpa):
    assert parse_pa50(line, AT).pressure_hpa == pressure_hpa
    assert parse_pa50(b"E8\r\n\x00" + line + b"\r\n", AT).pressure_hpa == pressure_hpa


@pytest.mark.parametrize(
    ("line", "problem"),
    [
        (PA50[0][0][:-2] + b"D7", "has the checksum D6, not D7"),
        (PA50[0][0][:-2], "is no PA50 message"),
        (PA50[0][0][1:], "is no PA50 message"),
        (pa50(b"1 ****.** ***.* * ****.* 1009.2 1009.2 000"), "instead of a pressure"),
        (pa50(b"1 / / / / / / 000"), "'/' instead of a pressure"),
        (pa50(b"1 1009.18 ***.* * 1009.2 1009.2 1009.2 010"), "the barometer reports the error 010"),
        (pa50(b"1 1009.18 000"), "has 2 values instead of 7"),
        (pa50(b"1 9.18 ***.* * 1009.2 1009.2 1009.2 000"), "is no air pressure"),
    ],
)
def test_pa50_messages_that_must_not_be_trusted(line, problem):
    with pytest.raises(MessageError, match=problem):
        parse_pa50(line, AT)


@given(st.binary(max_size=80) | st.binary(max_size=40).map(pa50))
def test_any_bytes_give_a_pa50_pressure_in_range_or_a_message_error(line):
    try:
        reading = parse_pa50(line, AT)
    except MessageError:
        return
    assert 300.0 <= reading.pressure_hpa <= 1250.0
