"""Resets V4L2 controls that change geometry or brightness to the driver's defaults while the rig uses the camera.

Digital zoom, mirroring, rotation and panning change the intrinsics without changing the size; brightness and gain can
hide the skyline. The driver keeps what the last program set. OpenCV does not report defaults; the kernel does
(linux/videodev2.h: VIDIOC_QUERYCTRL, VIDIOC_G_CTRL, VIDIOC_S_CTRL).
"""

import fcntl
import logging
import os
import struct
from collections.abc import Callable
from typing import NamedTuple

from rig.errors import DeviceError

_log = logging.getLogger(__name__)

_QUERY = struct.Struct("=II32siiiiI8x")  # id, type, name, minimum, maximum, step, default, flags
_CONTROL = struct.Struct("=Ii")  # id, value
VIDIOC_QUERYCTRL, VIDIOC_G_CTRL, VIDIOC_S_CTRL = 0xC0445624, 0xC008561B, 0xC008561C
_DISABLED, _READ_ONLY, _INACTIVE = 0x0001, 0x0004, 0x0010

GEOMETRY = {
    0x00980914: "horizontal flip",
    0x00980915: "vertical flip",
    0x00980922: "rotation",
    0x009A090D: "zoom",
    0x009A0908: "pan",
    0x009A0909: "tilt",
}
LIGHT = {
    0x00980900: "brightness",
    0x00980901: "contrast",
    0x00980902: "saturation",
    0x00980903: "hue",
    0x00980910: "gamma",
    0x00980913: "gain",
}
"""Control ids (linux/v4l2-controls.h)."""

Ioctl = Callable[[int, int, bytearray], object]


class Control(NamedTuple):
    """One control as reported by the kernel."""

    control_id: int
    value: int
    default: int


class V4l2Settings:
    """Sets the controls to their defaults; ``restore`` undoes it.

    Raises ``DeviceError`` if the picture stays zoomed, mirrored, rotated or panned. A missing device, or one without
    controls, is ignored: opening it reports the fault.
    """

    def __init__(self, source: int | str, name: str, ioctl: Ioctl = fcntl.ioctl) -> None:
        self._path = f"/dev/video{source}" if isinstance(source, int) else source
        self._ioctl = ioctl
        self._found: list[Control] = []
        self._each(self._set_default)
        stuck = self._each(self._stuck)
        if stuck:
            self.restore()
            raise DeviceError(
                name,
                f"keeps its {' and '.join(stuck)} as another program left it: the intrinsics do not hold",
                "set it to its default with v4l2-ctl, or unplug the camera and plug it in again",
            )

    def restore(self) -> None:
        """Restore the controls as found. Rejected settings are left."""
        found, self._found = self._found, []
        if not found:
            return
        try:
            device = os.open(self._path, os.O_RDWR | os.O_NONBLOCK)
        except OSError as error:
            _log.debug("%s: %s", self._path, error)
            return
        try:
            for control in found:
                self._set(device, control.control_id, control.value)
        finally:
            os.close(device)

    def _each(self, act: Callable[[int, Control, str], str | None]) -> list[str]:
        """The results of ``act`` for each existing control."""
        try:
            device = os.open(self._path, os.O_RDWR | os.O_NONBLOCK)
        except OSError as error:
            _log.debug("%s: %s", self._path, error)
            return []
        try:
            said = []
            for control_id, what in {**GEOMETRY, **LIGHT}.items():
                control = self._read(device, control_id)
                if control is not None and (words := act(device, control, what)):
                    said.append(words)
            return said
        finally:
            os.close(device)

    def _set_default(self, device: int, control: Control, what: str) -> None:
        if control.value == control.default:
            return
        _log.info("%s: %s was %d, set to %d", self._path, what, control.value, control.default)
        self._found.append(control)
        self._set(device, control.control_id, control.default)

    @staticmethod
    def _stuck(device: int, control: Control, what: str) -> str | None:
        return what if control.control_id in GEOMETRY and control.value != control.default else None

    def _read(self, device: int, control_id: int) -> Control | None:
        query = bytearray(_QUERY.pack(control_id, 0, b"", 0, 0, 0, 0, 0))
        value = bytearray(_CONTROL.pack(control_id, 0))
        try:
            self._ioctl(device, VIDIOC_QUERYCTRL, query)
            _, _, _, _, _, _, default, flags = _QUERY.unpack(query)
            if flags & (_DISABLED | _READ_ONLY | _INACTIVE):
                return None
            self._ioctl(device, VIDIOC_G_CTRL, value)
        except OSError:  # EINVAL: it has no such control; ENOTTY: it is no camera
            return None
        return Control(control_id, _CONTROL.unpack(value)[1], default)

    def _set(self, device: int, control_id: int, value: int) -> None:
        try:
            self._ioctl(device, VIDIOC_S_CTRL, bytearray(_CONTROL.pack(control_id, value)))
        except OSError as error:
            _log.debug("%s: control 0x%08x: %s", self._path, control_id, error)
