"""Serial talkers: golden sentences, an independent parser, and what arrives on the port."""

import time
from collections.abc import Iterator

import pynmeagps
import pytest
import serial

from sim.devices.talkers import BAROMETERS, COMPASSES, Air, Heading, Talker, mda, sentence, vaisala_pa50, xdr

HEADING = Heading(
    magnetic_heading_deg=98.3, pitch_deg=-0.9, roll_deg=0.8, declination_deg=-12.6, temperature_c=30.1
)


@pytest.mark.parametrize(
    "golden",
    [
        "$HCHDG,98.3,0.0,E,12.6,W*57",
        "$HCHDG,359.9,,,2.5,E*28",
        "$HCHDM,238.5,M*25",
        "$GPHDT,274.07,T*03",
        "$PTNTHPR,85.9,N,-0.9,N,0.8,N*2C",
        "$OHPR,237.7,-14.3,175.5,30.1*2B",
        "$IIXDR,P,1.02481,B,Barometer*29",
        "$WIMDA,29.2878,I,0.9918,B,18.8,C,,,,,,,,,,,,,,*36",
    ],
)
def test_checksums_are_the_golden_ones(golden: str) -> None:
    assert sentence(golden[1:-3]) == golden.encode("ascii") + b"\r\n"


@pytest.mark.parametrize(
    ("kind", "expected"),
    [
        ("hdg", "HCHDG,98.3,0.0,E,12.6,W"),
        ("hdm", "HCHDM,98.3,M"),
        ("hdt", "HCHDT,85.7,T"),
        ("ths", "HCTHS,85.7,A"),
        ("ptnthpr", "PTNTHPR,98.3,N,-0.9,N,0.8,N"),
        ("ohpr", "OHPR,98.3,-0.9,0.8,30.1"),
    ],
)
def test_compass_sentences(kind: str, expected: str) -> None:
    assert COMPASSES[kind](HEADING) == sentence(expected)


def test_a_heading_just_below_north_rounds_to_zero() -> None:
    heading = Heading(359.97, 0.0, 0.0, 0.0, 20.0)
    assert COMPASSES["hdm"](heading).startswith(b"$HCHDM,0.0,M")


@pytest.mark.parametrize("kind", ["hdg", "hdm", "hdt", "ths"])
def test_an_independent_parser_agrees(kind: str) -> None:
    message = pynmeagps.NMEAReader.parse(COMPASSES[kind](HEADING))
    name = {"hdg": "headingM", "hdm": "headingM", "hdt": "headingT", "ths": "headt"}[kind]
    assert getattr(message, name) == pytest.approx(98.3 if kind in ("hdg", "hdm") else 85.7)


def test_barometer_sentences() -> None:
    air = Air(1013.254, 18.8)
    assert b"P,1.01325,B,Barometer*" in xdr(air)
    assert b"$WIMDA,29.9214,I,1.0133,B,18.8,C," in mda(air)
    assert vaisala_pa50(Air(1009.18, 0.0)) == b"\x01P\x021 1009.18 ***.* * 1009.2 1009.2 1009.2 000\x03D6\r\n"
    assert set(BAROMETERS) == {"xdr", "mda", "vaisala-pa50"}


@pytest.fixture
def talker() -> Iterator[Talker]:
    talker = Talker(lambda: sentence("HCHDM,238.5,M"), rate_hz=50.0, baud=4800)
    yield talker
    talker.close()


def test_a_listener_receives_whole_sentences_at_the_rate(talker: Talker) -> None:
    with serial.Serial(talker.path, 4800, timeout=1.0) as port:
        port.reset_input_buffer()
        port.readline()
        start_s = time.monotonic()
        lines = [port.readline() for _ in range(25)]
        elapsed_s = time.monotonic() - start_s
    assert set(lines) == {b"$HCHDM,238.5,M*25\r\n"}
    assert elapsed_s == pytest.approx(0.5, rel=0.4)


def test_another_baud_rate_gives_garbage(talker: Talker) -> None:
    with serial.Serial(talker.path, 9600, timeout=0.3) as port:
        port.reset_input_buffer()
        assert b"$HCHDM" not in port.read(100)


def test_unread_output_does_not_accumulate(talker: Talker) -> None:
    with serial.Serial(talker.path, 4800, timeout=0.3) as port:
        time.sleep(0.3)
        assert 0 < port.in_waiting < 4096
