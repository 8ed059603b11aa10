"""rig check: a verdict on scatter, no mean of two different things, numbers with units, and who else answers on a bus."""

import datetime
import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from rig import sysfs
from rig.capture.averaged_readings import two_pressures
from rig.check.compass import field_check, heading_check
from rig.check.devices import check_altimeter, check_pan_tilt
from rig.check.text import as_json
from rig.config.sections import (
    Mmc5983maSection,
    NmeaCompassSection,
    PanTiltSection,
    Place,
    SerialAltimeterSection,
)
from rig.devices.dynamixel.scan import scan_hint, servos_at
from rig.devices.readings import FieldReading, HeadingReading, PressureReading
from rig.errors import DeviceError, TransientError
from sim.devices.pty_port import PtyPort
from sim.devices.servo import Servo
from sim.devices.servo_bus import ServoBus
from sim.devices.x_series import BAUD_RATES, XL430_W250, XM430_W350

NOW = datetime.datetime(2026, 11, 24, tzinfo=datetime.UTC)
TALKER = NmeaCompassSection(kind="nmea", port="/dev/ttyS9")
CHIP = Mmc5983maSection(
    kind="mmc5983ma", bus="/dev/i2c-1", address=0x30, axes=("+x", "+y", "+z"), declination_deg=13.0
)
SANTA_CRUZ = Place(lat_deg=37.2, lon_deg=-122.1)  # declination 12.7


def heading(
    angle_deg: float, reference: str = "magnetic", variation_deg: float | None = None
) -> HeadingReading:
    return HeadingReading(angle_deg, reference, variation_deg, None, None, 0.0, NOW)  # type: ignore[arg-type]


def field(x_ut: float, y_ut: float, z_ut: float = -41.0) -> FieldReading:
    return FieldReading(x_ut, y_ut, z_ut, (0.0, 0.0, 0.0), 20.0, 0.0, NOW)


def test_steady_headings_pass() -> None:
    check = heading_check("c", [heading(359.8), heading(0.2), heading(0.0)], TALKER, None)
    assert check.ok
    assert check.reading == "0.0 deg magnetic"
    assert check.values["reference"] == "magnetic"
    assert check.values["noise_deg"] == pytest.approx(0.163, abs=0.001)


def test_scattered_headings_fail() -> None:
    check = heading_check("c", [heading(10.0), heading(20.0), heading(12.0)], TALKER, None)
    assert check.problem
    assert check.problem.startswith("scatter of 4.3 deg is above 2 deg; hold the vehicle still")


def test_magnetic_and_true_headings_are_not_averaged() -> None:
    turns = [heading(100.0), heading(112.7, "true"), heading(100.2), heading(112.9, "true")]
    check = heading_check("c", turns, TALKER, SANTA_CRUZ)
    assert check.ok
    assert check.reading == "100.1 deg magnetic, 112.8 deg true"
    assert check.values["magnetic_heading_deg"] == pytest.approx(100.1)
    assert check.values["true_heading_deg"] == pytest.approx(112.8)
    assert check.values["noise_deg"] == pytest.approx(0.1)


@pytest.mark.parametrize("place", [SANTA_CRUZ, None])
def test_references_that_contradict_the_declination_fail_where_it_is_known(place: Place | None) -> None:
    turns = [heading(100.0), heading(100.0, "true")]
    check = heading_check("c", turns, TALKER, place)
    if place is None:
        assert check.ok
    else:
        assert check.problem
        assert "is +0.0 deg from its magnetic one, where the declination is +12.7 deg" in check.problem
    assert not heading_check("c", [heading(1.0, "magnetic", 12.0), heading(1.0, "true")], TALKER, None).ok


def test_a_field_that_scatters_fails() -> None:
    noise = np.random.default_rng(1).normal(0.0, 4.0, (20, 2))
    check = field_check("c", [field(20.0 + x, 10.0 + y) for x, y in noise], CHIP)
    assert check.problem
    assert "deg of heading; switch motors" in check.problem
    assert field_check("c", [field(20.0 + x / 100, 10.0 + y / 100) for x, y in noise], CHIP).ok


class Barometer:
    """A talker that sends these pressures."""

    def __init__(self, *pressures_hpa: float) -> None:
        self.pressures_hpa = pressures_hpa

    def identify(self) -> str:
        return "barometer"

    def read_many(self, _duration_s: float) -> list[PressureReading]:
        return [PressureReading(each, 10.0, 0.0, NOW) for each in self.pressures_hpa]

    def close(self) -> None:
        pass


BAROMETER = SerialAltimeterSection(
    kind="nmea", port="/dev/ttyS8", reference_pressure_hpa=1013.25, reference_altitude_m=0.0
)


def test_two_pressures_in_turns_are_not_averaged(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "rig.check.devices.open_altimeter", lambda _section: Barometer(968.5, 1013.2, 968.6, 1013.3)
    )
    with pytest.raises(
        DeviceError, match=r"says 968\.5 and 1013\.2 hPa in turns, .*QNH.; set the instrument"
    ):
        check_altimeter(BAROMETER)


