"""Lines of other people's instruments, played on a serial port: what the drivers make of each."""

import re
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from fakes.line import Line
from fakes.timebases import FastClock, on
from hypothesis import given
from hypothesis import strategies as st

from rig.clock import Instant
from rig.devices.bus.deadline import Deadline
from rig.devices.readings import HeadingReading, PressureReading
from rig.devices.sensors import talker
from rig.devices.sensors.nmea import checksum, parse_heading, parse_pressure, parse_sentence
from rig.devices.sensors.talker import LineReader, Talker, nmea_barometer, nmea_compass, vaisala_pa50
from rig.errors import DeviceError, MessageError, TransientError
from rig.fault_notes import collecting

REPORTS = Path(__file__).parents[2] / "logs" / "nmea"
SOON_S = 0.25
HPA_PER_INHG = 33.86389


def reported(name: str) -> bytes:
    """The bytes of a report."""
    (path,) = REPORTS.glob(f"{name}-*.nmea")
    return path.read_bytes()


def has_checksum(*bodies: str) -> bytes:
    """Sentences with their checksums."""
    return b"".join(f"${body}*{checksum(body.encode()):02X}\r\n".encode() for body in bodies)


@pytest.fixture
def line() -> Iterator[Line]:
    line = Line()
    yield line
    line.unplug()


