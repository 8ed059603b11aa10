"""MMC5983MA, three-axis magnetometer of 18 bits (Memsic, data sheet Rev. A).

Its zero offset is up to ±0.5 G, as large as the Earth's field. A SET pulse magnetises the sensor in one direction, a
RESET pulse in the other: half the difference of the two measurements is the field, half the sum the offset.
"""

from rig import timebase
from rig.clock import Instant
from rig.devices.bus.deadline import Deadline, wait_until
from rig.devices.bus.i2c import I2cBus
from rig.devices.bus.i2c_chip import I2cChip
from rig.devices.closing import ClosedOnExit
from rig.devices.readings import FieldReading
from rig.devices.sensors.sampling import MIN_READINGS, read_for, require_noise
from rig.errors import TransientError
from rig.fault_notes import note_fault

FROZEN_REPEATS = 8
NO_FIELD_UT = 1.0
DEFAULT_ADDRESS = 0x30

_XOUT_0 = 0x00
_TOUT = 0x07
_STATUS = 0x08
_CONTROL_0 = 0x09  # the control registers cannot be read back
_CONTROL_1 = 0x0A
_PRODUCT_ID = 0x2F

_IDENTITY = 0x30  # which is also its address
_FIELD_DONE = 0x01
_TEMPERATURE_DONE = 0x02
_OTP_READ = 0x10
_MEASURE_FIELD = 0x01
_MEASURE_TEMPERATURE = 0x02
_SET = 0x08
_RESET = 0x10
_BANDWIDTH_100_HZ = 0x00  # the least noise: 8 ms a measurement
_SOFTWARE_RESET = 0x80

_ZERO_COUNTS = 1 << 17
_FULL_COUNTS = (1 << 18) - 1
_UT_PER_COUNT = 100.0 / 16384.0
_RESTART_S = 0.010
_PULSE_S = 0.001
_POLL_S = 0.002
_TIMEOUT_S = 0.2

Counts = tuple[int, int, int]


def decode_field(data: bytes) -> Counts:
    """Counts above zero field of x, y, z from registers 0x00 to 0x06: 18 bits, the lowest two apart."""
    low = data[6]
    return (
        (data[0] << 10 | data[1] << 2 | low >> 6 & 3) - _ZERO_COUNTS,
        (data[2] << 10 | data[3] << 2 | low >> 4 & 3) - _ZERO_COUNTS,
        (data[4] << 10 | data[5] << 2 | low >> 2 & 3) - _ZERO_COUNTS,
    )


def decode_temperature_c(raw: int) -> float:
    """Degrees Celsius from the one byte of register 0x07."""
    return -75.0 + 0.8 * raw


