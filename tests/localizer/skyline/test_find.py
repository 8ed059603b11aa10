"""The skyline in a picture: sub-pixel where it is clear, silent where there is none."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from localizer.skyline.find import CONFIDENT, ColumnState, Skyline, find_skyline

WIDTH, HEIGHT = 640, 480
COLUMNS = np.arange(WIDTH)
RIDGE = 200.3 + 45.0 * np.sin(COLUMNS / 95.0) + 12.0 * np.sin(COLUMNS / 23.0)
NEAR = 300.0 + 30.0 * np.cos(COLUMNS / 70.0)
SKY, HAZY, GREEN = (230.0, 190.0, 150.0), (175.0, 160.0, 135.0), (50.0, 85.0, 70.0)


def paint(
    *layers: tuple[np.ndarray, tuple[float, float, float]], noise: float = 2.0, seed: int = 1
) -> np.ndarray:
    """A sky paler towards the horizon, and over it layers of (upper edge, colour), antialiased and textured."""
    rng = np.random.default_rng(seed)
    row = np.arange(HEIGHT)[:, None, None]
    image = np.array(SKY) + 20.0 * row / HEIGHT * np.ones((HEIGHT, WIDTH, 3))
    for edge, colour in layers:
        # A pixel is covered by what of it lies below the edge; pixel centres are at whole numbers.
        covered = np.clip(row[..., 0] + 0.5 - edge[None, :], 0.0, 1.0)[..., None]
        grain = cv2.GaussianBlur(rng.normal(0.0, 12.0, (HEIGHT, WIDTH)), (0, 0), 1.2)[..., None]
        image = image * (1.0 - covered) + (np.array(colour) + grain) * covered
    return np.clip(image + rng.normal(0.0, noise, image.shape), 0, 255).round().astype(np.uint8)


def used(skyline: Skyline) -> np.ndarray:
    return (skyline.confidence >= CONFIDENT) & (skyline.state == ColumnState.OK)


def test_a_clear_ridge_is_found_to_a_fraction_of_a_pixel():
    skyline = find_skyline(paint((RIDGE, GREEN)))
    error = (skyline.row_px - RIDGE)[used(skyline)]
    assert used(skyline).mean() > 0.95
    assert abs(np.median(error)) < 0.1
    assert np.percentile(np.abs(error), 95) < 0.6


def test_the_farthest_ridge_is_the_skyline_and_not_the_nearer_one_with_more_contrast():
    skyline = find_skyline(paint((RIDGE, HAZY), (NEAR, GREEN)))
    error = (skyline.row_px - np.minimum(RIDGE, NEAR))[used(skyline)]
    assert used(skyline).mean() > 0.8
    assert np.percentile(np.abs(error), 95) < 1.5


def test_clouds_are_no_skyline():
    image = paint((RIDGE, GREEN)).astype(float)
    rng = np.random.default_rng(3)
    cloud = cv2.GaussianBlur(rng.normal(0.0, 1.0, (HEIGHT, WIDTH)), (0, 0), 18.0)
    bright = np.clip((cloud / cloud.std() - 0.5) * 40.0, 0.0, 25.0)[..., None]
    above = (np.arange(HEIGHT)[:, None] < RIDGE[None, :] - 1.0)[..., None]
    skyline = find_skyline(np.clip(image + bright * above, 0, 255).astype(np.uint8))
    error = (skyline.row_px - RIDGE)[used(skyline)]
    assert used(skyline).mean() > 0.8
    assert np.percentile(np.abs(error), 95) < 1.5


@pytest.mark.parametrize("value", [0, 255])
def test_a_black_or_saturated_frame_has_no_confident_skyline(value):
    assert used(find_skyline(np.full((HEIGHT, WIDTH, 3), value, np.uint8))).mean() < 0.05


def test_bare_sky_and_bare_terrain_have_no_confident_skyline():
    assert used(find_skyline(paint())).mean() < 0.05
    assert used(find_skyline(paint((np.full(WIDTH, -10.0), GREEN)))).mean() < 0.05


def test_pure_noise_has_no_confident_skyline():
    noise = np.random.default_rng(5).integers(0, 256, (HEIGHT, WIDTH, 3)).astype(np.uint8)
    assert used(find_skyline(noise)).mean() < 0.1


def test_a_column_under_the_frames_edge_says_that_it_has_no_sky():
    rising = 250.0 - 0.6 * COLUMNS
    skyline = find_skyline(paint((rising, GREEN)))
    assert (skyline.state[rising < -20.0] == ColumnState.NO_SKY).mean() > 0.9
    assert np.isnan(skyline.row_px[skyline.state == ColumnState.NO_SKY]).all()


@pytest.mark.parametrize("size", [(1, 1), (15, 640), (480, 9)])
def test_a_picture_of_a_few_pixels_has_no_skyline(size):
    skyline = find_skyline(np.zeros((*size, 3), np.uint8))
    assert (skyline.state == ColumnState.NO_TERRAIN).all()
    assert skyline.row_px.shape == (size[1],)


@pytest.mark.parametrize("size", [(120, 160), (720, 1280), (519, 1388)])
def test_pictures_may_have_any_size(size):
    height, width = size
    image = cv2.resize(paint((RIDGE, GREEN)), (width, height), interpolation=cv2.INTER_AREA)
    skyline = find_skyline(image)
    assert skyline.row_px.shape == (width,)
    expected = (
        np.interp((np.arange(width) + 0.5) * WIDTH / width - 0.5, COLUMNS, RIDGE) + 0.5
    ) * height / HEIGHT - 0.5
    assert np.median(np.abs(skyline.row_px - expected)[used(skyline)]) < 0.5


def test_the_rendered_frames_are_traced(skyfix_data: Path):
    errors, shares = [], []
    for folder in sorted((skyfix_data / "rendered").iterdir()):
        truth = json.loads((folder / "truth.json").read_text())
        for label, frame in truth["images"].items():
            skyline = find_skyline(cv2.imread(str(folder / "bundle" / "frames" / f"{label}.png")))
            terrain = np.array(frame["terrain_row"], float)
            kept = used(skyline)
            shares.append(kept.mean())
            errors.append((skyline.row_px - terrain)[kept])
    size = np.abs(np.concatenate(errors))
    assert np.mean(shares) > 0.7  # trees and rocks stand before the rest
    assert np.nanmedian(size) < 0.5
    assert np.nanpercentile(size, 90) < 6.0


def test_the_photographs_are_traced_as_by_hand(skyfix_data: Path):
    """Median and 95th percentile over all confident columns, in px at a width of 1000 px."""
    errors, confident, columns = [], 0, 0
    for path in sorted((skyfix_data / "local-only" / "skylines").glob("*_skyline.png")):
        mask = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) > 127
        image = cv2.imread(str(path).replace("_skyline.png", ".jpg"))
        skyline = find_skyline(image)
        known = mask.any(axis=0)
        kept = known & used(skyline)
        errors.append((skyline.row_px - mask.argmax(axis=0))[kept] * 1000.0 / image.shape[1])
        confident += int(kept.sum())
        columns += int(known.sum())
    size = np.abs(np.concatenate(errors))
    assert confident > 0.7 * columns
    assert np.median(size) < 2.0
    assert np.percentile(size, 95) < 10.0
