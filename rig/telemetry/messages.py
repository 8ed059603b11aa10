"""Converts published objects into messages: topic, schema, time and JSON values.

Frames of reference, for Foxglove's 3D panel: ``world`` (east, north, up), ``vehicle``, ``head``, ``camera`` (OpenCV's axes).
"""

import base64
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from rig import clock, timebase
from rig.attitude.kinematics import Attitude, Head, JointAngles, body_rotation, camera_rotation, head_rotation
from rig.capture.averaged_readings import AltitudeReading
from rig.capture.base_attitude import BaseEstimate
from rig.capture.view import View
from rig.config.model import RigConfig
from rig.devices.camera.frames import TimedFrame
from rig.devices.pan_tilt import HeadState
from rig.devices.readings import AccelerationReading, FieldReading, HeadingReading, PressureReading
from rig.event_bus import Step
from rig.telemetry import schemas
from rig.telemetry.schemas import Schema

THUMBNAIL_WIDTH = 320
JPEG_QUALITY = 70
LOG_LEVELS = {"info": 2, "warning": 3, "error": 4}
LEVEL = Attitude(0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Message:
    """A message. ``fields`` lacks the timestamp, which the writer adds from ``monotonic_s``."""

    topic: str
    schema: Schema
    monotonic_s: float
    fields: dict[str, Any]


def opening(config: RigConfig) -> list[Message]:
    """Messages at the start: the lens, and the camera's mounting in the head."""
    now_s = timebase.monotonic_s()
    camera = config.camera
    scale = THUMBNAIL_WIDTH / camera.width_px  # of the pictures in the file
    fx, fy = camera.fx_px * scale, camera.fy_px * scale
    cx, cy = ((centre + 0.5) * scale - 0.5 for centre in (camera.cx_px, camera.cy_px))
    lens = {
        "frame_id": "camera",
        "width": THUMBNAIL_WIDTH,
        "height": round(camera.height_px * scale),
        "distortion_model": "plumb_bob",
        "D": list(camera.distortion),
        "K": [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        "R": np.eye(3).ravel().tolist(),
        "P": [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
    }
    in_head = camera_rotation(np.eye(3), Head.from_config(config).boresight)
    return [
        Message("/camera/calibration", schemas.CAMERA_CALIBRATION, now_s, lens),
        _transform("/head/camera", now_s, "head", "camera", in_head),
    ]


def messages_of(item: object) -> Iterator[Message]:
    """The messages for ``item``; none for other types."""
    convert = _CONVERTERS.get(type(item))
    if convert is not None:
        yield from convert(item)


def _head(state: HeadState) -> Iterator[Message]:
    fields = {
        "pan_deg": state.pan_deg,
        "tilt_deg": state.tilt_deg,
        "moving": state.moving,
        "alerts": list(state.alerts),
    }
    for name, index in (("pan", 0), ("tilt", 1)):
        fields |= {
            f"{name}_tick": state.ticks[index],
            f"{name}_v": state.volts[index],
            f"{name}_c": state.temps[index],
        }
    yield Message("/head", schemas.HEAD_STATE, state.monotonic_s, fields)
    turned = head_rotation(LEVEL, JointAngles(state.pan_deg, state.tilt_deg))
    yield _transform("/vehicle/head", state.monotonic_s, "vehicle", "head", turned)


def _acceleration(reading: AccelerationReading) -> Iterator[Message]:
    names = "x_g", "y_g", "z_g", "temperature_c"
    yield _reading("/inclinometer", schemas.ACCELERATION, reading, names)


def _field(reading: FieldReading) -> Iterator[Message]:
    names = "x_ut", "y_ut", "z_ut", "temperature_c"
    yield _reading("/compass/field", schemas.FIELD, reading, names)


def _heading(reading: HeadingReading) -> Iterator[Message]:
    names = "heading_deg", "reference", "variation_deg", "pitch_deg", "roll_deg"
    yield _reading("/compass/heading", schemas.HEADING, reading, names)


def _pressure(reading: PressureReading) -> Iterator[Message]:
    yield _reading("/altimeter", schemas.PRESSURE, reading, ("pressure_hpa", "temperature_c"))


def _altitude(reading: AltitudeReading) -> Iterator[Message]:
    fields = {"altitude_m": reading.altitude_m, "sigma_m": reading.sigma_m}
    yield Message("/altitude", schemas.ALTITUDE, timebase.monotonic_s(), fields)


def _base_estimate(base_estimate: BaseEstimate) -> Iterator[Message]:
    now_s = timebase.monotonic_s()
    fields = {
        "heading_deg": base_estimate.attitude.azimuth_deg,
        "heading_sigma_deg": base_estimate.heading.sigma_deg,
        "pitch_deg": base_estimate.attitude.tilt_deg,
        "roll_deg": base_estimate.attitude.roll_deg,
        "residual_deg": base_estimate.level.residual_deg,
    }
    yield Message("/standing", schemas.STANDING, now_s, fields)
    yield _transform("/world/vehicle", now_s, "world", "vehicle", body_rotation(base_estimate.attitude))


def _frame(frame: TimedFrame) -> Iterator[Message]:
    height, width = frame.image_bgr.shape[:2]
    size = THUMBNAIL_WIDTH, round(height * THUMBNAIL_WIDTH / width)
    small = cv2.resize(frame.image_bgr, size, interpolation=cv2.INTER_AREA)
    data = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes()
    fields = {"frame_id": "camera", "data": base64.b64encode(data).decode(), "format": "jpeg"}
    yield Message("/camera/image", schemas.COMPRESSED_IMAGE, frame.arrived.monotonic_s, fields)


def _view(view: View) -> Iterator[Message]:
    fields = {
        "azimuth_deg": view.pointing.azimuth_deg,
        "tilt_deg": view.pointing.tilt_deg,
        "roll_deg": view.pointing.roll_deg,
        "skyline_share": view.skyline_share,
    }
    yield Message("/view", schemas.VIEW, view.state.monotonic_s, fields)


def _step(step: Step) -> Iterator[Message]:
    fields = {
        "level": LOG_LEVELS[step.level],
        "message": step.text,
        "name": step.source,
        "file": "",
        "line": 0,
    }
    yield Message("/log", schemas.LOG, timebase.monotonic_s(), fields)


def _bundle(path: Path) -> Iterator[Message]:
    fields = {"id": path.name, "directory": str(path)}
    yield Message("/bundle", schemas.BUNDLE, timebase.monotonic_s(), fields)


_CONVERTERS: dict[type, Callable[[Any], Iterator[Message]]] = {
    HeadState: _head,
    AccelerationReading: _acceleration,
    FieldReading: _field,
    HeadingReading: _heading,
    PressureReading: _pressure,
    AltitudeReading: _altitude,
    BaseEstimate: _base_estimate,
    TimedFrame: _frame,
    View: _view,
    Step: _step,
}
_CONVERTERS[type(Path())] = _bundle


def _reading(topic: str, schema: Schema, reading: Any, names: tuple[str, ...]) -> Message:
    values = {name: getattr(reading, name) for name in names}
    # JSON has no NaN, the value of a chip without a thermometer.
    fields = {
        name: None if isinstance(v, float) and not math.isfinite(v) else v for name, v in values.items()
    }
    return Message(topic, schema, reading.monotonic_s, fields)


def _transform(
    topic: str, monotonic_s: float, parent: str, child: str, rotation: NDArray[np.float64]
) -> Message:
    x, y, z, w = Rotation.from_matrix(rotation).as_quat().tolist()
    fields = {
        "parent_frame_id": parent,
        "child_frame_id": child,
        "translation": {"x": 0.0, "y": 0.0, "z": 0.0},
        "rotation": {"x": x, "y": y, "z": z, "w": w},
    }
    return Message(topic, schemas.FRAME_TRANSFORM, monotonic_s, fields)


def time_ns(monotonic_s: float) -> int:
    """UTC by the session's clock, nanoseconds since 1970."""
    return round(clock.utc_at(monotonic_s).timestamp() * 1e9)
