"""Where an edge lies in its column, and how sure that is: edges painted at known rows, with blur, noise and slopes."""

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from localizer.skyline.edge_position import Edge, refine_edge
from localizer.skyline.find import ColumnState, find_skyline

Floats = NDArray[np.float64]
WIDTH, HEIGHT = 640, 480
COLUMNS = np.arange(WIDTH)
SKY, TERRAIN = np.array([220.0, 200.0, 180.0]), np.array([60.0, 80.0, 70.0])
STRETCH = 80
"""Columns from one corner of a zigzag to the next."""


def zigzag(slope: float, column: Floats) -> Floats:
    """Rows of an edge that falls and rises by ``slope`` rows per column."""
    return 240.0 + slope * (np.abs(column % (2 * STRETCH) - STRETCH) - STRETCH / 2)


def photographed(slope: float, blur_px: float, noise: float, seed: int = 3) -> NDArray[np.uint8]:
    """A zigzag; pixels that the edge crosses have the share of the sky that is in them (of eight strips each).

    A lens blurs light; what is displayed goes by sRGB (IEC 61966-2-1). Without blur, display values are mixed.
    """
    strips = (np.arange(WIDTH * 8) + 0.5) / 8 - 0.5
    below = np.clip(np.arange(HEIGHT)[:, None] + 0.5 - zigzag(slope, strips), 0.0, 1.0)
    below = below.reshape(HEIGHT, WIDTH, 8).mean(axis=2)
    if blur_px == 0.0:
        image = SKY + (TERRAIN - SKY) * below[..., None]
    else:
        sky, terrain = (((colour / 255.0 + 0.055) / 1.055) ** 2.4 for colour in (SKY, TERRAIN))
        light = sky + (terrain - sky) * cv2.GaussianBlur(below, (0, 0), blur_px)[..., None]
        image = 255.0 * (1.055 * light ** (1.0 / 2.4) - 0.055)
    noisy = image + np.random.default_rng(seed).normal(0.0, noise, image.shape)
    return np.clip(noisy, 0, 255).round().astype(np.uint8)


def located(slope: float, blur_px: float, noise: float) -> tuple[Floats, Floats]:
    """Errors and sigmas of the columns away from the corners, when the rough boundary is right to within 0.7 rows."""
    truth = zigzag(slope, COLUMNS)
    rough = truth + np.random.default_rng(1).uniform(-0.7, 0.7, WIDTH)
    edge: Edge = refine_edge(photographed(slope, blur_px, noise), rough, 2.0)
    straight = np.abs((COLUMNS + STRETCH / 2) % STRETCH - STRETCH / 2) > 6
    assert (edge.contrast > 0.0)[straight].all(), "a step is fitted in each"
    return (edge.row_px - truth)[straight], edge.sigma_px[straight]


@pytest.mark.parametrize(
    ("slope", "blur_px", "noise"),
    [
        (0.2, 0.7, 20.0),
        (0.5, 1.2, 12.0),
        (0.5, 1.2, 20.0),
        (1.0, 0.7, 20.0),
        (1.0, 1.2, 20.0),
        (1.5, 0.7, 20.0),
    ],
)
def test_errors_are_as_large_as_their_sigmas_say(slope: float, blur_px: float, noise: float) -> None:
    error, sigma = located(slope, blur_px, noise)
    assert 0.7 < np.std(error / sigma) < 1.3
    assert abs(np.mean(error)) < 0.1


@pytest.mark.parametrize("slope", [0.0, 1.0, 2.0, 3.0])
def test_without_noise_a_tenth_of_a_pixel_across_the_edge_stays(slope: float) -> None:
    """Along the column that is longer: 0.1 px sqrt(1 + slope^2), 0.32 px where the edge rises by 3 rows per column."""
    error, sigma = located(slope, 0.0, 1.0)
    assert np.median(sigma) == pytest.approx(0.1 * np.hypot(1.0, slope), rel=0.05)
    assert np.abs(error).max() < 0.1


def test_columns_of_the_reduced_picture_are_those_of_the_full_one() -> None:
    """A cliff that begins with column 640, and so with column 160 of the picture reduced by four."""
    below = np.zeros((960, 1280, 1))
    below[480:] = 1.0
    below[:, 640:] = 1.0
    image = SKY + (TERRAIN - SKY) * below
    noisy = image + np.random.default_rng(2).normal(0.0, 2.0, image.shape)
    skyline = find_skyline(np.clip(noisy, 0, 255).round().astype(np.uint8))
    assert (skyline.state[:640] != ColumnState.NO_SKY).all()
    assert (skyline.state[640:] == ColumnState.NO_SKY).all()
    assert skyline.row_px[20:620] == pytest.approx(np.full(600, 479.5), abs=0.05)
