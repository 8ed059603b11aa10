"""The measurement bundle, ``skyfix.bundle/1``: its model, and a reader that refuses what it cannot vouch for.

The model belongs to its reader; whoever writes bundles constructs it and stores ``Bundle.to_json()``.
"""

import hashlib
import json
from datetime import UTC, datetime
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, Literal, Self, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    PrivateAttr,
    ValidationError,
    model_validator,
)

from localizer.errors import SkyfixError

FILE_NAME = "bundle.json"


class BundleError(SkyfixError):
    """A bundle that cannot be used; names the file and the field."""


def _utc(time: datetime) -> datetime:
    if time.tzinfo is None or time.utcoffset() != UTC.utcoffset(None):
        raise ValueError("should be UTC, ISO 8601 with a Z")
    return time.astimezone(UTC)


def _inside(file: str) -> str:
    path = PurePosixPath(file)
    if path.is_absolute() or ".." in path.parts or "\\" in file or ":" in file or not path.parts:
        raise ValueError("should be a path inside the bundle, relative to it")
    return file


UtcTime: TypeAlias = Annotated[datetime, AfterValidator(_utc)]
PixelCount: TypeAlias = Annotated[int, Field(gt=0, le=32768)]
FocalLength: TypeAlias = Annotated[float, Field(gt=0.0, le=1e6)]
Azimuth: TypeAlias = Annotated[float, Field(ge=0.0, lt=360.0)]
AngleSigma: TypeAlias = Annotated[float, Field(ge=0.0, le=180.0)]
Elevation: TypeAlias = Annotated[float, Field(ge=-500.0, le=9000.0)]


class _Part(BaseModel):
    """Immutable, finite numbers only; unknown fields are kept (raw readings, calibration)."""

    model_config = ConfigDict(frozen=True, extra="allow", allow_inf_nan=False)


class Camera(_Part):
    """Intrinsics as OpenCV has them; pixel centres at whole numbers."""

    width_px: PixelCount
    height_px: PixelCount
    fx_px: FocalLength
    fy_px: FocalLength
    cx_px: float
    cy_px: float
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    """k1, k2, p1, p2, k3."""


class Altitude(_Part):
    """Altitude of the optical centre above the DEM's vertical datum."""

    value_m: Elevation
    sigma_m: Annotated[float, Field(ge=0.0, le=1e4)]


class Frame(_Part):
    """One picture and where the camera pointed. The sigmas are independent from frame to frame."""

    label: Annotated[str, Field(min_length=1, max_length=64)]
    file: Annotated[str, AfterValidator(_inside)]
    """Path of the picture relative to the bundle's directory."""
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
    time: UtcTime
    azimuth_deg: Azimuth
    azimuth_sigma_deg: AngleSigma
    tilt_deg: Annotated[float, Field(ge=-90.0, le=90.0)]
    tilt_sigma_deg: AngleSigma
    roll_deg: Annotated[float, Field(ge=-180.0, le=180.0)]
    roll_sigma_deg: AngleSigma


class Prior(_Part):
    """A rough place that is known beforehand; absent in the ordinary case."""

    lat_deg: Annotated[float, Field(ge=-90.0, le=90.0)]
    lon_deg: Annotated[float, Field(ge=-180.0, le=180.0)]
    radius_m: Annotated[float, Field(gt=0.0)]


class Bundle(_Part):
    """One measurement: the pictures that a rig took at one place, with calibrated readings."""

    schema_name: Literal["skyfix.bundle/1"] = Field(default="skyfix.bundle/1", alias="schema")
    id: Annotated[str, Field(min_length=1, max_length=128)]
    created: UtcTime
    camera: Camera
    mast_height_m: Annotated[float, Field(ge=0.0, le=1000.0)]
    altitude: Altitude | None
    """None: there was no altimeter."""
    azimuth_bias_sigma_deg: AngleSigma
    """Of the error common to all frames; 180: there was no compass."""
    tilt_bias_sigma_deg: AngleSigma
    frames: Annotated[tuple[Frame, ...], Field(min_length=1)]
    prior: Prior | None = None

    _directory: Path | None = PrivateAttr(default=None)

    @model_validator(mode="after")
    def _labels_differ(self) -> Self:
        labels = [frame.label for frame in self.frames]
        if len(set(labels)) < len(labels):
            raise ValueError(f"frames: every label should occur once, not {', '.join(labels)}")
        return self

    @property
    def directory(self) -> Path:
        """Where the bundle was loaded from. Raises ``BundleError`` for one that was only constructed."""
        if self._directory is None:
            raise BundleError(f"bundle {self.id}: it was not loaded from a directory, so it has no pictures")
        return self._directory

    def to_json(self) -> str:
        """What ``bundle.json`` holds, unknown fields included; ``prior`` is absent where there is none."""
        fields: dict[str, Any] = self.model_dump(mode="json", by_alias=True)
        if fields["prior"] is None:
            del fields["prior"]
        return json.dumps(fields, indent=2, allow_nan=False) + "\n"


