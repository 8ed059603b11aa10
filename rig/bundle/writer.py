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
from rig.atomic import make_folder, sync, write_synced
from rig.errors import RigError

MIN_FREE_BYTES = 20_000_000


BundleCamera, BundleAltitude = Camera, Altitude
"""The camera and the altitude as a bundle describes them."""


class BundleWriteError(RigError):
    """The bundle cannot be written into its folder."""


@dataclass(frozen=True)
class FrameRecord:
    """One picture with its calibrated readings.

    Attributes
    ----------
    label : str
        Names the frame, and its file.
    image_bgr : array of uint8
        (height, width, 3): blue, green, red.
    time : datetime
        When it was taken, with its time zone.
    azimuth_deg, tilt_deg, roll_deg : float
        Where the optical axis points: clockwise from true north, above the horizontal; and how far the camera is turned
        clockwise about it.
    azimuth_sigma_deg, tilt_sigma_deg, roll_sigma_deg : float
        One standard deviation of each, independent in each frame.
    raw : mapping
        What these were derived from: JSON values.
    """

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
    """Everything that goes into a bundle.

    Attributes
    ----------
    created : datetime
        With its time zone.
    camera : BundleCamera
        Size, intrinsics in pixels, distortion.
    mast_height_m : float
        The optical centre above the ground.
    altitude : BundleAltitude or None
        Of the optical centre, above the DEM's vertical datum; None without an altimeter.
    azimuth_bias_sigma_deg, tilt_bias_sigma_deg : float
        One standard deviation of the errors that all frames share; 180 deg of azimuth without a compass.
    frames : sequence of FrameRecord
        One or more.
    raw, calibration : mapping
        What all was derived from, and by which calibration: JSON values.
    """

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


def write_bundle(folder: Path | str, measurement: Measurement) -> Path:
    """Write a measurement bundle (``skyfix.bundle/1``), for pictures of any rig.

    It is written under a hidden name, brought to the disk, read back as its reader will, and then renamed. Where
    any of that fails or is interrupted, nothing is left behind.

    Parameters
    ----------
    folder : path
        Where the bundle goes; made where it is absent.
    measurement : Measurement
        What goes into it.

    Returns
    -------
    pathlib.Path
        The bundle's directory, named by its id.

    Raises
    ------
    BundleWriteError
        The disk refuses, or a value is none that a bundle may hold.
    SkyfixError
        The measurement makes no valid bundle.

    Examples
    --------
    >>> import datetime, numpy as np, rig
    >>> now = datetime.datetime(2026, 11, 23, 4, 31, 51, tzinfo=datetime.timezone.utc)
    >>> frame = rig.FrameRecord(
    ...     label="N", image_bgr=np.zeros((480, 640, 3), np.uint8), time=now,
    ...     azimuth_deg=0.1, azimuth_sigma_deg=0.1, tilt_deg=5.0, tilt_sigma_deg=0.01,
    ...     roll_deg=-0.3, roll_sigma_deg=0.02, raw={},
    ... )
    >>> camera = rig.BundleCamera(
    ...     width_px=640, height_px=480, fx_px=492.8, fy_px=492.8, cx_px=319.5, cy_px=239.5,
    ...     distortion=(0.0, 0.0, 0.0, 0.0, 0.0),
    ... )
    >>> measurement = rig.Measurement(
    ...     created=now, camera=camera, mast_height_m=2.0, altitude=rig.BundleAltitude(value_m=1432.6, sigma_m=5.0),
    ...     azimuth_bias_sigma_deg=0.5, tilt_bias_sigma_deg=0.02, frames=[frame], raw={}, calibration={},
    ... )
    >>> folder = rig.write_bundle("bundles", measurement)
    >>> sorted(path.name for path in folder.iterdir())
    ['bundle.json', 'frames']
    """
    folder = Path(folder)
    name = f"{measurement.created:%Y%m%dT%H%M%SZ}-{secrets.token_hex(2)}"
    partial = folder / f".{name}.partial"
    try:
        make_folder(folder)
        (partial / "frames").mkdir(parents=True)
        frames = [_write_frame(partial, frame, n) for n, frame in enumerate(measurement.frames, 1)]
        write_synced(partial / FILE_NAME, _bundle(name, measurement, frames).to_json().encode())
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
    write_synced(directory / file, cv2.imencode(".png", record.image_bgr)[1].tobytes())
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
