"""Pictures with a known skyline: traced by hand, or computed by their renderer."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from sim.errors import SimulationError
from sim.evaluate.photos.conversions import trace_rows_px
from sim.evaluate.photos.source import Image, existing, read_image, read_json

Floats = NDArray[np.float64]

TUNED_ON, HELD_OUT = "tuned on", "held out"


@dataclass(frozen=True)
class TracedPicture:
    """``true_row_px``: (width,) the terrain's skyline, pixel centres at whole numbers; NaN where unknown."""

    dataset: str
    name: str
    half: str
    image_bgr: Image
    true_row_px: Floats


def traced_pictures(data_dir: Path) -> Iterator[TracedPicture]:
    """All of them, one at a time. Raises SimulationError for what is missing."""
    yield from hand_traced(data_dir)
    yield from columbia_traced(data_dir)
    yield from rendered_traced(data_dir)


def hand_traced(data_dir: Path) -> Iterator[TracedPicture]:
    """Photographs from many places with a mask that is 255 on the skyline's pixels; every second one is held out."""
    folder = existing(data_dir / "local-only" / "skylines")
    masks = sorted(folder.glob("*_skyline.png"))
    if not masks:
        raise SimulationError(f"{folder}: holds no *_skyline.png")
    for number, path in enumerate(masks):
        mask = cv2.cvtColor(read_image(path), cv2.COLOR_BGR2GRAY) > 127
        name = path.name.removesuffix("_skyline.png")
        row = np.where(mask.any(axis=0), mask.argmax(axis=0).astype(float), np.nan)
        yield TracedPicture("hand-traced", name, _half(number), read_image(folder / f"{name}.jpg"), row)


def columbia_traced(data_dir: Path) -> Iterator[TracedPicture]:
    """Time-lapse photographs. The halves are split by station, as a station's pictures show the same ridge."""
    folder = existing(data_dir / "local-only" / "columbia")
    for photo in read_json(folder / "truth.json")["photos"]:
        image = read_image(folder / photo["photo"])
        name = Path(photo["photo"]).stem[:19]
        half = TUNED_ON if name.startswith("AK01") else HELD_OUT
        yield TracedPicture("columbia", name, half, image, trace_rows_px(photo["horizon_px"], image.shape[1]))


def rendered_traced(data_dir: Path) -> Iterator[TracedPicture]:
    """Rendered pictures; the truth is the terrain's skyline, excluding columns with trees and rocks."""
    for number, folder in enumerate(rendered_folders(data_dir)):
        for label, frame in read_json(folder / "truth.json")["images"].items():
            yield TracedPicture(
                "rendered",
                f"{folder.name} {label}",
                _half(number),
                read_image(folder / "bundle" / "frames" / f"{label}.png"),
                np.asarray(frame["terrain_row"], float),
            )


def rendered_folders(data_dir: Path) -> list[Path]:
    """The folders of the rendered bundles. Raises SimulationError if there are none."""
    folder = existing(data_dir / "rendered")
    found = sorted(path.parent for path in folder.glob("*/truth.json"))
    if not found:
        raise SimulationError(f"{folder}: holds no NAME/truth.json")
    return found


def _half(number: int) -> str:
    return HELD_OUT if number % 2 else TUNED_ON
