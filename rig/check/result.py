"""What ``rig check`` says of one device."""

from collections.abc import Mapping
from dataclasses import dataclass, field

Values = Mapping[str, float | str | None]


@dataclass(frozen=True)
class DeviceCheck:
    """What one device said. ``problem`` is None where all is well; volts and temperatures may be several, or none.

    ``values`` are reading and noise as numbers, with their units in the names; ``hints``, what could be better and does not
    make the device unfit.
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
