"""A small bundle on the disk."""

from pathlib import Path

import numpy as np

from localizer.bundle import Camera
from rig.bundle.writer import FrameRecord, Measurement, write_bundle
from rig.clock import utc_now

FAULT = {"device": "camera", "problem": "was black", "action": "tried again", "count": 2}
SERIES = {"id": "series-20261124T150000Z-3f9a", "number": 7}


def write_one(folder: Path) -> Path:
    image = np.full((48, 64, 3), (230, 180, 140), np.uint8)
    image[20:] = (40, 60, 50)
    image += np.random.default_rng(1).integers(0, 8, image.shape, np.uint8)
    raw = {"skyline": {"share": 0.97}, "servo_volts": [12.1, 12.0], "servo_temperatures_c": [31.0, 33.0]}
    frame = FrameRecord("N", image, utc_now(), 0.1, 0.1, 5.0, 0.01, -0.3, 0.02, raw)
    camera = Camera(width_px=64, height_px=48, fx_px=50.0, fy_px=50.0, cx_px=31.5, cy_px=23.5)
    calibration = {"heading": {"heading_deg": 162.25}, "level": {"pitch_deg": 1.5, "roll_deg": -0.5}}
    raw_of_bundle = {"faults": [FAULT], "series": SERIES}
    return write_bundle(
        folder,
        Measurement(utc_now(), camera, 2.0, None, 1.0, 0.02, [frame], raw_of_bundle, calibration),
    )
