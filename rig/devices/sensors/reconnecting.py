"""A sensor wrapper that reopens the sensor after a failure: a chip that reset has lost its configuration."""

import contextlib
from collections.abc import Callable, Sequence
from typing import Generic, Protocol, TypeVar

from rig import event_bus
from rig.devices.bus.retry import retry
from rig.errors import DeviceError, LostPortError, RigError, TransientError, WrongDeviceError

Reading_co = TypeVar("Reading_co", covariant=True)


class Sensor(Protocol[Reading_co]):
    """The interface of all sensors."""

    def identify(self) -> str:
        """Model, address and bus or port."""
        ...

    def read_many(self, duration_s: float) -> Sequence[Reading_co]:
        """All readings over a duration, at least one."""
        ...

    def close(self) -> None:
        """Close its bus handle or port."""
        ...


class ReconnectingSensor(Generic[Reading_co]):
    """Wraps the sensor that ``connect`` opens; after a failed reading it is reopened, with identity check and set-up.

    Retries are above it: a failed reading raises ``TransientError``, and the next try starts with a configured chip.
    Raises what ``connect`` raises, at once if another chip answers than before.
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
        """All readings over a duration, at least one."""
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
        """Close its bus handle or port; errors of a sensor that is no longer used are ignored."""
        sensor, self._sensor = self._sensor, None
        if sensor is not None:
            with contextlib.suppress(RigError):
                sensor.close()
