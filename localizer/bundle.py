"""The measurement bundle, ``skyfix.bundle/1``: its model, and a reader that refuses what it cannot vouch for.

The model belongs to its reader; whoever writes bundles constructs it and stores ``Bundle.to_json()``.
"""

import hashlib
import json
import math
import re
from datetime import UTC, datetime
from os import PathLike
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, Literal, Self, TypeAlias

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

from localizer.camera import invertible_share
from localizer.documents import DocumentError, json_text, read_file
from localizer.errors import SkyfixError
from localizer.os_errors import meant_instead, why_not_read
from localizer.picture import MOST_PIXELS, PictureError, decode_picture

FILE_NAME = "bundle.json"
MOST_BYTES = 8_000_000
"""Of ``bundle.json``; one that ``rig capture`` writes has some ten thousand."""
MOST_PICTURE_BYTES = 512_000_000
MOST_FRAMES = 1000
"""Most frames of a bundle: every reader decodes all of them."""
ID_PATTERN = "[0-9A-Za-z][0-9A-Za-z_.-]{0,127}"
"""Pattern of a bundle's id, which is also the name of its folder and of its folder in an archive."""
ALTITUDE_STEP = "altitude"
"""The first step of the search; the others bear the frames' labels."""


class BundleError(SkyfixError):
    """A bundle that cannot be used; names the file and the field."""


def _utc(time: datetime) -> datetime:
    if time.tzinfo is None or time.utcoffset() != UTC.utcoffset(None):
        raise ValueError("should be UTC, ISO 8601 with a Z")
    return time.astimezone(UTC)


def _printable(text: str) -> str:
    if not text.isprintable():
        raise ValueError("should have no control characters")
    return text


def is_bundle_id(text: str) -> bool:
    """Whether a text can be a bundle's id, and so the name of its folder."""
    return re.fullmatch(ID_PATTERN, text) is not None


def _bundle_id(text: str) -> str:
    if not is_bundle_id(text):
        raise ValueError("should be 1 to 128 characters of 0-9 A-Z a-z _ . -, the first no sign")
    return text


def _no_step(label: str) -> str:
    if label == ALTITUDE_STEP:
        raise ValueError(f"should not be {label!r}, which is what a step of the search is called")
    return label


def _inside(file: str) -> str:
    path = PurePosixPath(file)
    if path.is_absolute() or ".." in path.parts or "\\" in file or ":" in file or not path.parts:
        raise ValueError("should be a path inside the bundle, relative to it")
    return file


BundleId: TypeAlias = Annotated[
    str, AfterValidator(_bundle_id), Field(json_schema_extra={"pattern": f"^{ID_PATTERN}$"})
]
Label: TypeAlias = Annotated[
    str, Field(min_length=1, max_length=64), AfterValidator(_printable), AfterValidator(_no_step)
]
InsidePath: TypeAlias = Annotated[
    str, Field(max_length=1024), AfterValidator(_printable), AfterValidator(_inside)
]
UtcTime: TypeAlias = Annotated[
    datetime, AfterValidator(_utc), Field(json_schema_extra={"pattern": "(Z|[+]00:00)$"})
]
PixelCount: TypeAlias = Annotated[int, Field(gt=0, le=32768)]
NARROWEST_VIEW_DEG, WIDEST_VIEW_DEG = 0.2, 170.0
"""Range of the field of view for which a pinhole model with distortion is meaningful."""
PERSPECTIVE = "perspective"
"""The one camera model that is supported."""
LEAST_INVERTIBLE = 0.6
"""Least share of the image in which the lens model must be invertible; many are not in the corners."""
FocalLength: TypeAlias = Annotated[float, Field(gt=0.0, le=1e6)]
Distortion: TypeAlias = Annotated[float, Field(ge=-1e3, le=1e3)]
Azimuth: TypeAlias = Annotated[float, Field(ge=0.0, lt=360.0)]
AngleSigma: TypeAlias = Annotated[float, Field(ge=0.0, le=180.0)]
Elevation: TypeAlias = Annotated[float, Field(ge=-500.0, le=9000.0)]


