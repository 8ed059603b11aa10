"""Degrades pictures with a known skyline: weather, light, lens and camera; the truth is changed alike."""

from collections.abc import Callable, Iterator, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from sim.evaluate.photos.traced_pictures import TUNED_ON, TracedPicture

Floats = NDArray[np.float64]
Degradation = Callable[[Floats, Floats, np.random.Generator], tuple[Floats, Floats]]
"""Maps a picture (h, w, 3), 0..255, and its true rows (w,) to degraded ones."""

EVERY = 3
"""Every n-th of the pictures used for tuning is degraded: they are similar in this respect."""
SKY_ROWS = 12
ROLL_DEG = 12.0
MARGIN = 0.05


def degraded_pictures(pictures: Sequence[TracedPicture]) -> Iterator[tuple[str, TracedPicture]]:
    """Each change by name, with each picture that it is made to."""
    chosen = [picture for picture in pictures if picture.half == TUNED_ON][::EVERY]
    for name, spoil in DEGRADATIONS.items():
        for number, picture in enumerate(chosen):
            image, row = spoil(
                picture.image_bgr.astype(float), picture.true_row_px.copy(), np.random.default_rng(number)
            )
            degraded = np.clip(image, 0.0, 255.0).round().astype(np.uint8)
            yield name, TracedPicture(picture.dataset, picture.name, picture.half, degraded, row)


def _as_it_is(image: Floats, row: Floats, rng: np.random.Generator) -> tuple[Floats, Floats]:
    return image, row


