"""Contact sheet of a bundle for a check in the field: its frames with the skylines found, and its readings."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from localizer.bundle import Bundle, Frame, frame_image
from localizer.os_errors import why_not_written
from localizer.skyline.find import CONFIDENT, ColumnState, Skyline
from localizer.skyline.upright import Upright, frame_skyline, upright
from rig.atomic import write_atomically
from rig.bundle.summary import bundle_summary, times_text
from rig.errors import RigError

Image = NDArray[np.uint8]

TILE_WIDTH = 640
COLUMNS = 2
LINE_HEIGHT = 24
FAULTS_SHOWN = 3
JPEG_QUALITY = 88
SURE_BGR, UNSURE_BGR = (60, 20, 255), (0, 200, 255)
PAPER_BGR, INK_BGR, ALERT_BGR = (32, 28, 26), (235, 235, 235), (90, 150, 255)


class PreviewError(RigError):
    """The picture cannot be written."""


def write_preview(path: Path, bundle: Bundle, title: str) -> None:
    """Write the contact sheet as JPEG or PNG, by the name's end."""
    suffix = path.suffix.lower()
    if suffix not in (".jpg", ".jpeg", ".png"):
        raise PreviewError(f"{path}: no picture format; name it .jpg or .png")
    options = [] if suffix == ".png" else [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]
    try:
        write_atomically(path, cv2.imencode(suffix, contact_sheet(bundle, title), options)[1].tobytes())
    except OSError as error:
        raise PreviewError(f"{path}: {why_not_written(error)}") from error


def contact_sheet(bundle: Bundle, title: str) -> Image:
    """BGR image: a header, then the frames in two columns, each with a line of text below."""
    tiles = [_tile(bundle, frame) for frame in bundle.frames]
    columns = min(COLUMNS, len(tiles))
    while len(tiles) % columns:
        tiles.append(np.full_like(tiles[0], PAPER_BGR))
    rows = [np.hstack(tiles[i : i + columns]) for i in range(0, len(tiles), columns)]
    return np.vstack([_header(bundle, title, rows[0].shape[1]), *rows])


def _tile(bundle: Bundle, frame: Frame) -> Image:
    image = frame_image(bundle, frame)
    skyline = frame_skyline(bundle, frame)
    turned = upright(bundle.camera, frame.roll_deg)
    scale = TILE_WIDTH / image.shape[1]
    size = TILE_WIDTH, round(image.shape[0] * scale)
    shrinks = scale < 1.0
    small = np.asarray(
        cv2.resize(image, size, interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR), np.uint8
    )
    _draw(small, skyline, turned, scale)
    confident = (skyline.state == ColumnState.OK) & (skyline.confidence >= CONFIDENT)
    share = float(np.mean(confident))
    seen = f"skyline {share:.0%}" if share else "NO SKYLINE"
    text = (
        f"{frame.label}  az {frame.azimuth_deg:.2f}  tilt {frame.tilt_deg:+.2f}  roll {frame.roll_deg:+.2f} deg  "
        f"{seen}  {frame.time:%H:%M:%S}Z"
    )
    return np.vstack([small, _lines([text], TILE_WIDTH, INK_BGR if share else ALERT_BGR)])


def _draw(image: Image, skyline: Skyline, turned: Upright, scale: float) -> None:
    """Draw the skyline over a picture scaled by ``scale``: confident columns in one colour, the rest in another."""
    sure = (skyline.state == ColumnState.OK) & (skyline.confidence >= CONFIDENT)
    seen = np.isfinite(skyline.row_px)
    for which, colour in ((seen & ~sure, UNSURE_BGR), (sure, SURE_BGR)):
        columns = np.flatnonzero(which)
        for run in np.split(columns, np.flatnonzero(np.diff(columns) > 1) + 1):
            if len(run):
                on_picture = turned.as_recorded(run.astype(float), skyline.row_px[run])
                points = (np.column_stack(on_picture) + 0.5) * scale - 0.5
                cv2.polylines(
                    image, [np.rint(points * 16).astype(np.int32)], False, colour, 1, cv2.LINE_AA, shift=4
                )


def _header(bundle: Bundle, title: str, width: int) -> Image:
    found = bundle_summary(bundle)
    known = found["readings"]
    altitude = "no altimeter"
    if bundle.altitude:
        altitude = f"altitude {bundle.altitude.value_m:.1f} +- {bundle.altitude.sigma_m:.1f} m"
    stands = [
        f"{name} {known[key]:.2f}"
        for name, key in (("heading", "heading_deg"), ("pitch", "pitch_deg"), ("roll", "roll_deg"))
        if key in known
    ]
    biases = f"sigmas in common: azimuth {bundle.azimuth_bias_sigma_deg:.2f}, tilt {bundle.tilt_bias_sigma_deg:.3f} deg"
    first = f"{title}  {bundle.id}  {found['rig'] or ''}"
    header = _lines([first, f"{altitude}   {'  '.join(stands)}", biases], width, INK_BGR)
    faults = [
        f"overcome {times_text(fault['count'])}: {str(fault['device']).split(' on ')[0]}: {fault['problem']}"
        for fault in found["faults"][:FAULTS_SHOWN]
    ]
    more = len(found["faults"]) - len(faults)
    if more:
        faults.append(f"and {more} more kinds of faults")
    return np.vstack([header, _lines(faults, width, ALERT_BGR)]) if faults else header


def _lines(lines: Sequence[str], width: int, colour: tuple[int, int, int]) -> Image:
    strip = np.full((LINE_HEIGHT * len(lines) + 8, width, 3), PAPER_BGR, np.uint8)
    for number, line in enumerate(lines, 1):
        place = 8, LINE_HEIGHT * number - 3
        cv2.putText(strip, line, place, cv2.FONT_HERSHEY_SIMPLEX, 0.5, colour, 1, cv2.LINE_AA)
    return strip
