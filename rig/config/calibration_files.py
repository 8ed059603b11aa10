"""Calibration files, ``skyfix.calibration/1``: what a calibration found, when, on what, and how well.

A calibration holds values for keys of the configuration, and replaces them. What it does not know stays as configured.
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

Kind = Literal["camera", "inclinometer", "compass", "altimeter", "boresight"]
CALIBRATION_ORDER: tuple[Kind, ...] = ("camera", "inclinometer", "compass", "altimeter", "boresight")
"""In which they are made, each with the ones before it in force."""

Triple = tuple[float, float, float]
Matrix = tuple[Triple, Triple, Triple]
Positive = Annotated[float, Field(gt=0.0)]
Values = dict[str, dict[str, Any]]
"""Sections of the configuration, and keys there."""


class CalibrationError(RigError):
    """A calibration is refused, or its file cannot be used; says why and what to do."""


class _Document(BaseModel):
    """What all calibrations have: who, when, with which device, on top of which others, and figures about the fit."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    schema_name: Literal["skyfix.calibration/1"] = Field(default="skyfix.calibration/1", alias="schema")
    id: Annotated[str, Field(min_length=1, max_length=128)]
    created: AwareDatetime
    rig: str
    device: str
    based_on: dict[str, str] = {}
    """Ids of the calibrations that were in force, by kind."""
    fit: dict[str, float | int | str | bool | list[float] | None] = {}

    def values(self) -> Values:
        """The keys of the configuration that are replaced."""
        raise NotImplementedError

    def made_for(self) -> Mapping[str, Mapping[str, Any] | None]:
        """What a configuration says of the devices that this is for: keys by section, None for a section that it has not."""
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
    """The accelerometer's errors and how it sits in the head (``rig.attitude.accelerometer``)."""

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
    """Of a roll, reading and what is left of the zero together; None leaves it as configured."""

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
    """Iron of the pan stage and of the vehicle: stage field = soft_iron @ field there + hard_iron_ut, likewise in the base."""

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
    """The air pressure at a known altitude, and how trust in it fades."""

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
    """How the camera sits in the head, and what headings lack: their sum was measured, so they go together.

    ``covariance_deg2`` is of azimuth (that sum), tilt and roll. The heading's part is None on a rig without a compass.
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
    """A calibration, the name of the file that it was read from, and that file's checksum."""

    document: Calibration
    file: str
    sha256: str

    def record(self) -> dict[str, Any]:
        """For the bundle: which one it was, and all that is in it."""
        return {
            "id": self.document.id,
            "created": self.document.created.isoformat().replace("+00:00", "Z"),
            "file": Path(self.file).name,
            "sha256": self.sha256,
            "content": self.document.model_dump(mode="json", by_alias=True),
        }


def new_id(kind: Kind, created: datetime) -> str:
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
