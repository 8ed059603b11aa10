"""JSON schemas of the messages: Foxglove's own where one exists, so that its panels know them, else ours.

https://docs.foxglove.dev/docs/visualization/message-schemas: a time is {"sec", "nsec"}, bytes are base64.
"""

from typing import Any

Schema = dict[str, Any]

TIME: Schema = {
    "type": "object",
    "title": "time",
    "properties": {
        "sec": {"type": "integer", "minimum": 0},
        "nsec": {"type": "integer", "minimum": 0, "maximum": 999_999_999},
    },
}
NUMBER: Schema = {"type": "number"}
MAYBE: Schema = {"type": ["number", "null"]}
INTEGER: Schema = {"type": "integer"}
TEXT: Schema = {"type": "string"}
TRUTH: Schema = {"type": "boolean"}
TEXTS: Schema = {"type": "array", "items": TEXT}


def _object(title: str, **fields: Schema) -> Schema:
    return {"title": title, "type": "object", "properties": fields, "required": list(fields)}


def _numbers(count: int) -> Schema:
    return {"type": "array", "items": NUMBER, "minItems": count, "maxItems": count}


def _vector(axes: str) -> Schema:
    return _object("vector", **dict.fromkeys(axes, NUMBER))


COMPRESSED_IMAGE = _object(
    "foxglove.CompressedImage",
    timestamp=TIME,
    frame_id=TEXT,
    data={"type": "string", "contentEncoding": "base64"},
    format=TEXT,
)
CAMERA_CALIBRATION = _object(
    "foxglove.CameraCalibration",
    timestamp=TIME,
    frame_id=TEXT,
    width=INTEGER,
    height=INTEGER,
    distortion_model=TEXT,
    D={"type": "array", "items": NUMBER},
    K=_numbers(9),
    R=_numbers(9),
    P=_numbers(12),
)
LOG = _object("foxglove.Log", timestamp=TIME, level=INTEGER, message=TEXT, name=TEXT, file=TEXT, line=INTEGER)
FRAME_TRANSFORM = _object(
    "foxglove.FrameTransform",
    timestamp=TIME,
    parent_frame_id=TEXT,
    child_frame_id=TEXT,
    translation=_vector("xyz"),
    rotation=_vector("xyzw"),
)
HEAD_STATE = _object(
    "skyfix.HeadState",
    timestamp=TIME,
    pan_deg=NUMBER,
    tilt_deg=NUMBER,
    moving=TRUTH,
    pan_tick=INTEGER,
    tilt_tick=INTEGER,
    pan_v=NUMBER,
    tilt_v=NUMBER,
    pan_c=NUMBER,
    tilt_c=NUMBER,
    alerts=TEXTS,
)
ACCELERATION = _object(
    "skyfix.Acceleration", timestamp=TIME, x_g=NUMBER, y_g=NUMBER, z_g=MAYBE, temperature_c=NUMBER
)
FIELD = _object("skyfix.Field", timestamp=TIME, x_ut=NUMBER, y_ut=NUMBER, z_ut=NUMBER, temperature_c=MAYBE)
HEADING = _object(
    "skyfix.Heading",
    timestamp=TIME,
    heading_deg=NUMBER,
    reference=TEXT,
    variation_deg=MAYBE,
    pitch_deg=MAYBE,
    roll_deg=MAYBE,
)
PRESSURE = _object("skyfix.Pressure", timestamp=TIME, pressure_hpa=NUMBER, temperature_c=MAYBE)
ALTITUDE = _object("skyfix.Altitude", timestamp=TIME, altitude_m=NUMBER, sigma_m=NUMBER)
STANDING = _object(
    "skyfix.Standing",
    timestamp=TIME,
    heading_deg=NUMBER,
    heading_sigma_deg=NUMBER,
    pitch_deg=NUMBER,
    roll_deg=NUMBER,
    residual_deg=NUMBER,
)
VIEW = _object(
    "skyfix.View",
    timestamp=TIME,
    azimuth_deg=NUMBER,
    tilt_deg=NUMBER,
    roll_deg=NUMBER,
    skyline_share=NUMBER,
)
BUNDLE = _object("skyfix.Bundle", timestamp=TIME, id=TEXT, directory=TEXT)
