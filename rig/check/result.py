"""The result of ``rig check`` for one device."""

from collections.abc import Mapping
from dataclasses import dataclass, field

Values = Mapping[str, float | str | None]


@dataclass(frozen=True)
class DeviceCheck:
    """The result for one device. ``problem`` is None if it works; ``volts`` and ``temperatures_c`` may hold several
    values or none.

    ``values`` holds reading and noise as numbers with units in their names. ``hints`` are improvements that are not
    failures.
    """

    device: str
    identity: str
    reading: str
    noise: str
    volts: tuple[float, ...]
    temperatures_c: tuple[float, ...]
    problem: str | None
    values: Values = field(default_factory=dict)
    hints: tuple[str, ...] = ()

    @property
    def ok(self) -> bool:
        """Whether the device is fit for a capture."""
        return self.problem is None
