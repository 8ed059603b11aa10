"""Skylines that mislead: terrain of two colours under a sky between them, a ridge as pale as the clouds."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from localizer.skyline.find import CONFIDENT, ColumnState, Skyline, find_skyline

WIDTH, HEIGHT = 900, 600
COLUMNS = np.arange(WIDTH)


def used(skyline: Skyline) -> np.ndarray:
    return (skyline.confidence >= CONFIDENT) & (skyline.state == ColumnState.OK)


def below(edge: np.ndarray) -> np.ndarray:
    """How much of each pixel lies below an edge (WIDTH,); (HEIGHT, WIDTH, 1)."""
    return np.clip(np.arange(HEIGHT)[:, None] + 0.5 - edge[None, :], 0.0, 1.0)[..., None]


def noisy(image: np.ndarray, seed: int) -> np.ndarray:
    noise = np.random.default_rng(seed).normal(0.0, 2.0, image.shape)
    return np.clip(cv2.GaussianBlur(image, (0, 0), 0.7) + noise, 0, 255).round().astype(np.uint8)


def smooth_noise(seed: int, sigma: tuple[float, float]) -> np.ndarray:
    rough = np.random.default_rng(seed).normal(0.0, 1.0, (HEIGHT, WIDTH))
    smooth = cv2.GaussianBlur(rough, (0, 0), sigmaX=sigma[0], sigmaY=sigma[1])
    return smooth / smooth.std()


def test_snow_and_rock_under_a_sky_of_a_brightness_between_them():
    edge = 210.0 + 30.0 * np.sin(COLUMNS / 140.0) + 6.0 * np.sin(COLUMNS / 17.0) + 3.0 * np.sin(COLUMNS / 5.0)
    sky = np.array([150.0, 130.0, 110.0]) + 15.0 * np.arange(HEIGHT)[:, None, None] / HEIGHT
    snow = (smooth_noise(3, (9.0, 5.0)) > -0.1)[..., None]
    terrain = np.where(snow, np.array([190.0, 190.0, 188.0]), np.array([75.0, 72.0, 70.0]))
    skyline = find_skyline(noisy(sky + (terrain - sky) * below(edge), 7))
    error = np.abs(skyline.row_px - edge)[used(skyline)]
    assert used(skyline).mean() > 0.6
    assert np.median(error) < 0.5
    assert np.percentile(error, 95) < 2.0


def scene() -> tuple[np.ndarray, np.ndarray]:
    """A clear ridge and its picture."""
    edge = 250.0 + 40.0 * np.sin(COLUMNS / 110.0)
    sky = np.array([230.0, 190.0, 150.0]) + 10.0 * np.arange(HEIGHT)[:, None, None] / HEIGHT
    grain = 8.0 * smooth_noise(2, (2.0, 2.0))[..., None]
    return edge, noisy(sky + (np.array([60.0, 90.0, 80.0]) + grain - sky) * below(edge), 4)


@pytest.mark.parametrize("paper", [(238, 242, 245), (8, 6, 9)])
def test_the_border_of_a_scanned_picture_is_no_sky(paper):
    edge, image = scene()
    framed = cv2.copyMakeBorder(image, 30, 40, 50, 60, cv2.BORDER_CONSTANT, value=paper)
    grain = np.random.default_rng(6).normal(0.0, 4.0, framed.shape)
    skyline = find_skyline(np.clip(framed + grain, 0, 255).round().astype(np.uint8))
    inside = slice(55, 50 + WIDTH - 5)
    assert used(skyline)[inside].mean() > 0.9
    error = skyline.row_px[inside] - (edge[5:-5] + 30.0)
    assert np.percentile(np.abs(error[used(skyline)[inside]]), 95) < 1.5
    assert not used(skyline)[:45].any()
    assert not used(skyline)[-55:].any()


def test_a_sky_that_is_white_all_over_is_no_border():
    edge, image = scene()
    image[below(edge)[..., 0] == 0.0] = 255
    skyline = find_skyline(image)
    assert used(skyline).mean() > 0.9
    assert np.median(np.abs(skyline.row_px - edge)[used(skyline)]) < 0.7


def test_a_ridge_as_pale_as_the_clouds_in_the_glare_makes_the_nearer_one_uncertain(skyfix_data: Path):
    folder = skyfix_data / "rendered" / "bt_backlight"
    terrain = np.array(json.loads((folder / "truth.json").read_text())["images"]["W"]["terrain_row"], float)
    skyline = find_skyline(cv2.imread(str(folder / "bundle" / "frames" / "W.png")))
    far_off = np.abs(skyline.row_px - terrain) > 6.0
    assert far_off.mean() > 0.15  # the nearer ridge is taken, ...
    assert (far_off & used(skyline)).mean() < 0.05  # ... but not claimed
    assert used(skyline).mean() > 0.6


def test_a_faint_ridge_behind_the_sharp_one_makes_it_uncertain():
    edge, image = scene()
    far = np.minimum(edge, 190.0 + 30.0 * np.sin(COLUMNS / 170.0 + 2.0) + 4.0 * np.sin(COLUMNS / 13.0))
    behind = below(far) * (1.0 - below(edge))
    sky = image.astype(float)
    paler = cv2.GaussianBlur(behind, (0, 0), 0.7)[..., None] * 10.0
    skyline = find_skyline(np.clip(sky - paler, 0, 255).round().astype(np.uint8))
    assert (used(skyline) & (np.abs(skyline.row_px - far) > 10.0)).mean() < 0.03
    assert used(find_skyline(image)).mean() > 0.9, "the ridge alone is not in doubt"


def test_a_pale_ridge_under_a_streaky_sky_makes_the_sharp_one_uncertain():
    edge, image = scene()
    far = edge - np.where(COLUMNS < 520, 60.0 * np.sin(np.pi * COLUMNS / 520.0), 0.0)
    streaks = np.clip(smooth_noise(8, (60.0, 3.0)), 0.0, 1.0)[..., None] * (1.0 - below(far - 6.0))
    behind = cv2.GaussianBlur(below(far) * (1.0 - below(edge)), (0, 0), 0.7)[..., None]
    pale = image + (250.0 - image) * 0.8 * streaks - 22.0 * behind
    skyline = find_skyline(np.clip(pale, 0, 255).round().astype(np.uint8))
    assert (used(skyline) & (np.abs(skyline.row_px - far) > 10.0)).mean() < 0.02


def test_where_a_faint_ridge_meets_the_sharp_one_neither_is_claimed():
    edge, image = scene()
    far = edge - np.maximum(0.0, 60.0 - COLUMNS / 7.5)  # they meet in the middle, at a low angle
    behind = cv2.GaussianBlur(below(far) * (1.0 - below(edge)), (0, 0), 0.7)[..., None]
    skyline = find_skyline(np.clip(image - 10.0 * behind, 0, 255).round().astype(np.uint8))
    assert not used(skyline)[:300].any()
    assert (used(skyline) & (np.abs(skyline.row_px - far) > 2.0)).mean() < 0.02
    assert used(skyline)[600:].all()


def test_the_rim_of_the_sun_s_glare_is_no_skyline():
    edge, image = scene()
    distance = np.hypot(COLUMNS - 450.0, np.arange(HEIGHT)[:, None] - 260.0)[..., None]
    glare = 900.0 * np.exp(-((distance / 50.0) ** 2)) + 60.0 * np.exp(-distance / 80.0)
    skyline = find_skyline(np.clip(image + glare, 0, 255).round().astype(np.uint8))
    assert np.percentile(np.abs(skyline.row_px - edge)[used(skyline)], 98) < 5.0
    assert used(skyline).mean() > 0.5


def test_the_top_of_a_cloud_that_lies_on_a_hazy_ridge_is_no_skyline():
    edge = 300.0 + 25.0 * np.sin(COLUMNS / 110.0)
    cloud = 220.0 + 15.0 * np.sin(COLUMNS / 40.0)
    blue, white = np.array([200.0, 140.0, 90.0]), np.array([250.0, 246.0, 243.0])
    depth = np.clip((np.arange(HEIGHT)[:, None] - edge) / 200.0, 0.0, 1.0)[..., None]
    hazy = white - (white - np.array([60.0, 90.0, 80.0])) * (0.1 + 0.9 * depth)
    picture = blue + (white - blue) * below(cloud)
    skyline = find_skyline(noisy(picture + (hazy - picture) * below(edge), 5))
    assert (used(skyline) & (np.abs(skyline.row_px - cloud) < 10.0)).mean() < 0.03
