"""Sets exposure, gain, white balance and focus of a local camera through OpenCV, and restores them.

The driver keeps settings after a program ends, so a camera may start with anything. Settings are verified by reading
back: ``set`` returns true even for controls without effect.
"""

from dataclasses import dataclass
from typing import Protocol

import cv2

from rig.errors import DeviceError
from rig.fault_notes import note_fault

V4L2_AUTOMATIC, V4L2_MANUAL = 3, 1
"""Values of UVC cameras (aperture priority, manual)."""

AUTOMATIC = (V4L2_AUTOMATIC, 0, 2, 0.75)
"""V4L2's aperture priority, auto and shutter priority (videodev2.h, v4l2_exposure_auto_type), and normalised ranges."""

MANUAL = (V4L2_MANUAL, 0.25)
ABSENT = (-1.0,)


class Capture(Protocol):
    """The part of ``cv2.VideoCapture`` used here."""

    def get(self, propId: int) -> float: ...
    def set(self, propId: int, value: float) -> bool: ...


@dataclass(frozen=True)
class FixedControl:
    """A configured control: its key, property and value, and the automatic mode that must be off for it."""

    key: str
    property_id: int
    value: float
    automatic_id: int | None = None


class LocalExposure:
    """Exposure of a V4L2 camera, in stops relative to the last automatic value, or to a fixed one.

    ``name`` is used in errors. ``fixed`` is in the driver's unit (V4L2: 100 us).
    """

    def __init__(self, capture: Capture, fixed: float | None = None, name: str = "camera") -> None:
        self._capture = capture
        self._name = name
        self._fixed = fixed
        self._ev = 0.0
        self._usual = 0.0
        self._found_mode = capture.get(cv2.CAP_PROP_AUTO_EXPOSURE)
        self._found_exposure = capture.get(cv2.CAP_PROP_EXPOSURE)

    def begin(self) -> None:
        """Set automatic or the fixed exposure, whatever was set before.

        Raises ``DeviceError`` if the camera stays in manual mode, or rejects the fixed exposure.
        """
        if self._fixed is not None:
            if not (self._choose(MANUAL) and self._expose(self._fixed)):
                raise DeviceError(
                    self._name,
                    f"does not take [camera] exposure {self._fixed:g} (it has {self._exposure():g})",
                    "see what it takes with v4l2-ctl --list-ctrls, or leave the key away",
                )
            return
        if self._found_mode in MANUAL and not self._choose(AUTOMATIC):
            raise DeviceError(
                self._name,
                f"stays at the manual exposure of {self._found_exposure:g} that another program left",
                "set it to automatic with v4l2-ctl, or give [camera] exposure",
            )

    def set(self, ev: float) -> None:
        """Set the exposure if it differs. A driver without such controls ignores it, which is noted."""
        if ev == self._ev:
            return
        if self._ev == 0.0:
            self._usual = self._exposure() if self._fixed is None else self._fixed
        self._ev = ev
        if ev == 0.0 and self._fixed is None:
            taken = self._choose(self._automatic_first())
        else:
            taken = self._choose(MANUAL) and self._expose(self._usual * 2.0**ev)
        if not taken:
            note_fault(self._name, f"takes no exposure of {ev:+g} EV", "went on as it exposes")

    def restore(self) -> None:
        """Restore mode and, if manual, value as found. Rejected settings are left."""
        if self._found_mode in MANUAL:
            self._choose(MANUAL)
            self._expose(self._found_exposure)
        elif self._ev != 0.0 or self._fixed is not None:
            self._choose(self._automatic_first())

    def _automatic_first(self) -> tuple[float, ...]:
        """The automatic modes to try, the one found at opening first."""
        first = (self._found_mode,) if self._found_mode in AUTOMATIC else ()
        return (*first, *AUTOMATIC)

    def _choose(self, modes: tuple[float, ...]) -> bool:
        """Set the first of these modes that the camera accepts and keeps."""
        return any(set_and_verified(self._capture, cv2.CAP_PROP_AUTO_EXPOSURE, mode) for mode in modes)

    def _expose(self, exposure: float) -> bool:
        """Whether it accepts an exposure; drivers round to their own steps."""
        if not self._capture.set(cv2.CAP_PROP_EXPOSURE, exposure):
            return False
        return abs(self._exposure() - exposure) <= max(1.0, 0.1 * abs(exposure))

    def _exposure(self) -> float:
        return self._capture.get(cv2.CAP_PROP_EXPOSURE)


class FixedControls:
    """Configured controls, set and verified; ``restore`` undoes them."""

    def __init__(self, capture: Capture, controls: tuple[FixedControl, ...], name: str) -> None:
        self._capture = capture
        self._found: list[tuple[int, float]] = []
        for control in controls:
            if control.automatic_id is not None:
                self._found.append((control.automatic_id, capture.get(control.automatic_id)))
            self._found.append((control.property_id, capture.get(control.property_id)))
        for control in controls:
            if control.automatic_id is not None:
                capture.set(control.automatic_id, 0)
            capture.set(control.property_id, control.value)
            has = capture.get(control.property_id)
            if abs(has - control.value) > max(1.0, 0.02 * abs(control.value)):
                self.restore()
                raise DeviceError(
                    name,
                    f"does not take [camera] {control.key} {control.value:g} (it has {has:g})",
                    "see what it takes with v4l2-ctl --list-ctrls, or leave the key away",
                )

    def restore(self) -> None:
        """Restore the controls as found, automatic modes last: a control cannot be set while its automatic mode is on."""
        for property_id, value in reversed(self._found):
            if value not in ABSENT:
                self._capture.set(property_id, value)


def set_and_verified(capture: Capture, property_id: int, value: float) -> bool:
    """Set a control; whether it then has that value."""
    return bool(capture.set(property_id, value)) and capture.get(property_id) == value
