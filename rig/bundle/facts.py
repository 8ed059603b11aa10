"""What a bundle holds, in a few JSON values: for lists, records of series, and tables."""

import os
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from localizer.bundle import FILE_NAME, Bundle, Frame

Record = dict[str, Any]

TABLE_COLUMNS = (
    "bundle",
    "created",
    "series",
    "number",
    "altitude_m",
    "altitude_sigma_m",
    "heading_deg",
    "azimuth_bias_sigma_deg",
    "tilt_bias_sigma_deg",
    "label",
    "time",
    "azimuth_deg",
    "azimuth_sigma_deg",
    "tilt_deg",
    "tilt_sigma_deg",
    "roll_deg",
    "roll_sigma_deg",
    "skyline_share",
    "sha256",
)


def bundles_in(folder: Path) -> list[Path]:
    """The bundles in a folder and in folders below it, by their names and so by their times; ``folder`` may be one."""
    return sorted(_bundles_below(folder), key=lambda path: (path.name, path))


def _bundles_below(folder: Path) -> Iterator[Path]:
    for path, folders, files in os.walk(folder):
        if FILE_NAME in files:
            yield Path(path)
            folders.clear()
        else:
            folders[:] = [name for name in folders if not name.startswith(".")]  # what is being written


def facts(bundle: Bundle) -> Record:
    """A bundle in a few JSON values."""
    raw, calibration = _extra(bundle, "raw"), _extra(bundle, "calibration")
    return {
        "id": bundle.id,
        "created": bundle.model_dump(mode="json")["created"],
        "directory": str(bundle.directory),
        "rig": raw.get("rig"),
        "series": raw.get("series"),
        "readings": readings(bundle),
        "frames": [_frame(frame) for frame in bundle.frames],
        "calibrations": {
            kind: (record.get("content") or {}).get("id")
            for kind, record in (calibration.get("files") or {}).items()
        },
        "recalibrated_from": raw.get("recalibrated_from"),
        "faults": raw.get("faults", []),
    }


def readings(bundle: Bundle) -> Record:
    """How vehicle and camera stood, each angle by its name; what the bundle's writer did not record is absent."""
    calibration = _extra(bundle, "calibration")
    found: Record = {
        "altitude_m": bundle.altitude.value_m if bundle.altitude else None,
        "altitude_sigma_m": bundle.altitude.sigma_m if bundle.altitude else None,
        "heading_deg": (calibration.get("heading") or {}).get("heading_deg"),
        "azimuth_bias_sigma_deg": bundle.azimuth_bias_sigma_deg,
        "pitch_deg": (calibration.get("level") or {}).get("pitch_deg"),
        "roll_deg": (calibration.get("level") or {}).get("roll_deg"),
        "tilt_bias_sigma_deg": bundle.tilt_bias_sigma_deg,
    }
    for frame in bundle.frames:
        found |= {
            f"{frame.label} azimuth_deg": frame.azimuth_deg,
            f"{frame.label} tilt_deg": frame.tilt_deg,
            f"{frame.label} roll_deg": frame.roll_deg,
            f"{frame.label} skyline_share": skyline_share(frame),
        }
    return {name: value for name, value in found.items() if value is not None}


def skyline_share(frame: Frame) -> float | None:
    """Share of the columns in which the capture saw a skyline."""
    share: float | None = (_extra(frame, "raw").get("skyline") or {}).get("share")
    return share


def table_rows(bundle: Bundle) -> Iterator[Record]:
    """A row of ``TABLE_COLUMNS`` for each frame."""
    known = readings(bundle)
    series = _extra(bundle, "raw").get("series") or {}
    for frame in bundle.frames:
        fields = frame.model_dump(mode="json")
        yield {
            **{name: known.get(name, "") for name in TABLE_COLUMNS},
            **{name: fields[name] for name in TABLE_COLUMNS if name in fields},
            "bundle": bundle.id,
            "created": bundle.model_dump(mode="json")["created"],
            "series": series.get("id", ""),
            "number": series.get("number", ""),
            "skyline_share": skyline_share(frame),
        }


def _frame(frame: Frame) -> Record:
    fields = frame.model_dump(mode="json")
    names = ("label", "time", "azimuth_deg", "azimuth_sigma_deg", "tilt_deg", "tilt_sigma_deg", "roll_deg")
    raw = _extra(frame, "raw")
    return {
        **{name: fields[name] for name in (*names, "roll_sigma_deg")},
        "skyline_share": skyline_share(frame),
        "servo_volts": raw.get("servo_volts"),
        "servo_temperatures_c": raw.get("servo_temperatures_c"),
    }


def _extra(part: Bundle | Frame, name: str) -> Mapping[str, Any]:
    """What the contract leaves to the writer; other writers may leave it out."""
    value = (part.model_extra or {}).get(name)
    return value if isinstance(value, Mapping) else {}


def how_often(count: int) -> str:
    """In words."""
    return "once" if count == 1 else f"{count} times"


def to_the_second(time: str) -> str:
    """A time in ISO 8601 without its fraction of a second, for people."""
    return re.sub(r"\.\d+", "", time)
