"""Temperature drift of the accelerometer's zero, from a log of a head that did not move."""

import csv
import io
import math
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from localizer.documents import DocumentError, read_file
from localizer.os_errors import why_not_written
from rig import timebase
from rig.atomic import sync
from rig.attitude.accelerometer import Triple
from rig.capture.averaged_readings import read_level, utc_text
from rig.clock import Instant
from rig.config.calibration_files import CalibrationError
from rig.config.sections import InclinometerSection
from rig.devices.connect import Inclinometer

Vector = NDArray[np.float64]

COLUMNS = ("time", "temperature_c", "x_g", "y_g", "z_g")
MIN_SPAN_C = 8.0
MIN_READINGS = 10
RMS_LIMIT_MG = 0.5
PERIOD_S = 10.0
MAX_LOG_BYTES = 100_000_000
"""Years of readings."""


@dataclass(frozen=True)
class Drift:
    """Change of the zero error per degree Celsius and head axis, mg, and its sigma."""

    drift_mg_c: Triple
    sigma_mg_c: Triple
    span_c: float


def record_temperature_log(
    inclinometer: Inclinometer, section: InclinometerSection, path: Path, duration_s: float
) -> int:
    """Append the head's mean reading every ten seconds to a CSV file; returns how many. The head must not move."""
    end_s = timebase.monotonic_s() + duration_s
    count = 0
    try:
        with path.open("a", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            if file.tell() == 0:
                writer.writerow(COLUMNS)
                sync(path.parent)
            while count == 0 or timebase.monotonic_s() < end_s:
                level, _, _ = read_level(inclinometer, section, section.average_s)
                writer.writerow([utc_text(Instant.now().utc), level.temperature_c, *level.mean_g])
                file.flush()
                os.fsync(file.fileno())  # a log takes hours
                count += 1
                timebase.sleep(min(PERIOD_S, max(0.0, end_s - timebase.monotonic_s())))
    except OSError as error:
        raise CalibrationError(f"{path}: {why_not_written(error, 'choose another with --out')}") from error
    return count


def read_drift(path: Path) -> Drift:
    """The drift in a log. ``CalibrationError`` if it cannot be read, is too short, or the head moved."""
    log = _read(path)
    temperature, vectors = log[:, 0], log[:, 1:]
    span_c = float(np.ptp(temperature))
    if len(log) < MIN_READINGS or span_c < MIN_SPAN_C:
        raise CalibrationError(
            f"{path}: {len(log)} readings over {span_c:.1f} C tell no drift; log {MIN_READINGS} or more "
            f"over {MIN_SPAN_C:g} C or more"
        )
    design = np.column_stack([temperature - temperature.mean(), np.ones(len(log))])
    solution, *_ = np.linalg.lstsq(design, vectors, rcond=None)
    left = vectors - design @ solution
    rms_mg = 1000.0 * np.sqrt((left**2).sum(axis=0) / (len(log) - 2))
    if rms_mg.max() > RMS_LIMIT_MG:
        raise CalibrationError(
            f"{path}: {rms_mg.max():.2f} mg are left beside a steady drift; the head moved while it was logged"
        )
    sigma = rms_mg / np.sqrt((design[:, 0] ** 2).sum())
    return Drift(_triple(1000.0 * solution[0]), _triple(sigma), span_c)


def _read(path: Path) -> Vector:
    try:
        text = read_file(path, MAX_LOG_BYTES).decode("utf-8-sig")
        rows = list(csv.DictReader(io.StringIO(text, newline="")))
    except (OSError, UnicodeDecodeError, DocumentError, csv.Error) as error:
        raise CalibrationError(f"{path}: cannot be read as CSV: {error}; name a temperature log") from error
    values = []
    for number, row in enumerate(rows, start=2):
        try:
            values.append([_finite(row[name]) for name in COLUMNS[1:]])
        except (KeyError, TypeError, ValueError):
            raise CalibrationError(
                f"{path}: line {number}: needs numbers in the columns {', '.join(COLUMNS[1:])}"
            ) from None
    return np.array(values).reshape(-1, 4)


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError("not a finite number")
    return value


def _triple(values: Vector) -> Triple:
    x, y, z = (float(value) for value in values)
    return x, y, z
