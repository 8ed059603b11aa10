"""Writes a measurement bundle (``skyfix.bundle/1``): its directory is complete or absent."""

import os
import re
import secrets
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from localizer.bundle import FILE_NAME, Altitude, Bundle, Camera, Frame, load_bundle, sha256_of
from localizer.os_errors import why_not_written
from rig.atomic import sync
from rig.errors import RigError

MIN_FREE_BYTES = 20_000_000


class BundleWriteError(RigError):
    """The bundle cannot be written into its folder."""


@dataclass(frozen=True)
class FrameRecord:
    """One frame with its calibrated readings; ``raw`` (JSON values) holds the readings that they were derived from."""

    label: str
    image_bgr: NDArray[np.uint8]
    time: datetime
    azimuth_deg: float
    azimuth_sigma_deg: float
    tilt_deg: float
    tilt_sigma_deg: float
    roll_deg: float
    roll_sigma_deg: float
    raw: Mapping[str, Any]


@dataclass(frozen=True)
class Measurement:
    """The content of a bundle. ``raw`` and ``calibration`` hold JSON values."""

    created: datetime
    camera: Camera
    mast_height_m: float
    altitude: Altitude | None
    azimuth_bias_sigma_deg: float
    tilt_bias_sigma_deg: float
    frames: Sequence[FrameRecord]
    raw: Mapping[str, Any]
    calibration: Mapping[str, Any]


def require_writable(folder: Path) -> None:
    """Raise ``BundleWriteError`` if bundles cannot be written into ``folder``, which need not exist yet.

    Checked before the measurement starts, so that a misspelt --out does not cost a whole capture.
    """
    existing = existing_part(folder)
    if not existing.is_dir():
        raise BundleWriteError(f"{folder}: {existing} is not a directory; choose another with --out")
    if not os.access(existing, os.W_OK | os.X_OK):
        raise BundleWriteError(f"{folder}: no permission to write in {existing}; choose another with --out")
    free_bytes = shutil.disk_usage(existing).free
    if free_bytes < MIN_FREE_BYTES:
        raise BundleWriteError(
            f"{folder}: only {free_bytes / 1e6:.1f} MB are free, a bundle may need {MIN_FREE_BYTES / 1e6:.0f}; "
            "make room, or choose another with --out"
        )


def existing_part(path: Path) -> Path:
    """The path itself, or its nearest existing parent."""
    while not path.exists() and path != path.parent:
        path = path.parent
    return path


def write_bundle(folder: Path, measurement: Measurement) -> Path:
    """Write a bundle into ``folder`` (made where absent) and return its directory, named by its id.

    Written under a hidden name, fsynced, read back with the bundle reader, and renamed. After a failure or an
    interruption nothing is left behind. ``BundleWriteError`` if the disk refuses; ``BundleError`` if the measurement
    makes no valid bundle.
    """
    name = f"{measurement.created:%Y%m%dT%H%M%SZ}-{secrets.token_hex(2)}"
    partial = folder / f".{name}.partial"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (partial / "frames").mkdir(parents=True)
        frames = [_write_frame(partial, frame, n) for n, frame in enumerate(measurement.frames, 1)]
        _write(partial / FILE_NAME, _bundle(name, measurement, frames).to_json().encode())
        for directory in (partial / "frames", partial):
            sync(directory)
        load_bundle(partial)
        partial.rename(folder / name)
        sync(folder)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        field = ".".join(map(str, first["loc"]))
        raise BundleWriteError(
            f"{folder / name}: would be no valid bundle: {field}: {first['msg']}"
        ) from error
    except OSError as error:
        why = why_not_written(error, "choose another with --out")
        raise BundleWriteError(f"{folder / name}: {why}") from error
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return folder / name


def _bundle(name: str, measurement: Measurement, frames: list[Frame]) -> Bundle:
    return Bundle.model_validate(
        {
            "schema": "skyfix.bundle/1",
            "id": name,
            "created": measurement.created.replace(microsecond=0),
            "camera": measurement.camera,
            "mast_height_m": measurement.mast_height_m,
            "altitude": measurement.altitude,
            "azimuth_bias_sigma_deg": measurement.azimuth_bias_sigma_deg,
            "tilt_bias_sigma_deg": measurement.tilt_bias_sigma_deg,
            "frames": frames,
            "raw": dict(measurement.raw),
            "calibration": dict(measurement.calibration),
        }
    )


def _write_frame(directory: Path, record: FrameRecord, number: int) -> Frame:
    # on recalibration the label comes from an untrusted bundle
    plain = re.fullmatch(r"[0-9A-Za-z][0-9A-Za-z_.-]*", record.label)
    file = f"frames/{record.label if plain else f'frame-{number}'}.png"
    _write(directory / file, cv2.imencode(".png", record.image_bgr)[1].tobytes())
    return Frame.model_validate(
        {
            "label": record.label,
            "file": file,
            "sha256": sha256_of(directory / file),
            "time": record.time,
            "azimuth_deg": round(record.azimuth_deg, 6) % 360.0,  # rounded first: -1e-15 % 360 is 360
            "azimuth_sigma_deg": record.azimuth_sigma_deg,
            "tilt_deg": record.tilt_deg,
            "tilt_sigma_deg": record.tilt_sigma_deg,
            "roll_deg": record.roll_deg,
            "roll_sigma_deg": record.roll_sigma_deg,
            "raw": dict(record.raw),
        }
    )


def _write(path: Path, content: bytes) -> None:
    with path.open("xb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