class _Part(BaseModel):
    """Immutable, finite numbers only; unknown fields are kept (raw readings, calibration)."""

    model_config = ConfigDict(frozen=True, extra="allow", allow_inf_nan=False)


def _perspective(model: str) -> str:
    if model != PERSPECTIVE:
        raise ValueError(
            f"is not supported; only {PERSPECTIVE} is, with OpenCV's five coefficients k1, k2, p1, p2, k3"
        )
    return model


def _known_focal_length(sigma_fraction: float) -> float:
    if sigma_fraction != 0.0:
        raise ValueError("is not supported yet; should be 0 or absent: calibrate the camera's focal length")
    return sigma_fraction


class Camera(_Part):
    """A camera's intrinsics as OpenCV has them.

    Examples
    --------
    >>> import localizer
    >>> localizer.Camera(width_px=640, height_px=480, fx_px=492.8, fy_px=492.8, cx_px=319.5, cy_px=239.5).distortion
    (0.0, 0.0, 0.0, 0.0, 0.0)
    """

    width_px: PixelCount
    """Width of the pictures."""
    height_px: PixelCount
    """Height of the pictures."""
    fx_px: FocalLength
    """Focal length, in widths of a pixel."""
    fy_px: FocalLength
    """Focal length, in heights of a pixel."""
    cx_px: float
    """Column of the principal point."""
    cy_px: float
    """Row of the principal point."""
    distortion: tuple[Distortion, Distortion, Distortion, Distortion, Distortion] = (0.0, 0.0, 0.0, 0.0, 0.0)
    """OpenCV's k1, k2, p1, p2, k3."""
    model: Annotated[str, AfterValidator(_perspective), Field(json_schema_extra={"const": PERSPECTIVE})] = (
        PERSPECTIVE
    )
    """Camera model; no other is supported yet."""
    focal_sigma_fraction: Annotated[
        float, AfterValidator(_known_focal_length), Field(json_schema_extra={"const": 0.0})
    ] = 0.0
    """One standard deviation of both focal lengths together, relative to them; no other value is supported yet."""

    @model_validator(mode="after")
    def _is_a_camera(self) -> Self:
        width, height = self.width_px, self.height_px
        if width * height > MOST_PIXELS:
            raise ValueError(f"{width} x {height} px are more than {MOST_PIXELS // 1_000_000} megapixels")
        for size, focal, centre, axis in (
            (width, self.fx_px, self.cx_px, "x"),
            (height, self.fy_px, self.cy_px, "y"),
        ):
            view_deg = math.degrees(2.0 * math.atan(0.5 * size / focal))
            if not NARROWEST_VIEW_DEG <= view_deg <= WIDEST_VIEW_DEG:
                raise ValueError(
                    f"f{axis}_px {focal:g} on {size} px is a field of view of {view_deg:.3g} deg; "
                    f"should be {NARROWEST_VIEW_DEG:g} to {WIDEST_VIEW_DEG:g}"
                )
            if not -size <= centre <= 2 * size:
                raise ValueError(f"c{axis}_px {centre:g} is far outside a picture of {size} px")
        if invertible_share(self, width, height) < LEAST_INVERTIBLE:
            raise ValueError(f"distortion {self.distortion} folds most of the picture onto itself")
        return self


class Altitude(_Part):
    """Altitude of the optical centre above the DEM's vertical datum."""

    value_m: Elevation
    """The altitude."""
    sigma_m: Annotated[float, Field(ge=0.0, le=1e4)]
    """One standard deviation of it."""