class Mmc5983ma(ClosedOnExit):
    """MMC5983MA by Memsic, a magnetometer of three axes and 18 bits: idle between readings.

    Parameters
    ----------
    bus : I2cBus
        From `open_i2c`; ``close`` gives it back.
    address : int
        Always 0x30.

    Raises
    ------
    WrongDeviceError
        Another chip answers.
    TransientError
        The chip does not answer, or takes too long.
    DeviceError
        The chip cannot load its factory trim.

    Notes
    -----
    Data sheet Rev. A: a SET and a RESET pulse (Internal Control 0, 0x09) turn the sensor over between two measurements. Half
    their difference is the field, half their sum the sensor's own zero. One count is 0.0061 µT.

    Examples
    --------
    >>> import rig
    >>> with rig.open_chip(rig.Mmc5983ma, i2c_bus, 0x30) as chip:  # i2c_bus = "/dev/i2c-1"
    ...     field = chip.read()
    >>> print(f"north {field.y_ut:.0f} µT, down {-field.z_ut:.0f} µT, zero of x {field.offset_ut[0]:.0f} µT")
    north 22 µT, down 42 µT, zero of x 10 µT
    """

    def __init__(self, bus: I2cBus, address: int = DEFAULT_ADDRESS) -> None:
        self._chip = I2cChip(bus, address, "MMC5983MA")
        self._chip.require_identity(_PRODUCT_ID, _IDENTITY)
        self._chip.write_register(_CONTROL_1, _SOFTWARE_RESET)
        timebase.sleep(_RESTART_S)
        if not wait_until(lambda: self._has(_OTP_READ), Deadline.after(_TIMEOUT_S), _POLL_S):
            raise self._chip.broken("could not load its factory trim")
        self._chip.write_register(_CONTROL_1, _BANDWIDTH_100_HZ)
        self._tells_temperature = True

    def identify(self) -> str:
        """Model, address and bus."""
        return self._chip.name

    def read(self) -> FieldReading:
        """Field and zero from one SET and RESET pair, some 30 ms.

        Returns
        -------
        FieldReading
            In the chip's axes, µT. A temperature that cannot be read is None: the field needs none, SET and RESET take its
            drift out.

        Raises
        ------
        TransientError
            A measurement does not end, is out of range, or implausible.
        """
        after_set = self._measure_after(_SET)
        after_reset = self._measure_after(_RESET)
        at = Instant.now()
        temperature_c = self._temperature_c()
        pairs = list(zip(after_set, after_reset, strict=True))
        x_ut, y_ut, z_ut = ((a - b) / 2 * _UT_PER_COUNT for a, b in pairs)
        if max(abs(x_ut), abs(y_ut), abs(z_ut)) < NO_FIELD_UT:
            raise self._chip.implausible("SET and RESET make no difference")
        zero_x, zero_y, zero_z = ((a + b) / 2 * _UT_PER_COUNT for a, b in pairs)
        return FieldReading(x_ut, y_ut, z_ut, (zero_x, zero_y, zero_z), temperature_c, at.monotonic_s, at.utc)

    def _temperature_c(self) -> float | None:
        """The temperature; None, with a note, if it is not measured or impossible. After one failure it is not awaited
        again.
        """
        if not self._tells_temperature:
            return None
        try:
            self._convert(_MEASURE_TEMPERATURE, _TEMPERATURE_DONE)
            temperature_c = decode_temperature_c(self._chip.read_register(_TOUT)[0])
        except TransientError as error:
            self._tells_temperature = False
            note_fault(
                self._chip.name, f"its temperature cannot be read: {error.problem}", "the field needs none"
            )
            return None
        if not -40.0 <= temperature_c <= 105.0:
            note_fault(
                self._chip.name, f"says {temperature_c:.0f} °C of itself", "the field needs no temperature"
            )
            return None
        return temperature_c

    def _measure_after(self, pulse: int) -> Counts:
        self._chip.write_register(_CONTROL_0, pulse)
        timebase.sleep(_PULSE_S)
        self._convert(_MEASURE_FIELD, _FIELD_DONE)
        counts = decode_field(self._chip.read_register(_XOUT_0, 7))
        if not all(-_ZERO_COUNTS < c < _FULL_COUNTS - _ZERO_COUNTS for c in counts):
            raise self._chip.implausible("a field beyond ±8 G; is a magnet near?")
        return counts

    def _convert(self, command: int, done: int) -> None:
        self._chip.write_register(_CONTROL_0, command)
        if not wait_until(lambda: self._has(done), Deadline.after(_TIMEOUT_S), _POLL_S):
            raise self._chip.no_answer_in_time("a measurement", _TIMEOUT_S)

    def _has(self, bit: int) -> bool:
        return bool(self._chip.read_register(_STATUS)[0] & bit)

    def read_many(self, duration_s: float) -> list[FieldReading]:
        """Read for some time.

        Parameters
        ----------
        duration_s : float
            For how long, in seconds.

        Returns
        -------
        list of FieldReading
            In order, at least ten.

        Raises
        ------
        TransientError
            A reading does not come, or cannot be true.
        DeviceError
            All readings are the same: the chip is frozen.
        """
        readings = read_for(self.read, duration_s, MIN_READINGS)
        require_noise(self._chip.name, [(r.x_ut, r.y_ut, r.z_ut) for r in readings], FROZEN_REPEATS)
        return readings

    def close(self) -> None:
        """Close the bus handle; the chip is idle."""
        self._chip.release()
