"""Disk space check for a series."""

import shutil
from pathlib import Path

from rig.bundle.writer import MIN_FREE_BYTES, BundleWriteError, existing_part
from rig.config.model import RigConfig

FRAME_BYTES_OF_RAW = 1.01  # a PNG of noise is no smaller than its pixels
PREVIEW_BYTES = 400_000
RECORD_BYTES = 100_000
TELEMETRY_BYTES = 1_000_000  # of half a minute


def bundle_bytes(config: RigConfig, frames: int) -> int:
    """Largest size of a bundle with its picture and telemetry."""
    raw = config.camera.width_px * config.camera.height_px * 3
    return round(frames * raw * FRAME_BYTES_OF_RAW) + PREVIEW_BYTES + RECORD_BYTES + TELEMETRY_BYTES


def require_space(folder: Path, config: RigConfig, bundles: int, frames: int) -> None:
    """Raise ``BundleWriteError`` if this many bundles do not fit, and say how many would."""
    each = bundle_bytes(config, frames)
    free = shutil.disk_usage(existing_part(folder)).free
    if free < bundles * each + MIN_FREE_BYTES:
        fit = max(0, (free - MIN_FREE_BYTES) // each)
        raise BundleWriteError(
            f"{folder}: {bundles} bundles may need {(bundles * each + MIN_FREE_BYTES) / 1e6:.0f} MB, "
            f"{free / 1e6:.0f} MB are free, enough for {fit}; make room, choose another with --out, or take fewer"
        )