def _haze(image: Floats, row: Floats, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Haze: three quarters of the light at the skyline is air light, less below it."""
    share = 0.75 * np.exp(-_below(image, row) / (0.15 * len(image))) * (_below(image, row) > 0.0)
    return image + np.nan_to_num(share)[..., None] * (_sky_colour(image, row) - image), row


def _far_ridge(darker: float) -> Degradation:
    def spoil(image: Floats, row: Floats, rng: np.random.Generator) -> tuple[Floats, Floats]:
        """A farther ridge behind half of the skyline, darker than the sky by that share."""
        h, w = image.shape[:2]
        u = np.arange(w) / w
        start = float(rng.uniform(0.0, 0.5))
        rise = (
            0.12 * h * np.sin(np.pi * np.clip((u - start) / 0.5, 0.0, 1.0)) * (1.0 + 0.1 * np.sin(40.0 * u))
        )
        far = np.maximum(row - rise, 0.0)
        # Slightly into the nearer ridge: its blurred edge contains sky light.
        ridge = np.clip(_below(image, far), 0.0, 1.0) * np.clip(2.0 - _below(image, row), 0.0, 1.0)
        return image * (1.0 - darker * np.nan_to_num(ridge)[..., None]), far

    return spoil


def _cloud(image: Floats, row: Floats, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """A white cloud lies on a part of the ridge, where the truth is then unknown."""
    h, w = image.shape[:2]
    column = float(rng.uniform(0.2, 0.8)) * w
    middle = float(np.nanmedian(row))
    y, x = np.mgrid[0:h, 0:w]
    ragged = cv2.GaussianBlur(rng.normal(0.0, 1.0, (h, w)), (0, 0), w / 60.0)
    size = np.hypot((x - column) / (0.16 * w), (y - middle) / (0.1 * h)) + 0.15 * ragged / ragged.std()
    share = np.clip((1.2 - size) / 0.25, 0.0, 1.0)
    covered = share[np.clip(np.nan_to_num(row), 0, h - 1).astype(int), np.arange(w)] > 0.02
    return image + share[..., None] * (245.0 - image), np.where(covered, np.nan, row)


def _sun(image: Floats, row: Floats, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """The sun behind the ridge overexposes a part of it."""
    h, w = image.shape[:2]
    y, x = np.mgrid[0:h, 0:w]
    away = np.hypot(x - float(rng.uniform(0.2, 0.8)) * w, y - float(np.nanmedian(row)) + 0.05 * h) / w
    return image + (900.0 * np.exp(-((away / 0.06) ** 2)) + 60.0 * np.exp(-away / 0.1))[..., None], row


def _dusk(image: Floats, row: Floats, rng: np.random.Generator) -> tuple[Floats, Floats]:
    return 0.15 * image + rng.normal(0.0, 2.0, image.shape), row


def _low_contrast(image: Floats, row: Floats, rng: np.random.Generator) -> tuple[Floats, Floats]:
    return 128.0 + 0.3 * (image - 128.0), row


def _vignette(image: Floats, row: Floats, rng: np.random.Generator) -> tuple[Floats, Floats]:
    h, w = image.shape[:2]
    y, x = np.mgrid[0:h, 0:w]
    corner = np.hypot(x - w / 2.0, y - h / 2.0) / np.hypot(w / 2.0, h / 2.0)
    return image * (1.0 - 0.6 * corner**2)[..., None], row


def _rolled(image: Floats, row: Floats, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """The camera is rolled; empty corners are cropped."""
    h, w = image.shape[:2]
    turn = cv2.getRotationMatrix2D((w / 2.0, h / 2.0), ROLL_DEG * float(rng.choice([-1.0, 1.0])), 1.0)
    turned = np.asarray(cv2.warpAffine(image, turn, (w, h)), np.float64)
    points = turn @ np.vstack([np.arange(w), row, np.ones(w)])
    order = np.argsort(points[0])
    moved = np.interp(np.arange(w), points[0, order], points[1, order], left=np.nan, right=np.nan)
    slant = np.tan(np.radians(ROLL_DEG)) / 2.0
    top, left = int(slant * w) + 1, int(slant * h) + 1
    return turned[top : h - top, left : w - left], (moved - top)[left : w - left]


def _jpeg(image: Floats, row: Floats, rng: np.random.Generator) -> tuple[Floats, Floats]:
    packed = cv2.imencode(".jpg", image.astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, 15])[1]
    return np.asarray(cv2.imdecode(packed, cv2.IMREAD_COLOR), np.float64), row


def _noise(image: Floats, row: Floats, rng: np.random.Generator) -> tuple[Floats, Floats]:
    return image + rng.normal(0.0, 15.0, image.shape), row


def _out_of_focus(image: Floats, row: Floats, rng: np.random.Generator) -> tuple[Floats, Floats]:
    return np.asarray(cv2.GaussianBlur(image, (0, 0), 2.5), np.float64), row


def _masts(image: Floats, row: Floats, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Two dark poles stand before the ridge, where the truth is then unknown."""
    w = image.shape[1]
    for middle in rng.uniform(0.1, 0.9, 2) * w:
        pole = slice(int(middle - 0.006 * w), int(middle + 0.006 * w) + 1)
        image[:, pole], row[pole] = 40.0, np.nan
    return image, row


def _mostly_sky(image: Floats, row: Floats, rng: np.random.Generator) -> tuple[Floats, Floats]:
    lowest = int(np.nanmax(row) + MARGIN * len(image))
    return image[:lowest], row


def _mostly_ground(image: Floats, row: Floats, rng: np.random.Generator) -> tuple[Floats, Floats]:
    highest = max(0, int(np.nanmin(row) - MARGIN * len(image)))
    return image[highest:], row - highest


def _below(image: Floats, row: Floats) -> Floats:
    """Distance of each pixel (h, w) below a line (w,), NaN where the line is unknown."""
    return np.asarray(np.arange(len(image))[:, None] + 0.5 - row[None, :])


def _sky_colour(image: Floats, row: Floats) -> Floats:
    """Sky colour just above the skyline, (w, 3); the mean where the skyline is unknown or at the upper edge."""
    h, w = image.shape[:2]
    at = np.clip(np.nan_to_num(row) - SKY_ROWS, 0, h - 1).astype(int)
    colour = image[at, np.arange(w)]
    unknown = ~(row > SKY_ROWS)
    colour[unknown] = colour[~unknown].mean(axis=0)
    return np.asarray(cv2.blur(colour[None], (w // 20 * 2 + 1, 1))[0])


DEGRADATIONS: dict[str, Degradation] = {
    "none": _as_it_is,
    "haze that thickens towards the skyline, to 75 %": _haze,
    "far ridge behind, 35 % darker than the sky": _far_ridge(0.35),
    "the same, 20 %": _far_ridge(0.2),
    "cloud that lies on the ridge": _cloud,
    "sun that burns out a part of the ridge": _sun,
    "dusk": _dusk,
    "low contrast": _low_contrast,
    "vignette": _vignette,
    "rolled by 12 deg": _rolled,
    "JPEG at 15 %": _jpeg,
    "noise of 15 grey levels": _noise,
    "out of focus by 2.5 px": _out_of_focus,
    "masts": _masts,
    "mostly sky": _mostly_sky,
    "mostly ground": _mostly_ground,
}