class Frame(_Part):
    """One picture and where the camera pointed. The sigmas are independent from frame to frame."""

    label: Label
    """Name of the frame, unlike that of every other one: a direction such as N, or an azimuth."""
    file: InsidePath
    """Path of the picture relative to the bundle's directory."""
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
    """SHA-256 of the picture's file, hexadecimal."""
    time: UtcTime
    """When the picture was taken, UTC."""
    azimuth_deg: Azimuth
    """Of the optical axis, clockwise from true north."""
    azimuth_sigma_deg: AngleSigma
    """One standard deviation of the azimuth's error that no other frame shares."""
    tilt_deg: Annotated[float, Field(ge=-90.0, le=90.0)]
    """Angle of the optical axis above the horizontal; up is positive."""
    tilt_sigma_deg: AngleSigma
    """One standard deviation of the tilt's error that no other frame shares."""
    roll_deg: Annotated[float, Field(ge=-180.0, le=180.0)]
    """Turn of the camera about its optical axis; clockwise, seen from behind it, is positive."""
    roll_sigma_deg: AngleSigma
    """One standard deviation of the roll's error that no other frame shares."""


class Prior(_Part):
    """A circle within which the camera is known to be; absent in the ordinary case."""

    lat_deg: Annotated[float, Field(ge=-90.0, le=90.0)]
    """Latitude of the circle's centre, WGS84."""
    lon_deg: Annotated[float, Field(ge=-360.0, le=360.0)]
    """Longitude of the circle's centre, WGS84."""
    radius_m: Annotated[float, Field(gt=0.0)]
    """Only cells within this distance of the centre are searched."""


class Bundle(_Part):
    """One measurement: the pictures that a rig took at one place, with calibrated readings (``skyfix.bundle/1``).

    See Also
    --------
    load_bundle : Reads one.
    """

    schema_name: Literal["skyfix.bundle/1"] = Field(default="skyfix.bundle/1", alias="schema")
    """What the document is, and its version."""
    id: BundleId
    """The bundle's name, and that of its folder."""
    created: UtcTime
    """When the capture was complete, UTC."""
    camera: Camera
    """The camera that took all pictures of the bundle."""
    mast_height_m: Annotated[float, Field(ge=0.0, le=1000.0)]
    """Height of the optical centre above the ground."""
    altitude: Altitude | None
    """What the altimeter measured; null: there was none."""
    azimuth_bias_sigma_deg: AngleSigma
    """One standard deviation of the azimuth's error that all frames share; 180: there was no compass."""
    tilt_bias_sigma_deg: AngleSigma
    """One standard deviation of the tilt's error that all frames share."""
    frames: Annotated[tuple[Frame, ...], Field(min_length=1, max_length=MOST_FRAMES)]
    """The pictures."""
    prior: Prior | None = None
    """A circle that the place is known to lie in; absent in the ordinary case."""

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
        """What ``bundle.json`` holds, unknown fields included; ``prior`` is absent where there is none, what a camera
        does not say likewise.
        """
        fields: dict[str, Any] = self.model_dump(mode="json", by_alias=True)
        if fields["prior"] is None:
            del fields["prior"]
        for name in {"model", "focal_sigma_fraction"} - self.camera.model_fields_set:
            del fields["camera"][name]
        return json.dumps(fields, indent=2, allow_nan=False) + "\n"


