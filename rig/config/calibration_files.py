"""Calibration files, ``skyfix.calibration/1``: result, time, device, and quality of the fit.

A calibration holds values that replace keys of the configuration. Other keys keep their configured values.
"""

import hashlib
import json
import secrets
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AwareDatetime, BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from localizer.documents import MOST_JSON_BYTES, DocumentError, json_text, read_file
from localizer.os_errors import why_not_read, why_not_written
from rig.atomic import write_atomically
from rig.errors import RigError

CalibrationKind = Literal["camera", "inclinometer", "compass", "altimeter", "boresight"]
CALIBRATION_ORDER: tuple[CalibrationKind, ...] = (
    "camera",
    "inclinometer",
    "compass",
    "altimeter",
    "boresight",
)
"""The order of the calibrations; each uses the ones before it."""

Triple = tuple[float, float, float]
Matrix = tuple[Triple, Triple, Triple]
Positive = Annotated[float, Field(gt=0.0)]
Values = dict[str, dict[str, Any]]
"""Section -> key -> value."""


class CalibrationError(RigError):
    """A calibration is rejected, or its file cannot be used; the message says why and what to do."""


class _Document(BaseModel):
    """Fields of all calibrations: rig, time, device, the calibrations in force, and figures of the fit."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    schema_name: Literal["skyfix.calibration/1"] = Field(default="skyfix.calibration/1", alias="schema")
    id: Annotated[str, Field(min_length=1, max_length=128)]
    created: AwareDatetime
    rig: str
    device: str
    based_on: dict[str, str] = {}
    """Ids, by kind, of the calibrations in force when it was made."""
    fit: dict[str, float | int | str | bool | list[float] | None] = {}

    def values(self) -> Values:
        """The configuration keys that it replaces."""
        raise NotImplementedError

    def made_for(self) -> Mapping[str, Mapping[str, Any] | None]:
        """The configuration keys that identify its device, by section; None for a section that must be absent."""
        raise NotImplementedError


class CameraCalibration(_Document):
    """Lens and sensor: intrinsics in px, distortion k1, k2, p1, p2, k3."""

    kind: Literal["camera"] = "camera"
    width_px: int
    height_px: int
    fx_px: Positive
    fy_px: Positive
    cx_px: float
    cy_px: float
    distortion: tuple[float, float, float, float, float]
    sigma: dict[str, float] = {}
    """One standard deviation of each parameter, in its unit."""

    def values(self) -> Values:
        keys = ("fx_px", "fy_px", "cx_px", "cy_px", "distortion")
        return {"camera": {key: getattr(self, key) for key in keys}}

    def made_for(self) -> Mapping[str, Mapping[str, Any] | None]:
        return {"camera": {"width_px": self.width_px, "height_px": self.height_px}}


class InclinometerCalibration(_Document):
    """Errors and mounting of the accelerometer (``rig.attitude.accelerometer``)."""

    kind: Literal["inclinometer"] = "inclinometer"
    chip: str
    axes: tuple[str, str, str]
    zero_mg: Triple
    scale: Triple
    mounting_deg: Triple
    drift_mg_c: Triple
    zero_temperature_c: float
    tilt_bias_sigma_deg: Positive
    roll_sigma_deg: Positive | None = None
    """Sigma of a roll: reading and residual zero error together. None keeps the configured value."""

    def values(self) -> Values:
        keys = [
            *("zero_mg", "scale", "mounting_deg", "drift_mg_c"),
            *("zero_temperature_c", "tilt_bias_sigma_deg"),
        ]
        if self.roll_sigma_deg is not None:
            keys.append("roll_sigma_deg")
        return {"inclinometer": {key: getattr(self, key) for key in keys}}

    def made_for(self) -> Mapping[str, Mapping[str, Any] | None]:
        return {"inclinometer": {"chip": self.chip, "axes": self.axes}}


class CompassCalibration(_Document):
    """Iron of the pan stage and of the vehicle: measured field = soft_iron @ field there + hard_iron_ut, likewise in
    the base.
    """

    kind: Literal["compass"] = "compass"
    compass: str
    axes: tuple[str, str, str]
    hard_iron_ut: Triple
    soft_iron: Matrix
    vehicle_hard_iron_ut: Triple
    vehicle_soft_iron: Matrix
    azimuth_bias_sigma_deg: Positive

    def values(self) -> Values:
        keys = (
            *("hard_iron_ut", "soft_iron", "vehicle_hard_iron_ut", "vehicle_soft_iron"),
            "azimuth_bias_sigma_deg",
        )
        return {"compass": {key: getattr(self, key) for key in keys}}

    def made_for(self) -> Mapping[str, Mapping[str, Any] | None]:
        return {"compass": {"kind": self.compass, "axes": self.axes}}


class AltimeterCalibration(_Document):
    """The air pressure at a known altitude, and how fast the altitude's sigma grows."""

    kind: Literal["altimeter"] = "altimeter"
    altimeter: str
    reference_pressure_hpa: Positive
    reference_altitude_m: float
    reference_temperature_c: float | None
    reference_time: AwareDatetime
    sigma_m: Positive
    drift_m_h: Annotated[float, Field(ge=0.0)]

    def values(self) -> Values:
        keys = (
            *("reference_pressure_hpa", "reference_altitude_m", "reference_temperature_c"),
            *("reference_time", "sigma_m", "drift_m_h"),
        )
        return {"altimeter": {key: getattr(self, key) for key in keys}}

    def made_for(self) -> Mapping[str, Mapping[str, Any] | None]:
        return {"altimeter": {"kind": self.altimeter}}


