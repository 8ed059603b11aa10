"""Which NMEA sentences are a movement of the vehicle: modes, statuses, units, and times that do not go on."""

from pathlib import Path

import pytest

from rig.daemon.odometry.velocity import StaleClock, velocity_in
from rig.devices.sensors.nmea import Sentence, checksum, parse_sentence
from rig.errors import MessageError

O01 = Path(__file__).parents[2] / "logs" / "nmea" / "o01-rmc-mode-n-and-s.nmea"
KNOT = 1852 / 3600
RMC = "GPRMC,123519,{status},4807.038,N,01131.000,E,022.4,084.4,230394,003.1,W{end}"
VTG = "GPVTG,084.4,T,087.5,M,022.4,N,041.5,K{end}"


def sentence(body: str) -> Sentence:
    return parse_sentence(f"${body}*{checksum(body.encode()):02X}".encode())


def test_the_reported_lines_are_no_movement() -> None:
    lines = O01.read_bytes().splitlines()
    assert [velocity_in(parse_sentence(line)) for line in lines] == [None, None]


@pytest.mark.parametrize("mode", ["N", "S", "M", "E", "V", "X"])
def test_modes_that_are_no_measured_movement(mode: str) -> None:
    assert velocity_in(sentence(RMC.format(status="A", end=f",{mode}"))) is None
    assert velocity_in(sentence(RMC.format(status="A", end=f",{mode},S"))) is None
    assert velocity_in(sentence(VTG.format(end=f",{mode}"))) is None


@pytest.mark.parametrize("mode", ["A", "D", "F", "P", "R", ""])
def test_modes_that_are_one(mode: str) -> None:
    for body in (RMC.format(status="A", end=f",{mode}"), VTG.format(end=f",{mode}")):
        found = velocity_in(sentence(body))
        assert found is not None
        assert found.speed_m_s == pytest.approx(22.4 * KNOT, rel=2e-3)
        assert found.course_deg == 84.4


def test_dead_reckoning_counts_where_it_is_wanted() -> None:
    for body in (RMC.format(status="A", end=",E"), VTG.format(end=",E")):
        assert velocity_in(sentence(body)) is None
        assert velocity_in(sentence(body), accept_estimated=True) is not None


@pytest.mark.parametrize(
    ("status", "moves"), [("A", True), ("D", True), ("V", False), ("", False), ("N", False)]
)
def test_the_status_of_an_rmc(status: str, moves: bool) -> None:
    assert (velocity_in(sentence(RMC.format(status=status, end=",A"))) is not None) == moves


@pytest.mark.parametrize(
    ("navigational", "moves"), [("V", True), ("S", True), ("C", True), ("", True), ("U", False), ("N", False)]
)
def test_the_navigational_status_of_nmea_4_1(navigational: str, moves: bool) -> None:
    """u-blox receivers always say V: they give no such status."""
    assert (velocity_in(sentence(RMC.format(status="A", end=f",A,{navigational}"))) is not None) == moves


@pytest.mark.parametrize(
    "body",
    [
        "GPVTG,,T,,M,,N,,K,N",
        "GPVTG,084.4,T,,M,,N,,K,A",
        "GPRMC,123519,A,,,,,,084.4,230394,,,A",
        "GPGLL,1,N,2,E,1,A,A",
    ],
)
def test_no_speed_is_no_movement(body: str) -> None:
    assert velocity_in(sentence(body)) is None


def test_a_magnetic_course_is_no_true_one() -> None:
    found = velocity_in(sentence("GPVTG,,T,087.5,M,022.4,N,041.5,K,A"))
    assert found is not None
    assert found.course_deg is None


def test_the_oldest_form_of_vtg_has_no_letters() -> None:
    found = velocity_in(sentence("GPVTG,054.7,034.4,005.5,010.2"))
    assert found is not None
    assert (found.course_deg, found.speed_m_s) == (54.7, pytest.approx(10.2 / 3.6))


@pytest.mark.parametrize(
    "body",
    [
        "GPVTG,084.4,T,087.5,M,022.4,N,000.0,K,A",  # a filler
        "GPVTG,084.4,T,087.5,M,022.4,N,022.4,K,A",
        "GPVTG,084.4,M,087.5,T,022.4,N,041.5,K,A",
        "GPVTG,084.4,T,087.5,M,022.4,K,041.5,N,A",
        "GPVTG,999.9,T,087.5,M,022.4,N,041.5,K,A",
        "GPRMC,123519,A,,,,,XX,084.4,230394,,,A",
    ],
)
def test_what_contradicts_itself_is_refused(body: str) -> None:
    with pytest.raises(MessageError):
        velocity_in(sentence(body))


def test_a_proprietary_sentence_is_no_rmc() -> None:
    assert (
        velocity_in(sentence("PGRMC,A,218.8,100,6378137.000,298.257223563,0.0,0.0,0.0,A,3,1,1,4,30")) is None
    )


def test_a_time_that_stands_still_makes_a_stale_speed() -> None:
    clock = StaleClock()
    first, second = (
        sentence(RMC.replace("123519", time).format(status="A", end=",A")) for time in ("123519", "123520")
    )
    assert not clock.is_stale(first, 0.0)
    assert not clock.is_stale(first, 9.0), "it may have no clock"
    assert not clock.is_stale(second, 10.0)
    assert not clock.is_stale(second, 11.0)
    assert clock.is_stale(second, 12.5)
    assert not clock.is_stale(first, 13.0)
    assert not clock.is_stale(sentence(VTG.format(end=",A")), 20.0)