def test_a_pressure_that_scatters_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "rig.check.devices.open_altimeter", lambda _section: Barometer(968.0, 968.5, 969.0, 968.2, 968.8)
    )
    check = check_altimeter(BAROMETER)
    assert check.problem
    assert "scatter of 0.37 hPa is above 0.3 hPa; shelter its port" in check.problem
    assert check.values["pressure_hpa"] == pytest.approx(968.5)


@pytest.mark.parametrize(
    ("pressures_hpa", "two"),
    [
        ([900.0], None),
        ([900.0, 900.1, 900.05], None),
        ([900.0, 901.0, 902.0, 903.5, 905.0], None),  # a lift, or wind: no two groups
        ([900.0, 1000.0], (900.0, 1000.0)),
        ([1000.0, 900.0, 900.2], (900.1, 1000.0)),
    ],
)
def test_what_counts_as_two_pressures(pressures_hpa: list[float], two: tuple[float, float] | None) -> None:
    assert two_pressures(pressures_hpa) == (None if two is None else pytest.approx(two))


def test_numbers_are_strict_json_in_one_object() -> None:
    checks = [
        heading_check("c", [heading(1.23456789)], TALKER, None),
        field_check("c", [field(float(np.float64(20.0)), 1.0)], CHIP),
    ]
    text = json.dumps(as_json(checks), allow_nan=False)
    assert '"magnetic_heading_deg": 1.23457' in text
    assert json.loads(text)["devices"][1]["verdict"] == "ok"


@contextmanager
def servos_on_a_port(*servos: Servo) -> Iterator[PtyPort]:
    port = PtyPort()
    ServoBus(servos).serve(port)
    try:
        yield port
    finally:
        port.close()


def servo(servo_id: int, baud: int, model: object = XM430_W350) -> Servo:
    eeprom = {"baud_rate": BAUD_RATES.index(baud)}
    rng = np.random.default_rng(servo_id)
    return Servo(model, servo_id, clock=lambda: 100.0, rng=rng, eeprom=eeprom)  # type: ignore[arg-type]


def pan_tilt(port: str, pan_id: int, tilt_id: int) -> PanTiltSection:
    axis = {"model": "XM430-W350", "zero_tick": 2048, "direction": 1, "min_deg": -90.0, "max_deg": 90.0}
    return PanTiltSection.model_validate(
        {"port": port, "baud": 1_000_000, "pan": {"id": pan_id, **axis}, "tilt": {"id": tilt_id, **axis}}
    )


def test_servos_of_other_ids_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rig.devices.dynamixel.scan.ALL_ANSWER_S", 0.2)
    with servos_on_a_port(servo(3, 1_000_000), servo(5, 1_000_000, XL430_W250)) as port:
        assert servos_at(port.path, 1_000_000) == {3: 1020, 5: 1060}
        with pytest.raises(
            TransientError,
            match=r"found id 1: no answer, id 2: no answer; at 1000000 baud id 3 \(XM430-W350\) and id 5 \(XL430-W250\) "
            "answer: correct `id`",
        ):
            check_pan_tilt(pan_tilt(port.path, 1, 2))


def test_servos_at_another_baud_rate_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rig.devices.dynamixel.scan.ALL_ANSWER_S", 0.2)
    with servos_on_a_port(servo(1, 57600), servo(2, 57600)) as port:
        told = scan_hint(port.path, 1_000_000)
    assert told == (
        "at 57600 baud id 1 (XM430-W350) and id 2 (XM430-W350) answer: set `baud` to 57600, or the servos to 1000000 with "
        "Dynamixel Wizard"
    )


def test_where_nothing_answers_there_is_no_hint(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rig.devices.dynamixel.scan.ALL_ANSWER_S", 0.05)
    monkeypatch.setattr("rig.devices.dynamixel.scan.SOME_ANSWER_S", 0.02)
    with servos_on_a_port() as port:
        assert scan_hint(port.path, 1_000_000) is None
    assert scan_hint("/dev/ttyUSB99", 57600) is None


@pytest.mark.parametrize(("latency_ms", "told"), [("16", True), ("1", False), ("x", False)])
def test_an_adapter_with_a_long_latency_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, latency_ms: str, told: bool
) -> None:
    with servos_on_a_port(servo(1, 1_000_000), servo(2, 1_000_000)) as port:
        monkeypatch.setattr(sysfs, "SYS", tmp_path)
        file = tmp_path / "bus/usb-serial/devices" / Path(port.path).name / "latency_timer"
        file.parent.mkdir(parents=True)
        file.write_text(f"{latency_ms}\n")
        check = check_pan_tilt(pan_tilt(port.path, 1, 2))
    assert check.ok
    assert bool(check.hints) == told
    if told:
        assert "for 16 ms (latency_timer): echo 1 | sudo tee" in check.hints[0]
        assert "70-skyfix.rules" in check.hints[0]
    assert isinstance(check.values["answer_ms"], float)