def load_bundle(path: str | PathLike[str]) -> Bundle:
    """Read a bundle and check all of it, the pictures included.

    Parameters
    ----------
    path : path-like
        Its directory.

    Returns
    -------
    Bundle
        The measurement. The pictures stay on disk, see `frame_image`.

    Raises
    ------
    BundleError
        Something is missing, damaged or out of range; names the file and the field.

    Examples
    --------
    >>> bundle = localizer.load_bundle("bundles/first")
    >>> [frame.label for frame in bundle.frames]
    ['N', 'E', 'S', 'W']
    """
    path = Path(path)
    if not path.is_dir():
        what = "is not a directory" if path.exists() else "does not exist"
        meant = "" if path.exists() else meant_instead(path)
        if path.name == FILE_NAME and path.exists():
            meant = f"; name {path.parent}"
        elif path.name.endswith((".tar", ".tar.gz", ".tgz", ".zip")) and path.exists():
            meant = "; take it out of the archive first: rig bundle import"
        raise BundleError(f"{path}: {what}; a bundle is a directory with a {FILE_NAME}{meant}")
    file = path / FILE_NAME
    if file.exists() and not file.is_file():  # a pipe would be waited for
        raise BundleError(f"{file}: is not a file but a directory or a pipe, so {path} is not a bundle")
    try:
        text = read_file(file, MOST_BYTES)
    except DocumentError as error:
        raise BundleError(f"{file}: {error}") from None
    except FileNotFoundError:
        raise BundleError(f"{path}: holds no {FILE_NAME}, so it is not a bundle") from None
    except OSError as error:
        raise BundleError(f"{file}: {why_not_read(error)}") from None
    bundle = parse_bundle(text, str(file))
    bundle._directory = path
    for frame in {(frame.file, frame.sha256): frame for frame in bundle.frames}.values():
        frame_image(bundle, frame)  # once where a thousand frames name one picture
    return bundle


def frame_image(bundle: Bundle, frame: Frame) -> NDArray[np.uint8]:
    """Read the picture of a frame.

    Parameters
    ----------
    bundle : Bundle
        As `load_bundle` returned it.
    frame : Frame
        One of its frames.

    Returns
    -------
    ndarray of uint8, shape (height_px, width_px, 3)
        Blue, green, red, as recorded.

    Raises
    ------
    BundleError
        The file is missing, leads outside the bundle, differs from its checksum, is no picture, or has another size than the
        camera.

    Examples
    --------
    >>> bundle = localizer.load_bundle("bundles/first")
    >>> localizer.frame_image(bundle, bundle.frames[0]).shape
    (480, 640, 3)
    """
    place = f"{bundle.directory / FILE_NAME}: frames[{frame.label}]"
    content = _content(bundle.directory, frame.file, f"{place}.file")
    if hashlib.sha256(content).hexdigest() != frame.sha256:
        raise BundleError(f"{place}.sha256: {frame.file} has another checksum; it changed after the capture")
    quarter_turns = round(frame.roll_deg / 90.0) % 4
    try:
        return decode_picture(content, bundle.camera.width_px, bundle.camera.height_px, quarter_turns)
    except PictureError as error:
        raise BundleError(f"{place}.file: {frame.file} {error}") from None


def _content(directory: Path, name: str, place: str) -> bytes:
    """Content of a file of the bundle. ``place``: its name in error messages."""
    file = directory / name
    try:
        # a symbolic link can lead outside although the path itself does not
        if not file.resolve().is_relative_to(directory.resolve()):
            raise BundleError(f"{place}: {name} leads outside the bundle")
        if file.exists() and not file.is_file():  # a pipe would be waited for
            raise BundleError(f"{place}: {name} is not a file but a directory or a pipe")
        return read_file(file, MOST_PICTURE_BYTES)
    except DocumentError as error:
        raise BundleError(f"{place}: {name} {error}") from None
    except FileNotFoundError:
        raise BundleError(f"{place}: {name} is missing; the bundle is incomplete") from None
    except OSError as error:
        raise BundleError(f"{place}: {name}: {why_not_read(error)}") from None
    except RuntimeError:  # of a link that leads to itself
        raise BundleError(f"{place}: {name} is a link that leads nowhere") from None


def sha256_of(path: Path) -> str:
    """SHA-256 of a file's content, 64 lower-case hexadecimal digits, as ``Frame.sha256`` has it."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def parse_bundle(content: bytes, file: str) -> Bundle:
    """The bundle that a ``bundle.json`` describes, without its pictures. ``BundleError`` names ``file`` and the field."""
    try:
        bundle = Bundle.model_validate_json(json_text(content, MOST_BYTES), strict=True)
    except DocumentError as error:
        raise BundleError(f"{file}: {error}") from None
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
