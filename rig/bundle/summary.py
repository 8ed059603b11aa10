"""Summary of a bundle in a few JSON values: for lists, series journals and tables."""

import os
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from localizer.bundle import FILE_NAME, Bundle, Frame

JsonObject = dict[str, Any]

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
    """The bundles in a folder and its subfolders, ordered by name and so by time. ``folder`` may itself be a bundle."""
    return sorted(_bundles_below(folder), key=lambda path: (path.name, path))


def _bundles_below(folder: Path) -> Iterator[Path]:
    for path, folders, files in os.walk(folder):
        if FILE_NAME in files:
            yield Path(path)
            folders.clear()
        else:
            folders[:] = [name for name in folders if not name.startswith(".")]  # what is being written


def bundle_summary(bundle: Bundle) -> JsonObject:
    """A bundle in a few JSON values. Fields that the contract leaves to the writer are used if they are as ``rig``
    writes them.
    """
    raw, calibration = extra_of(bundle, "raw"), extra_of(bundle, "calibration")
    files = calibration.get("files")
    return {
        "id": bundle.id,
        "created": bundle.model_dump(mode="json")["created"],
        "directory": str(bundle.directory),
        "rig": _text(raw.get("rig")),
        "series": _series(raw),
        "readings": readings(bundle),
        "frames": [_frame(frame) for frame in bundle.frames],
        "calibrations": {
            _text(kind): _text(_at(record, "content", "id"))
            for kind, record in (files.items() if isinstance(files, Mapping) else ())
        },
        "recalibrated_from": _text(raw.get("recalibrated_from")),
        "faults": _faults(raw),
    }


def readings(bundle: Bundle) -> JsonObject:
    """Attitude of vehicle and camera, each angle by its name; what the bundle's writer did not record is absent."""
    calibration = extra_of(bundle, "calibration")
    found: JsonObject = {
        "altitude_m": bundle.altitude.value_m if bundle.altitude else None,
        "altitude_sigma_m": bundle.altitude.sigma_m if bundle.altitude else None,
        "heading_deg": _number(_at(calibration, "heading", "heading_deg")),
        "azimuth_bias_sigma_deg": bundle.azimuth_bias_sigma_deg,
        "pitch_deg": _number(_at(calibration, "level", "pitch_deg")),
        "roll_deg": _number(_at(calibration, "level", "roll_deg")),
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
    """Share of the image columns in which the capture found a skyline."""
    return _number(_at(extra_of(frame, "raw"), "skyline", "share"))


def table_rows(bundle: Bundle) -> Iterator[JsonObject]:
    """A row of ``TABLE_COLUMNS`` for each frame."""
    known = readings(bundle)
    series = _series(extra_of(bundle, "raw")) or {}
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


def _frame(frame: Frame) -> JsonObject:
    fields = frame.model_dump(mode="json")
    names = ("label", "time", "azimuth_deg", "azimuth_sigma_deg", "tilt_deg", "tilt_sigma_deg", "roll_deg")
    raw = extra_of(frame, "raw")
    return {
        **{name: fields[name] for name in (*names, "roll_sigma_deg")},
        "skyline_share": skyline_share(frame),
        "servo_volts": _numbers(raw.get("servo_volts")),
        "servo_temperatures_c": _numbers(raw.get("servo_temperatures_c")),
    }


def _series(raw: Mapping[str, Any]) -> JsonObject | None:
    """The series that the bundle belongs to, if any."""
    name, number = _text(_at(raw, "series", "id")), _at(raw, "series", "number")
    if name is None or isinstance(number, bool) or not isinstance(number, int):
        return None
    return {"id": name, "number": number}


def _faults(raw: Mapping[str, Any]) -> list[JsonObject]:
    """Recovered faults, as ``rig.fault_notes`` records them."""
    noted = raw.get("faults")
    return [
        {**fault, **{key: _text(fault[key]) for key in ("device", "problem", "action")}}
        for fault in (noted if isinstance(noted, list) else ())
        if isinstance(fault, Mapping)
        and all(isinstance(fault.get(key), str) for key in ("device", "problem", "action"))
        and isinstance(fault.get("count"), int)
    ]


def _at(value: object, *keys: str) -> object:
    """The value at a path of keys; None if there is none."""
    for key in keys:
        value = value.get(key) if isinstance(value, Mapping) else None
    return value


def _number(value: object) -> float | None:
    return value if isinstance(value, int | float) and not isinstance(value, bool) else None


def _numbers(value: object) -> list[float] | None:
    if isinstance(value, list) and value and all(_number(each) is not None for each in value):
        return value
    return None


def _text(value: object) -> str | None:
    """Printable characters only: a terminal would act on control characters."""
    if not isinstance(value, str):
        return None
    return "".join(letter if letter.isprintable() else " " for letter in value)


def extra_of(part: Bundle | Frame, name: str) -> Mapping[str, Any]:
    """Fields that the contract leaves to the writer; other writers may omit them."""
    value = (part.model_extra or {}).get(name)
    return value if isinstance(value, Mapping) else {}


def times_text(count: int) -> str:
    """ "once", "twice", "3 times", ..."""
    return "once" if count == 1 else f"{count} times"


def to_the_second(time: str) -> str:
    """An ISO 8601 time without the fraction of a second, for display."""
    return re.sub(r"\.\d+", "", time)
