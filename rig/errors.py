"""How the rig fails: one clear line each, exit status 2.

Drivers raise only ``DeviceError`` and its subclasses; errors of the operating system and of libraries are converted
where they occur. Only a ``TransientError`` is retried, and only by ``rig.devices.bus.retry``.
"""

from localizer.errors import SkyfixError as SkyfixError


class RigError(SkyfixError):
    """Base of all expected failures of the rig."""


class ConfigError(RigError):
    """The configuration is wrong: the message names file, key and what is allowed."""


class GoalError(RigError):
    """The goal is outside the head's limits or in a keep-out zone. Nothing has moved."""


class MessageError(RigError):
    """Received bytes are not a valid message. Raised by pure parsers, which do not know the device."""


class NoReadingError(MessageError):
    """A message is valid but holds no usable value: cable and baud rate are in order.

    ``remedy`` says what to do, like that of a ``DeviceError``.
    """

    def __init__(
        self,
        problem: str,
        remedy: str = "wait until the instrument has a value; look at its state and settings",
    ) -> None:
        super().__init__(problem)
        self.remedy = remedy


class NoChecksumError(MessageError):
    """A message without the checksum that is required."""


class DeviceError(RigError):
    """A device is absent, not the configured one, or does not work as it should.

    Attributes
    ----------
    device : str
        The device as an operator would name it: "pan servo (id 1) on /dev/ttyUSB0".
    problem : str
        What happened.
    remedy : str
        What to do.
    """

    def __init__(self, device: str, problem: str, remedy: str) -> None:
        super().__init__(f"{device}: {problem}; {remedy}")
        self.device = device
        self.problem = problem
        self.remedy = remedy


class WrongDeviceError(DeviceError):
    """A device answers, but it is not the configured chip or servo model."""


class TransientError(DeviceError):
    """One exchange failed (no answer, bad checksum, no acknowledge): the next may succeed."""


class LostPortError(TransientError):
    """A port that worked has disappeared. It may return under the same name, if that is a persistent one (USB)."""
