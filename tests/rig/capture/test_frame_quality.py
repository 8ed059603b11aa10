"""Stale, frozen and empty pictures."""

import cv2
import numpy as np
import pytest

from localizer.skyline.find import ColumnState, Skyline
from rig.capture.pictures.quality import Image, Seen, blur, defect, edge_width_px, thumbnail

WIDTH, HEIGHT = 320, 240


def hills(phase: float = 0.0, noise: int = 1) -> Image:
    rows, columns = np.mgrid[0:HEIGHT, 0:WIDTH]
    sky = rows < ridge(phase)[columns]
    levels = np.where(sky, 190.0 - rows * 0.2, 70.0) + np.random.default_rng(noise).normal(
        0, 3, (HEIGHT, WIDTH)
    )
    return np.repeat(np.clip(levels, 0, 255).astype(np.uint8)[..., None], 3, axis=2)


def ridge(phase: float) -> np.ndarray:
    return 110.0 + 30.0 * np.sin(np.arange(WIDTH) / 30.0 + phase)


def skyline(phase: float = 0.0) -> Skyline:
    return Skyline(
        ridge(phase) - 0.5, np.full(WIDTH, 0.3), np.ones(WIDTH), np.full(WIDTH, ColumnState.OK, np.uint8)
    )


def flat(level: int) -> Image:
    return np.full((HEIGHT, WIDTH, 3), level, np.uint8)


SEEN = [Seen(0.0, 0.0, thumbnail(hills()))]


@pytest.mark.parametrize(
    ("frames", "problem"),
    [
        ([hills(1.0), hills(1.0, 2)], None),
        ([flat(0)] * 2, "is black"),
        ([flat(255)] * 2, "is all white"),
        ([hills(0.0, 5), hills(0.0, 6)], "has not changed although the head turned by 90 deg"),
        ([hills(), hills()], "has not changed although the head turned by 90 deg"),
        ([hills(1.0)] * 2, "has not changed in the least from frame to frame"),
        ([hills(3.0), hills(1.0)], "still changes although the head stands"),
        ([hills(1.0), np.asarray(hills(1.0) // 2)], "still changes although the head stands"),
        ([flat(90)] * 2, None),
    ],
    ids=["good", "black", "white", "old", "frozen", "frozen in motion", "moving", "exposure", "fog"],
)
def test_what_is_wrong_with_frames(frames: list[Image], problem: str | None) -> None:
    assert defect(frames, 90.0, 0.0, SEEN) == problem


def test_the_same_view_again_is_no_defect() -> None:
    assert defect([hills(), hills(0.0, 2)], 1.0, 0.5, SEEN) is None


@pytest.mark.parametrize("sigma_px", [0.0, 0.6, 1.2])
def test_a_sharp_skyline(sigma_px: float) -> None:
    image = np.asarray(cv2.GaussianBlur(hills(), (0, 0), sigma_px) if sigma_px else hills(), np.uint8)
    assert blur(image, skyline()) is None


def test_a_blurred_skyline() -> None:
    image = np.asarray(cv2.GaussianBlur(hills(), (0, 0), 5.0), np.uint8)
    assert edge_width_px(image, skyline()) > 2 * edge_width_px(hills(), skyline())
    said = blur(image, skyline())
    assert said is not None
    assert said.startswith("is blurred (the skyline is 1")


def test_without_a_skyline_nothing_is_said_about_blur() -> None:
    none = Skyline(
        np.full(WIDTH, np.nan),
        np.full(WIDTH, np.nan),
        np.zeros(WIDTH),
        np.full(WIDTH, ColumnState.NO_TERRAIN, np.uint8),
    )
    assert edge_width_px(hills(), none) == 0.0