@pytest.fixture(autouse=True)
def in_haste(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Without time for the survey of the line; and what does not come is given up after a fifth of the time."""
    monkeypatch.setattr(talker, "SURVEY_S", 0.0)
    monkeypatch.setattr(talker, "COMPASS_SURVEY_S", 0.0)
    with on(FastClock(5.0)):
        yield


@pytest.fixture
def hear(line: Line, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Any]]:
    """Sends bytes to a driver: ``hear(nmea_compass, data, key=...)`` returns its readings."""
    monkeypatch.setattr(talker, "DEFAULT_TIMEOUT_S", SOON_S)
    opened: list[Talker[Any]] = []

    def hear(driver: Callable[..., Talker[Any]], data: bytes, **keys: Any) -> Any:
        device = driver(line.path, 4800, **keys)
        opened.append(device)
        device._lines.discard()  # as ``read`` does, but before anything is said
        line.say(data)
        readings = [device._next(SOON_S)]
        while True:
            try:
                readings.append(device._next(SOON_S))
            except TransientError:
                return readings

    yield hear
    for device in opened:
        device.close()


def headings(readings: list[HeadingReading]) -> list[float]:
    return [reading.heading_deg for reading in readings]


class TestCompass:
    @pytest.mark.parametrize("name", ["n02", "n08", "n10"])
    def test_line_ends_tag_blocks_and_zeros_are_no_damage(self, hear: Callable[..., Any], name: str) -> None:
        with collecting() as faults:
            found = hear(nmea_compass, reported(name) * 2)
        assert set(headings(found)) == {237.5}
        assert not faults.all()

    @pytest.mark.parametrize(
        "data",
        [
            b"$HCHDM,237.5,M*2A" * 3,
            b"$HCHDM,237.5,M*2A\n\r" * 3,
            b"$HCHDM,237.5,M*2A\x00" * 3,
            b"\x00$HCHDM,237.5,M*2A\r\n" * 3,
            b"$HCHDM,237.5,M*2A\r\x00\n" * 3,
            b"$HCHDM,237.5,M*2A\xff\r\n" * 3,
            b"$HCHDM,237.5,M*2a \t\r\n" * 3,
            b"$HCHDM,237.5,M*2A\x03\r\n$HCHDM,237.5,M*2A\x0c\r\n" * 3,
            b"\\g:1-2-73874,n:157036,s:r003669945,c:1241544035*4A\\$HCHDM,237.5,M*2A\r\n" * 3,
        ],
    )
    def test_other_ends_and_beginnings(self, hear: Callable[..., Any], data: bytes) -> None:
        with collecting() as faults:
            found = hear(nmea_compass, data)
        assert len(found) >= 2
        assert set(headings(found)) == {237.5}
        assert not faults.all()

    def test_the_factory_format_of_oceanserver_is_read(self, hear: Callable[..., Any]) -> None:
        (found,) = hear(nmea_compass, reported("n13"))
        assert (found.heading_deg, found.reference) == (320.5, "magnetic")
        assert (found.pitch_deg, found.roll_deg, found.resolution_deg) == (0.2, -18.3, pytest.approx(0.1))

    def test_more_letters_of_that_format_and_an_error_code(self, hear: Callable[..., Any]) -> None:
        whole = has_checksum("C68.2P1.5R-2.1T23.5D0.00Mx12.1My-3.5Mz40.2Ax0.1Ay0.2Az0.98")
        assert headings(hear(nmea_compass, whole)) == [68.2]
        with pytest.raises(TransientError, match=r"\$C has the error code E001: not to be used"):
            hear(nmea_compass, has_checksum("C328.3P28.4R-12.4X55.11Y12.33Z-18.43T22.3E001"))
        assert headings(
            hear(nmea_compass, has_checksum("C328.3P28.4R-12.4X55.11Y12.33Z-18.43T22.3E000"))
        ) == [328.3]

    def test_no_heading_now_is_not_damage(self, hear: Callable[..., Any]) -> None:
        for sentence in reported("n07").splitlines(keepends=True):
            with pytest.raises(TransientError, match=r"no value in field 1 now|mode 'V'") as caught:
                hear(nmea_compass, sentence)
            assert "baud" not in str(caught.value)
            assert "damaged" not in str(caught.value)
            assert "wait until the instrument has a value" in str(caught.value)

    @pytest.mark.parametrize(
        ("body", "said"),
        [
            ("HCHDT,237.5,M", "has 'M' in field 2 instead of T; the sentence contradicts itself"),
            ("HCHDM,237.5,T", "has 'T' in field 2 instead of M; the sentence contradicts itself"),
            ("GPTHS,77.5,M", "the mode 'M': not a measured heading"),
            ("GPTHS,77.5,S", "the mode 'S': not a measured heading"),
            ("GPTHS,77.5,V", "the mode 'V': not a measured heading"),
            ("HCHDG,999.9,,,,", "the heading 999.9, not 0 to 360"),
            ("HCHDM,XXX,M", "'XXX' in field 1 instead of a number"),
            ("PTNTHPR,85.9,C,-0.9,N,0.8,N", "the heading status 'C': not to be used"),
        ],
    )
    def test_a_claim_that_is_no_measured_heading(
        self, hear: Callable[..., Any], body: str, said: str
    ) -> None:
        with pytest.raises(TransientError, match=re.escape(said)) as caught:
            hear(nmea_compass, has_checksum(body))
        assert "baud" not in str(caught.value)

    def test_an_estimated_heading_is_marked(self, hear: Callable[..., Any]) -> None:
        assert [r.estimated for r in hear(nmea_compass, has_checksum("GPTHS,77.5,E", "GPTHS,77.5,A"))] == [
            True,
            False,
        ]

    def test_no_checksum_needs_a_key(self, hear: Callable[..., Any]) -> None:
        with pytest.raises(
            TransientError, match=r"ends without one; switch .* or say require_checksum = false"
        ):
            hear(nmea_compass, reported("n01"))
        assert headings(hear(nmea_compass, reported("n01"), require_checksum=False)) == [237.5, 237.5]

    def test_a_star_without_a_checksum_is_none(self, hear: Callable[..., Any]) -> None:
        data = b"$HCHDM,237.5,M*\r\n"
        with pytest.raises(TransientError, match="ends without one"):
            hear(nmea_compass, data)
        assert headings(hear(nmea_compass, data, require_checksum=False)) == [237.5]
        with collecting() as faults:
            assert headings(
                hear(nmea_compass, has_checksum("HCHDM,1.0,M") + data, require_checksum=False)
            ) == [1.0]
        assert [note.problem for note in faults.all()] == ["sent a damaged line"]

    def test_without_checksums_a_sentence_has_to_be_complete(self, hear: Callable[..., Any]) -> None:
        cut = b"$HCHDM,23\r\n$HCHDM,237.5\r\n$HCHDM,237.5,\r\n$HCHDG,237.5,,\r\n$HCHDM,237.6,M\r\n"
        assert headings(hear(nmea_compass, cut, require_checksum=False)) == [237.6]

    def test_a_checksum_that_is_missing_once_is_damage(self, hear: Callable[..., Any]) -> None:
        mixed = has_checksum("HCHDM,1.0,M") + b"$HCHDM,200.0,M\r\n" + has_checksum("HCHDM,2.0,M")
        with collecting() as faults:
            assert headings(hear(nmea_compass, mixed, require_checksum=False)) == [1.0, 2.0]
        assert [note.problem for note in faults.all()] == ["sent a damaged line"]

    def test_other_sentences_need_no_checksum(self, hear: Callable[..., Any]) -> None:
        with collecting() as faults:
            assert headings(
                hear(nmea_compass, b"$RPYL,15,9,314,11,0,1009,0\r\n" + has_checksum("HCHDM,1.0,M"))
            ) == [1.0]
        assert not faults.all()

    def test_a_checksum_of_one_digit_counts_if_it_is_right(self, hear: Callable[..., Any]) -> None:
        body = "GPTHS,10.0,A"
        assert checksum(body.encode()) < 16
        short = f"${body}*{checksum(body.encode()):X}\r\n".encode()
        assert len(hear(nmea_compass, short)) == 1
        with pytest.raises(TransientError, match="damaged"):
            hear(nmea_compass, b"$HCHDM,237.5,M*2\r\n")

    def test_a_second_compass_is_heard_however_short_the_first_reading(
        self, line: Line, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(talker, "COMPASS_SURVEY_S", 0.5)
        compass = nmea_compass(line.path, 4800)
        line.say_soon(*[has_checksum("HCHDM,10.0,M", "TIHDM,30.0,M")] * 3, every_s=0.15)
        assert {reading.source for reading in compass.read_many(0.01)} == {"HCHDM", "TIHDM"}
        compass.close()

    def test_one_sentence_can_be_chosen(self, hear: Callable[..., Any]) -> None:
        both = has_checksum("HCHDG,10.0,,,3.0,E", "GPHDT,50.0,T")
        assert headings(hear(nmea_compass, both, sentence="HDT")) == [50.0]
        assert headings(hear(nmea_compass, both, sentence="HCHDG")) == [10.0]

    @pytest.mark.parametrize(
        ("data", "said"),
        [
            (b"\xb5\x62\x01\x07\x5c\x00" * 40, "u-blox UBX"),
            (b"85.9,-0.9,0.8\r\n" * 3, "plain numbers: b'85.9,-0.9,0.8'"),
            (b'{"heading": 85.9}\r\n', "JSON"),
            (b"Heading 85.9 deg\r\n" * 3, "text that is no NMEA: b'Heading 85.9 deg'"),
            ("Kurs 85.9° magnetisch\r\n".encode() * 3, "text that is no NMEA"),
            (b"\x01P\x021 1009.18 ***.* * 1009.2 1009.2 1009.2 000\x03D6\r\n", "Vaisala PA50"),
            (
                b"$\xc8C\xc8D\xcd,\xb237.5,\xcd\xaa2A\x8d\n" * 3,
                "HCHDM with parity bits: 8 data bits without parity",
            ),
            (b"!AIVDM,1,1,,A,13u?etPv2;0n:dDPwUM1U1Cb069D,0*24\r\n", "AIVDM"),
        ],
    )
    def test_another_family_is_named(self, hear: Callable[..., Any], data: bytes, said: str) -> None:
        with pytest.raises(TransientError, match="set the instrument to send") as caught:
            hear(nmea_compass, data)
        assert said in str(caught.value)
        assert "damaged" not in str(caught.value)

    def test_garbage_is_another_baud_rate(self, hear: Callable[..., Any]) -> None:
        noise = bytes(byte ^ 0xA5 for byte in has_checksum("HCHDM,237.5,M") * 5)  # no line end among them
        with pytest.raises(
            TransientError, match=r"damaged: .* no text; check `baud` and the cable"
        ) as caught:
            hear(nmea_compass, noise)
        assert "4800 is set, usual are 9600, 38400, 19200, 115200, 57600" in str(caught.value)

    def test_text_that_is_cut_is_damage_at_the_right_rate(self, hear: Callable[..., Any]) -> None:
        with pytest.raises(TransientError, match=r"damaged: .*; check `baud` and the cable$"):
            hear(nmea_compass, b"237.5,M*2A\r\n$HCHDM,237.6,M*2A\r\n")

    def test_the_most_informative_line_is_reported(self, hear: Callable[..., Any]) -> None:
        """A line that was cut when the port was opened must not hide that the compass has no heading."""
        data = has_checksum("HCHDG,,,,,", "GPZDA,1") + b"\xff\x80\x12\r\n"
        with pytest.raises(TransientError, match="HCHDG has no value in field 1 now"):
            hear(nmea_compass, data)


def air(readings: list[PressureReading]) -> list[float]:
    return [round(reading.pressure_hpa, 3) for reading in readings]


class TestBarometer:
    @pytest.mark.parametrize("name", ["b02", "b03"])
    def test_the_barometer_among_other_transducers(self, hear: Callable[..., Any], name: str) -> None:
        with collecting() as faults:
            found = hear(nmea_barometer, reported(name))
        assert set(air(found)) == {968.7}
        assert {reading.source for reading in found} == {"WIXDR Barometer"}
        assert not faults.all()

    @pytest.mark.parametrize(
        ("body", "pressure_hpa"),
        [
            ("WIXDR,P,95000,P,ENGINEBOOST#0,P,0.9687,B,Barometer", 968.7),
            ("WIXDR,P,0.9500,B,CABIN,P,0.9687,B,BARO", 968.7),
            ("WIXDR,P,0.9687,B,,P,1.6,B,", 968.7),
            ("WIXDR,P,XXX,B,BARO1,P,0.9687,B,BARO2", 968.7),
            ("WIXDR,P,9999.9,H,PTB#0,P,968.7,H,PTB#1", 968.7),
            ("YXXDR,P,0.9687,B", 968.7),
            ("WIXDR,C,21.0,C,TEMP,G,1,,X,P,96870,P,AIRP", 968.7),
            ("WIXDR,P,1.0248,B,QNH,P,0.9687,B,QFE", 968.7),
            ("WIXDR,P,1.0248,B,SeaLevelPressure,P,0.9687,B,StationPressure", 968.7),
            ("WIXDR,P,1024.8,H,PRES_SEA,P,968.7,H,1", 968.7),
            ("WIXDR,P,968.7,hPa,Barometer", 968.7),
            ("WIXDR,P,96.87,kPa,Barometer", 968.7),
            ("WIXDR,P,726.58,mmHg,Barometer", 968.694),
            ("WIXDR,P,28.606,I,Barometer", 968.71),
        ],
    )
    def test_the_first_plausible_one_that_is_the_air_s(
        self, hear: Callable[..., Any], body: str, pressure_hpa: float
    ) -> None:
        assert air(hear(nmea_barometer, has_checksum(body))) == [pressure_hpa]

    def test_a_name_chooses(self, hear: Callable[..., Any]) -> None:
        body = "WIXDR,P,0.9687,B,Barometer,P,95000,P,ENGINEBOOST#0"
        assert air(hear(nmea_barometer, has_checksum(body), transducer="engineboost#0")) == [950.0]
        both = has_checksum(body, "WIMDA,28.6057,I,0.9687,B,18.8,C")
        assert {r.source for r in hear(nmea_barometer, both, transducer="WIMDA")} == {"WIMDA"}
        with pytest.raises(TransientError, match="with a pressure of OTHER within"):
            hear(nmea_barometer, has_checksum(body), transducer="OTHER")

    def test_machines_are_no_barometer(self, hear: Callable[..., Any]) -> None:
        with pytest.raises(TransientError, match="set the instrument to send"):
            hear(nmea_barometer, has_checksum("ERXDR,P,100300,P,ENGINEOIL#0"))

    @pytest.mark.parametrize(
        "name", ["QNH", "QFF", "MSLP", "SeaLevelPressure", "PRES_SEA", "RelativePressure"]
    )
    def test_a_pressure_of_sea_level_says_no_altitude(self, hear: Callable[..., Any], name: str) -> None:
        body = f"WIXDR,P,1.0248,B,{name}"
        with pytest.raises(TransientError, match="reduced to sea level"):
            hear(nmea_barometer, has_checksum(body))
        assert air(hear(nmea_barometer, has_checksum(body), transducer=name)) == [1024.8]

    @pytest.mark.parametrize(
        ("body", "said", "pressure_hpa"),
        [
            ("IIXDR,P,1013.25,B,Barometer", "says 1013.25 B Barometer: taken for hPa", 1013.25),
            ("IIXDR,P,968.7,P,Barometer", "says 968.7 P Barometer: taken for hPa", 968.7),
            ("IIXDR,P,0.9687,H,Barometer", "says 0.9687 H Barometer: taken for bar", 968.7),
            ("IIXDR,P,96870,B,Barometer", "says 96870 B Barometer: taken for Pa", 968.7),
            ("IIXDR,P,968.7,,Barometer", "says 968.7 Barometer: taken for hPa", 968.7),
            ("WIMMB,,,968.7,B", "says 968.7 bar: taken for hPa", 968.7),
        ],
    )
    def test_a_unit_that_cannot_be_is_noted(
        self, line: Line, body: str, said: str, pressure_hpa: float
    ) -> None:
        barometer = nmea_barometer(line.path, 4800)
        line.say_soon(*[has_checksum(body)] * 40)
        with collecting() as faults:
            found = barometer.read_many(0.5)
        barometer.close()
        assert set(air(found)) == {pressure_hpa}
        assert [note.problem for note in faults.all()] == [said]

    def test_the_reported_line_is_hectopascals(self, hear: Callable[..., Any]) -> None:
        assert air(hear(nmea_barometer, reported("b05"))) == [1013.25]

    @pytest.mark.parametrize(
        "body",
        [
            *("IIXDR,P,300,B,FUELRAIL", "IIXDR,P,1013.25,B,X", "IIXDR,P,101.3,B,Barometer"),
            *("IIXDR,P,760.1,,Barometer", "IIXDR,P,760.1,T,Barometer"),  # hPa at 2,400 m, or mmHg at the sea
        ],
    )
    def test_a_unit_that_could_be_something_else_is_refused(
        self, hear: Callable[..., Any], body: str
    ) -> None:
        with pytest.raises(TransientError) as caught:
            hear(nmea_barometer, has_checksum(body))
        assert "baud" not in str(caught.value)

    @pytest.mark.parametrize(
        ("body", "resolution_hpa"),
        [
            ("IIXDR,P,0.97,B,Barometer", 10.0),
            ("IIXDR,P,1.00,B,Barometer", 10.0),
            ("IIXDR,P,0.9687,B,Barometer", 0.1),
            ("IIXDR,P,969,H,Barometer", 1.0),
            ("IIXDR,P,99900,P,Barometer", 1.0),  # NMEA 2000 has whole hectopascals, filled up with zeros
            ("IIXDR,P,0.9987,B,Barometer", 0.1),
            ("WIMDA,28.6057,I,0.97,B,18.8,C", 0.0001 * HPA_PER_INHG),
            ("WIMDA,28.61,I,0.9687,B,18.8,C", 0.1),
            ("WIMDA,28.61,I,,,18.8,C", 0.01 * HPA_PER_INHG),
        ],
    )
    def test_the_step_of_what_is_sent_is_known(
        self, hear: Callable[..., Any], body: str, resolution_hpa: float
    ) -> None:
        (found,) = hear(nmea_barometer, has_checksum(body))
        assert found.resolution_hpa == pytest.approx(resolution_hpa)

    def test_inches_are_taken_where_they_are_finer(self, hear: Callable[..., Any]) -> None:
        (found,) = hear(nmea_barometer, has_checksum("WIMDA,28.6057,I,0.97,B,18.8,C"))
        assert found.pressure_hpa == pytest.approx(968.7, abs=0.01)

    def test_inches_and_bar_that_do_not_agree_are_an_error(self, hear: Callable[..., Any]) -> None:
        with pytest.raises(TransientError, match=r"29\.92 inches and 0\.9687 bar, which do not agree"):
            hear(nmea_barometer, has_checksum("WIMDA,29.92,I,0.9687,B,18.8,C"))
        assert air(hear(nmea_barometer, has_checksum("WIMDA,0.0,I,0.9687,B,18.8,C"))) == [968.7], "a filler"

    @pytest.mark.parametrize(
        ("body", "temperature_c"),
        [
            ("WIXDR,C,291.95,K,TEMP,P,0.9687,B,Barometer", 18.8),
            ("WIXDR,C,65.84,F,TEMP,P,0.9687,B,Barometer", 18.8),
            ("WIXDR,C,89.5,C,ENGINE#0,P,0.9687,B,Barometer", None),
            ("WIXDR,C,999.9,C,TEMP,P,0.9687,B,Barometer", None),
            ("WIXDR,C,XXX,C,TEMP,P,0.9687,B,Barometer", None),
            ("WIXDR,C,2.1,K,TEMP,P,0.9687,B,Barometer", None),
            ("WIXDR,C,30,C,CABIN,C,18.8,C,Barometer,P,0.9687,B,Barometer", 18.8),
            ("WIMDA,28.6057,I,0.9687,B,XXX,C", None),
        ],
    )
    def test_the_air_s_temperature(
        self, hear: Callable[..., Any], body: str, temperature_c: float | None
    ) -> None:
        (found,) = hear(nmea_barometer, has_checksum(body))
        assert air([found]) == [968.7]
        assert found.temperature_c == (None if temperature_c is None else pytest.approx(temperature_c))

    def test_two_sentences_that_disagree_are_an_error(self, line: Line) -> None:
        barometer = nmea_barometer(line.path, 4800)
        line.say_soon(*[has_checksum("WIXDR,P,0.9687,B,Barometer", "IIXDR,P,0.9537,B,BARO2")] * 40)
        with pytest.raises(DeviceError, match=r"WIXDR Barometer 968\.7 hPa and IIXDR BARO2 953\.7 hPa; name"):
            barometer.read_many(0.5)
        barometer.close()

    def test_two_that_take_turns_are_heard_both(self, line: Line, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(talker, "SURVEY_S", 1.0)
        barometer = nmea_barometer(line.path, 4800)
        line.say_soon(
            *[has_checksum("WIXDR,P,0.9687,B,Barometer"), has_checksum("IIXDR,P,0.9537,B,BARO2")] * 2,
            every_s=0.4,
        )
        with pytest.raises(DeviceError, match="its sources do not agree"):
            barometer.read_many(0.1)
        barometer.close()

    def test_of_two_that_agree_the_finer_one_counts(self, line: Line) -> None:
        barometer = nmea_barometer(line.path, 4800)
        line.say_soon(*[has_checksum("WIXDR,P,0.97,B,Barometer", "IIXDR,P,0.9687,B,BARO2")] * 40)
        assert {reading.source for reading in barometer.read_many(0.5)} == {"IIXDR BARO2"}
        barometer.close()

    def test_a_vaisala_barometer_set_to_nmea_is_reported(self, hear: Callable[..., Any]) -> None:
        with pytest.raises(TransientError, match=r"NMEA 0183: WIXDR; .* give the right `kind`"):
            hear(vaisala_pa50, has_checksum("WIXDR,P,0.9687,B,Barometer"))

    def test_no_pressure_now(self, hear: Callable[..., Any]) -> None:
        for body in ("WIXDR,P,,B,Barometer", "WIMDA,,I,,B,18.8,C", "WIMMB,,I,,B"):
            with pytest.raises(TransientError, match=r"has no pressure now; wait until"):
                hear(nmea_barometer, has_checksum(body))


class Chunks:
    """A port that gives one chunk after the other."""

    path, baud = "chunks", 4800

    def __init__(self, chunks: list[bytes]) -> None:
        self.chunks = chunks

    def read(self, deadline: Deadline) -> bytes:
        return self.chunks.pop(0) if self.chunks else b""

    def discard_input(self) -> None: ...
    def close(self) -> None: ...


stream_parts = st.sampled_from(
    [b"$HCHDM,237.5,M*2A", b"\r", b"\n", b"\x00", b"\xff\x80", b"!AIVDM,1*2A", b"\\s:HC01*3C\\", b"x", b"*"]
)


@given(st.lists(stream_parts, max_size=25).map(b"".join), st.lists(st.integers(0, 400), max_size=12))
def test_lines_are_the_same_however_they_arrive(stream: bytes, cuts: list[int]) -> None:
    ends = sorted({min(cut, len(stream)) for cut in cuts} | {len(stream)})
    chunks = [stream[a:b] for a, b in pairwise([0, *ends])]

    def lines(chunks: list[bytes]) -> list[bytes]:
        port = Chunks([*chunks, b"\r\n"])
        reader, found = LineReader(port), []
        while port.chunks:
            while (line := reader.read_line(Deadline.after(0.0))) is not None:
                found.append(line.strip(b"\x00\xff"))
        return found

    assert lines(chunks) == lines([stream])


@given(
    st.sampled_from(["WIXDR", "WIMDA", "WIMMB", "HCHDG", "HCHDT", "GPTHS", "OHPR", "PTNTHPR"]),
    st.lists(
        st.sampled_from(["P", "B", "H", "C", "K", "", "0.97", "1013.25", "-1", "XXX", "E", "T", "BARO", "N"])
    ),
    st.booleans(),
)
def test_any_fields_give_a_reading_that_can_be_or_a_message_error(
    address: str, fields: list[str], with_checksum: bool
) -> None:
    line = has_checksum(",".join([address, *fields]))
    if not with_checksum:
        line = line.partition(b"*")[0]
    at = Instant(0.0, datetime(2026, 11, 26, tzinfo=UTC))
    try:
        found = parse_sentence(line, require_checksum=with_checksum)
        heading, pressure = parse_heading(found, at), parse_pressure(found, at)
    except MessageError:
        return
    assert heading is None or (0.0 <= heading.heading_deg < 360.0 and 0.0 < heading.resolution_deg <= 1.0)
    assert pressure is None or (300.0 <= pressure.pressure_hpa <= 1250.0 and pressure.resolution_hpa > 0.0)


@given(st.text("CPRTEMxyz0123456789.+-", max_size=40))
def test_any_letters_and_numbers_give_a_heading_or_a_message_error(body: str) -> None:
    at = Instant(0.0, datetime(2026, 11, 26, tzinfo=UTC))
    try:
        found = parse_heading(parse_sentence(has_checksum("C" + body)), at)
    except MessageError:
        return
    assert found is None or 0.0 <= found.heading_deg < 360.0


def test_each_report_is_played() -> None:
    tests = "".join(path.read_text() for path in Path(__file__).parents[1].rglob("test_*.py"))
    unplayed = [
        path.name
        for path in REPORTS.glob("*.nmea")
        if path.name not in tests and f'"{path.name[:3]}"' not in tests
    ]
    assert not unplayed
