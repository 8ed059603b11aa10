"""How the rig fails: one clear line each, exit status 2.

Drivers raise ``DeviceError`` or one of its subclasses and nothing else; what the operating system or a
library raises is turned into one where it happens. Only a ``TransientError`` is worth another try, and only
``rig.devices.bus.retry`` tries again.
"""

from localizer.errors import SkyfixError as SkyfixError


class RigError(SkyfixError):
    """Anything expected that can go wrong in the rig."""


class ConfigError(RigError):
    """The configuration is wrong: the message names file, key and what is allowed."""


class GoalError(RigError):
    """The head was asked to go where it may not go. Nothing has moved."""


class MessageError(RigError):
    """Received bytes are not a valid message. What pure parsers raise; they know no device to name."""


class NoReadingError(MessageError):
    """A message arrived whole, and holds no value that can be trusted now: cable and baud rate are in order.

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
    """A message that has to end with a checksum ends without one."""


class DeviceError(RigError):
    """A device is absent, is another one than configured, or does not do what it should.

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
    """Something answers, but not the chip or the servo model that is configured."""


class TransientError(DeviceError):
    """One exchange failed (no answer, bad checksum, no acknowledge): the next may succeed."""


class LostPortError(TransientError):
    """A port that worked has gone away. It may come back under the same name: a lasting one, for USB."""