class BoresightCalibration(_Document):
    """Camera mounting in the head, and the heading offset. Their sum was measured, so they belong together.

    ``covariance_deg2`` is of azimuth (that sum), tilt and roll. ``heading_offset_deg`` is None without a compass.
    """

    kind: Literal["boresight"] = "boresight"
    azimuth_deg: Annotated[float, Field(ge=-45.0, le=45.0)]
    tilt_deg: Annotated[float, Field(ge=-45.0, le=45.0)]
    roll_deg: Annotated[float, Field(ge=-180.0, le=180.0)]
    heading_offset_deg: Annotated[float, Field(ge=-180.0, le=180.0)] | None
    covariance_deg2: Matrix

    def values(self) -> Values:
        sigmas = [self.covariance_deg2[i][i] ** 0.5 for i in range(3)]
        names = ("azimuth", "tilt", "roll")
        camera = {f"boresight_{name}_deg": getattr(self, f"{name}_deg") for name in names}
        camera |= {f"boresight_{name}_sigma_deg": s for name, s in zip(names, sigmas, strict=True)}
        if self.heading_offset_deg is None:
            return {"camera": camera}
        return {"camera": camera, "compass": {"heading_offset_deg": self.heading_offset_deg}}

    def made_for(self) -> Mapping[str, Mapping[str, Any] | None]:
        return {"compass": None if self.heading_offset_deg is None else {}}


Calibration = Annotated[
    CameraCalibration
    | InclinometerCalibration
    | CompassCalibration
    | AltimeterCalibration
    | BoresightCalibration,
    Field(discriminator="kind"),
]
_CALIBRATION: TypeAdapter[Calibration] = TypeAdapter(Calibration)


@dataclass(frozen=True)
class AppliedCalibration:
    """A calibration in force, its file name and the file's checksum."""

    document: Calibration
    file: str
    sha256: str

    def record(self) -> dict[str, Any]:
        """For the bundle: id, file, checksum and content."""
        return {
            "id": self.document.id,
            "created": self.document.created.isoformat().replace("+00:00", "Z"),
            "file": Path(self.file).name,
            "sha256": self.sha256,
            "content": self.document.model_dump(mode="json", by_alias=True),
        }


def new_id(kind: CalibrationKind, created: datetime) -> str:
    """The id of a calibration, and the name of its file without the suffix."""
    return f"{kind}-{created.astimezone(UTC):%Y%m%dT%H%M%SZ}-{secrets.token_hex(2)}"


def write_calibration(document: Calibration, folder: Path) -> Path:
    """Write a calibration into ``folder`` under its id and return the file. ``CalibrationError`` where that fails."""
    path = folder / f"{document.id}.json"
    content = json.dumps(document.model_dump(mode="json", by_alias=True), indent=2, allow_nan=False) + "\n"
    try:
        write_atomically(path, content.encode())
    except OSError as error:
        raise CalibrationError(f"{path}: {why_not_written(error, 'choose another with --out')}") from error
    return path


def read_calibration(path: Path, kind: str | None = None) -> AppliedCalibration:
    """Read and check a calibration file, of one kind if that is given. ``CalibrationError`` names file and field."""
    try:
        content = read_file(path, MOST_JSON_BYTES)
    except DocumentError as error:
        raise CalibrationError(f"{path}: {error}; calibrate anew") from error
    except OSError as error:
        raise CalibrationError(
            f"{path}: {why_not_read(error, path)}; check [calibration], or calibrate anew with rig calibrate"
        ) from error
    applied = AppliedCalibration(
        parse_calibration(content, str(path)), str(path), hashlib.sha256(content).hexdigest()
    )
    if kind is not None and applied.document.kind != kind:
        raise CalibrationError(
            f"{path}: calibrates the {applied.document.kind}, not the {kind}; name it in [calibration] as what it is"
        )
    return applied


def parse_calibration(content: bytes | str, file: str) -> Calibration:
    """The calibration that a file holds. ``CalibrationError`` names ``file`` and the field."""
    try:
        return _CALIBRATION.validate_json(json_text(content))
    except DocumentError as error:
        raise CalibrationError(f"{file}: {error}; calibrate anew") from error
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        field = ".".join(str(part) for part in first["loc"][1:] or first["loc"])
        raise CalibrationError(f"{file}: {field or 'content'}: {first['msg']}; calibrate anew") from error
