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
    """What the document is, and its version."""
    id: Annotated[str, Field(min_length=1, max_length=128)]
    """The calibration's name, and that of its file without the suffix."""
    created: AwareDatetime
    """When it was made."""
    rig: str
    """Name of the rig, ``[rig] name`` of its configuration."""
    device: str
    """What was calibrated, as the device says it."""
    based_on: dict[str, str] = {}
    """Ids, by kind, of the calibrations in force when it was made."""
    fit: dict[str, float | int | str | bool | list[float] | None] = {}
    """How well the fit went, and with what; the names depend on the kind."""

    def values(self) -> Values:
        """The configuration keys that it replaces."""
        raise NotImplementedError

    def made_for(self) -> Mapping[str, Mapping[str, Any] | None]:
        """The configuration keys that identify its device, by section; None for a section that must be absent."""
        raise NotImplementedError


class CameraCalibration(_Document):
    """Lens and sensor: intrinsics in px, distortion k1, k2, p1, p2, k3."""

    kind: Literal["camera"] = "camera"
    """What is calibrated."""
    width_px: int
    """Width of the pictures that it holds for."""
    height_px: int
    """Height of the pictures that it holds for."""
    fx_px: Positive
    """Focal length, in widths of a pixel."""
    fy_px: Positive
    """Focal length, in heights of a pixel."""
    cx_px: float
    """Column of the principal point."""
    cy_px: float
    """Row of the principal point."""
    distortion: tuple[float, float, float, float, float]
    """OpenCV's k1, k2, p1, p2, k3."""
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
    """What is calibrated."""
    chip: str
    """The chip that it holds for."""
    axes: tuple[str, str, str]
    """The chip axes that point to the head's right, forward and up, for which it holds."""
    zero_mg: Triple
    """Zero error in head axes (right, forward, up), thousandths of g, at ``zero_temperature_c``."""
    scale: Triple
    """What the chip measures of 1 g, on each axis."""
    mounting_deg: Triple
    """Rotation vector that turns what the chip measures into the head's axes."""
    drift_mg_c: Triple
    """Change of the zero error with each degree Celsius."""
    zero_temperature_c: float
    """Temperature of the chip at which ``zero_mg`` holds."""
    tilt_bias_sigma_deg: Positive
    """One standard deviation of the tilt's error that all frames share."""
    roll_sigma_deg: Positive | None = None
    """One standard deviation of a roll, with what is left of the zero error; null leaves it as configured."""

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
    """What is calibrated."""
    compass: str
    """Kind of the compass that it holds for."""
    axes: tuple[str, str, str]
    """The chip axes that point to the right, forward and up at pan 0, for which it holds."""
    hard_iron_ut: Triple
    """Constant field of the pan stage (right, forward, up)."""
    soft_iron: Matrix
    """What the pan stage's iron makes of the field around it."""
    vehicle_hard_iron_ut: Triple
    """Constant field of the vehicle (right, forward, up)."""
    vehicle_soft_iron: Matrix
    """What the vehicle's iron makes of the Earth's field."""
    azimuth_bias_sigma_deg: Positive
    """One standard deviation of the azimuth's error that all frames share."""

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
    """What is calibrated."""
    altimeter: str
    """Kind of the altimeter that it holds for."""
    reference_pressure_hpa: Positive
    """Pressure that was read at the known altitude."""
    reference_altitude_m: float
    """The known altitude, above the DEM's vertical datum."""
    reference_temperature_c: float | None
    """Air temperature there; null: the standard atmosphere's."""
    reference_time: AwareDatetime
    """When the pressure was read."""
    sigma_m: Positive
    """One standard deviation of an altitude at that time."""
    drift_m_h: Annotated[float, Field(ge=0.0)]
    """By how much that grows each hour, as the weather changes."""

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
    """What is calibrated."""
    azimuth_deg: Annotated[float, Field(ge=-45.0, le=45.0)]
    """How the camera sits in the head: to the right."""
    tilt_deg: Annotated[float, Field(ge=-45.0, le=45.0)]
    """How the camera sits in the head: up."""
    roll_deg: Annotated[float, Field(ge=-180.0, le=180.0)]
    """How the camera sits in the head: clockwise, seen from behind it."""
    heading_offset_deg: Annotated[float, Field(ge=-180.0, le=180.0)] | None
    """Added to headings; null on a rig without a compass."""
    covariance_deg2: Matrix
    """Covariance of azimuth (camera and heading together), tilt and roll, square degrees."""

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
