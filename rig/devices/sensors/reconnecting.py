"""A sensor that is set up anew after a failure: a chip that restarted has lost its configuration."""

import contextlib
from collections.abc import Callable, Sequence
from typing import Generic, Protocol, TypeVar

from rig import event_bus
from rig.devices.bus.retry import retry
from rig.errors import DeviceError, LostPortError, RigError, TransientError, WrongDeviceError

Reading_co = TypeVar("Reading_co", covariant=True)


class Sensor(Protocol[Reading_co]):
    """What all sensors have in common."""

    def identify(self) -> str:
        """What it is and where."""
        ...

    def read_many(self, duration_s: float) -> Sequence[Reading_co]:
        """All readings of some seconds, at least one."""
        ...

    def close(self) -> None:
        """Give its bus or port back."""
        ...


class ReconnectingSensor(Generic[Reading_co]):
    """The sensor that ``connect`` opens; opened again, identity and set-up included, after each failed reading.

    The retry stands above it: a reading that fails raises ``TransientError``, and the next try begins with a chip that
    is set up. Raises what ``connect`` raises, at once where another chip answers than before.
    """

    def __init__(self, connect: Callable[[], Sensor[Reading_co]]) -> None:
        self._connect = connect
        sensor = retry(connect)
        self._sensor: Sensor[Reading_co] | None = sensor
        try:
            self._identity = retry(sensor.identify)
        except BaseException:
            self.close()
            raise

    def identify(self) -> str:
        """What it is and where, as found when it was first opened."""
        return self._identity

    def read_many(self, duration_s: float) -> Sequence[Reading_co]:
        """All readings of some seconds, at least one."""
        if self._sensor is None:
            self._sensor = self._reconnected()
        try:
            readings = self._sensor.read_many(duration_s)
        except TransientError:
            self.close()
            raise
        for reading in readings:
            event_bus.publish(reading)
        return readings

    def _reconnected(self) -> Sensor[Reading_co]:
        try:
            return self._connect()
        except (TransientError, WrongDeviceError):
            raise
        except DeviceError as error:  # it worked before, so it may come back
            raise LostPortError(error.device, error.problem, error.remedy) from error

    def close(self) -> None:
        """Give its bus or port back. A sensor that cannot be closed is not worth an error: it is read no more."""
        sensor, self._sensor = self._sensor, None
        if sensor is not None:
            with contextlib.suppress(RigError):
                sensor.close()