def load_bundle(path: Path) -> Bundle:
    """Read the bundle in directory ``path`` and check all of it, the pictures included.

    Raises ``BundleError`` that names the file and the field.
    """
    path = Path(path)
    if not path.is_dir():
        what = "is not a directory" if path.exists() else "does not exist"
        raise BundleError(f"{path}: {what}; a bundle is a directory with a {FILE_NAME}")
    file = path / FILE_NAME
    try:
        text = file.read_bytes()
    except FileNotFoundError:
        raise BundleError(f"{path}: holds no {FILE_NAME}, so it is not a bundle") from None
    except OSError as error:
        raise BundleError(f"{file}: {error.strerror}") from None
    bundle = _parse(text, file)
    bundle._directory = path
    for frame in bundle.frames:
        frame_image(bundle, frame)
    return bundle


def frame_image(bundle: Bundle, frame: Frame) -> NDArray[np.uint8]:
    """The picture of ``frame``: BGR, (height_px, width_px, 3), exactly as stored.

    Raises ``BundleError`` if the file is missing, leads outside the bundle, differs from its checksum, is no
    picture or has another size than the camera.
    """
    place = f"{bundle.directory / FILE_NAME}: frames[{frame.label}]"
    file = bundle.directory / frame.file
    # a symbolic link can lead outside although the path itself does not
    if not file.resolve().is_relative_to(bundle.directory.resolve()):
        raise BundleError(f"{place}.file: {frame.file} leads outside the bundle")
    try:
        content = file.read_bytes()
    except FileNotFoundError:
        raise BundleError(f"{place}.file: {frame.file} is missing; the bundle is incomplete") from None
    except OSError as error:
        raise BundleError(f"{place}.file: {frame.file}: {error.strerror}") from None
    if hashlib.sha256(content).hexdigest() != frame.sha256:
        raise BundleError(f"{place}.sha256: {frame.file} has another checksum; it changed after the capture")
    # an orientation tag must not turn the picture: the intrinsics are those of the sensor
    flags = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
    image = cv2.imdecode(np.frombuffer(content, np.uint8), flags) if content else None
    if image is None:
        raise BundleError(f"{place}.file: {frame.file} is not a picture that can be read")
    camera = bundle.camera
    height_px, width_px = image.shape[:2]
    if (width_px, height_px) != (camera.width_px, camera.height_px):
        raise BundleError(
            f"{place}.file: {frame.file} is {width_px} x {height_px} px, "
            f"but camera.width_px x camera.height_px is {camera.width_px} x {camera.height_px}"
        )
    return np.asarray(image, np.uint8)


def sha256_of(path: Path) -> str:
    """SHA-256 of a file's content, 64 lower-case hexadecimal digits, as ``Frame.sha256`` has it."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _parse(text: bytes, file: Path) -> Bundle:
    try:
        bundle = Bundle.model_validate_json(text, strict=True)
    except ValidationError as error:
        raise BundleError(f"{file}: {_first_of(error)}") from None
    # has a default for whoever constructs a bundle, but a file must say what it is
    if "schema_name" not in bundle.model_fields_set:
        raise BundleError(f"{file}: schema: Field required")
    return bundle


def _first_of(error: ValidationError) -> str:
    """The first defect as ``frames[0].tilt_deg: what should be (got what is)``, and how many more."""
    first = error.errors(include_url=False)[0]
    field = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in first["loc"]).lstrip(".")
    message = first["msg"].removeprefix("Value error, ")
    given = first["input"]
    if isinstance(given, str | int | float | bool | None) and first["type"] != "missing":
        message += f" (got {given!r})"
    more = f" (and {error.error_count() - 1} more)" if error.error_count() > 1 else ""
    return f"{field}: {message}{more}" if field else f"{message}{more}"
