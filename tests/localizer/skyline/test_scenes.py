"""The skyline in a picture: drawn scenes with a known edge, and pictures of the folder that SKYFIX_DATA names."""

import json
import math
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from localizer.skyline.find import CONFIDENT, ColumnState, Skyline, find_skyline

Floats = NDArray[np.float64]

WIDTH, HEIGHT = 320, 240
BLUE, HAZE, OVERCAST, WHITE = (0.55, 0.30, 0.16), (0.85, 0.75, 0.68), (0.45, 0.45, 0.45), (1.0, 1.0, 1.0)
FOREST, ROCK, SNOW, NIGHT = (0.02, 0.05, 0.03), (0.10, 0.12, 0.14), (0.80, 0.76, 0.74), (0.002, 0.002, 0.002)


def ridge(base: float, amplitude: float, seed: int, width: int = WIDTH) -> Floats:
    """A rugged line of rows, higher than `base` by up to about `amplitude`."""
    generator = np.random.default_rng(seed)
    x = np.arange(width) / width
    row = np.zeros(width)
    for octave in range(1, 6):
        row += np.sin(2 * np.pi * (x * 1.1 * 2**octave * 0.6 + generator.random())) * amplitude / 2**octave
    return base - row


def blue_sky(height: int = HEIGHT, width: int = WIDTH) -> Floats:
    """Linear light: blue above, paler towards the bottom."""
    t = (np.linspace(0, 1, height) ** 2)[:, None, None]
    return (1 - t) * np.array(BLUE) + t * np.array(HAZE) + np.zeros((height, width, 1))


def noise_texture(height: int, width: int, seed: int, size: float = 1.0) -> Floats:
    """Unit-variance noise, smooth over `size` pixels."""
    field = np.random.default_rng(seed).normal(size=(height, width))
    field = cv2.GaussianBlur(field, (0, 0), size) if size > 0 else field
    return np.asarray(field / field.std())


def clouds(light: Floats, seed: int, cover: float = 0.5) -> Floats:
    """White clouds with soft edges over a sky."""
    height, width = light.shape[:2]
    field = noise_texture(height, width, seed, 14) + 0.5 * noise_texture(height, width, seed + 1, 5)
    opacity = np.clip((field + 2 * cover - 1) / 0.8, 0, 0.9)[..., None]
    return (1 - opacity) * light + opacity * 0.95


def stand(
    light: Floats, row: Floats, colour: tuple[float, float, float], texture: float = 0.3, seed: int = 5
) -> Floats:
    """Terrain below `row`, pixels that the edge crosses mixed by area."""
    height, width = light.shape[:2]
    cover = np.clip(np.arange(height)[:, None] + 0.5 - row[None, :], 0, 1)[..., None]
    grain = np.exp(texture * noise_texture(height, width, seed, 0.8))[..., None]
    return (1 - cover) * light + cover * np.array(colour) * grain


def photograph(light: Floats, blur_px: float = 0.6, noise: float = 1.5, seed: int = 9) -> NDArray[np.uint8]:
    """What a camera makes of it: lens blur, saturation, display gamma, noise in grey levels."""
    light = np.clip(cv2.GaussianBlur(light, (0, 0), blur_px) if blur_px > 0 else light, 0, 1)
    display = 255 * np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    noisy = display + np.random.default_rng(seed).normal(size=light.shape) * noise
    return np.clip(np.round(noisy), 0, 255).astype(np.uint8)


def confident(skyline: Skyline) -> NDArray[np.bool_]:
    return skyline.confidence >= CONFIDENT


def error(skyline: Skyline, row: Floats) -> Floats:
    """Rows off, of the confident columns."""
    return np.asarray((skyline.row_px - row)[confident(skyline)])


def overcast(level: float = 0.45, mottle: float = 0.08) -> Floats:
    return level * (1 + mottle * noise_texture(HEIGHT, WIDTH, 4, 20))[..., None] * np.ones(3)


def sun(x_px: float, y_px: float) -> Floats:
    """Light of a sun that burns out the sky around it."""
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH]
    distance = np.hypot(x - x_px, y - y_px)
    return (3 * np.exp(-((distance / 50) ** 2)) + 0.5 * np.exp(-distance / 60))[..., None] * np.ones(3)


ROW = ridge(110, 25, 1)


def test_a_crisp_edge_is_found_to_a_fraction_of_a_pixel_with_an_honest_sigma() -> None:
    row = ridge(110, 12, 3)
    cover = np.clip(np.arange(HEIGHT)[:, None] + 0.5 - row, 0, 1)[..., None]
    display = (1 - cover) * np.array([220.0, 200.0, 180.0]) + cover * np.array([60.0, 80.0, 70.0])
    display += np.random.default_rng(0).normal(size=display.shape) * 2
    skyline = find_skyline(np.clip(np.round(display), 0, 255).astype(np.uint8))
    off = error(skyline, row)
    assert off.size > 0.95 * WIDTH
    assert abs(off.mean()) < 0.02
    assert off.std() < 0.1
    assert np.all(skyline.sigma_px[confident(skyline)] < 0.3)


@pytest.mark.parametrize("colour", [FOREST, ROCK])
def test_lens_blur_mixes_light_and_does_not_shift_the_edge(colour: tuple[float, float, float]) -> None:
    row = ridge(110, 12, 3)
    off = error(find_skyline(photograph(stand(blue_sky(), row, colour, texture=0.05), blur_px=0.8)), row)
    assert off.size > 0.9 * WIDTH
    assert abs(np.median(off)) < 0.03
    assert off.std() < 0.1


def test_of_several_ridges_in_the_haze_the_topmost_is_the_skyline() -> None:
    far = ridge(95, 12, 2)
    light = stand(blue_sky(), far, (0.62, 0.53, 0.47), 0.02, 1)
    light = stand(light, ridge(120, 15, 3), (0.35, 0.30, 0.28), 0.05, 2)
    light = stand(light, ridge(150, 20, 4), (0.08, 0.09, 0.07), 0.3, 3)
    skyline = find_skyline(photograph(light))
    assert confident(skyline).mean() > 0.7
    assert np.percentile(np.abs(error(skyline, far)), 95) < 0.5


def scenes() -> dict[str, tuple[Floats, tuple[float, float, float], float]]:
    """Sky, colour of the terrain and its texture."""
    return {
        "few clouds": (clouds(blue_sky(), 10, 0.3), FOREST, 0.3),
        "clouds": (clouds(blue_sky(), 12), FOREST, 0.3),
        "many clouds": (clouds(blue_sky(), 20, 0.8), ROCK, 0.3),
        "overcast": (overcast(), ROCK, 0.3),
        "dark overcast": (overcast(0.18), (0.05, 0.05, 0.05), 0.3),
        "snow in a blue sky": (blue_sky(), SNOW, 0.15),
        "snow under white": (np.full((HEIGHT, WIDTH, 3), 0.98), (0.72, 0.68, 0.66), 0.1),
        "night-dark terrain": (np.array((0.2, 0.15, 0.12)) * np.ones((HEIGHT, WIDTH, 1)), NIGHT, 0.2),
        "sun": (blue_sky() + sun(200, 70), ROCK, 0.3),
    }


@pytest.mark.parametrize("name", list(scenes()))
def test_the_skyline_is_found_under_every_sky(name: str) -> None:
    light, colour, texture = scenes()[name]
    skyline = find_skyline(photograph(stand(light, ROW, colour, texture)))
    off = np.abs(error(skyline, ROW))
    assert off.size > 0.7 * WIDTH
    assert np.median(off) < 0.4
    assert np.percentile(off, 95) < 2


def test_snow_brighter_than_its_sky_above_dark_rock_is_not_called_confident_unless_right() -> None:
    snow = stand(overcast(0.675, 0.03), ROW, SNOW, 0.08)
    skyline = find_skyline(photograph(stand(snow, ridge(170, 20, 8), ROCK)))
    assert np.all(np.abs(error(skyline, ROW)) < 3)


def test_what_stands_in_front_of_the_skyline_is_not_called_confident() -> None:
    x = np.arange(WIDTH)
    bush = np.full(WIDTH, float(HEIGHT))
    for centre, half_width, height in ((60, 6, 14), (180, 10, 12), (250, 3, 25)):
        inside = np.abs(x - centre) <= half_width
        dome = np.sqrt(np.clip(1 - ((x[inside] - centre) / (half_width + 0.5)) ** 2, 0, 1))
        bush[inside] = ROW[centre] - height * dome
    light = stand(stand(blue_sky(), ROW, ROCK), bush, (0.01, 0.03, 0.01))
    skyline = find_skyline(photograph(light))
    assert not np.any(confident(skyline) & (bush < ROW - 1.5))
    assert confident(skyline)[bush > ROW].mean() > 0.7
    assert np.percentile(np.abs(error(skyline, ROW)), 95) < 0.5


def test_columns_without_sky_and_columns_without_terrain_say_so() -> None:
    x = np.arange(WIDTH)
    hump = 160 * np.exp(-(((x - 160) / 40.0) ** 2))
    wall = ridge(110, 20, 1) - hump
    skyline = find_skyline(photograph(stand(blue_sky(), wall, ROCK)))
    assert np.all(skyline.state[wall < -3] == ColumnState.NO_SKY)
    assert not np.any(skyline.state[wall > 3] == ColumnState.NO_SKY)
    gap = ridge(140, 10, 1) + hump
    skyline = find_skyline(photograph(stand(blue_sky(), gap, ROCK)))
    assert np.all(skyline.state[gap > HEIGHT + 3] == ColumnState.NO_TERRAIN)
    assert not np.any(skyline.state[gap < HEIGHT - 4] == ColumnState.NO_TERRAIN)
    none = skyline.state == ColumnState.NO_TERRAIN
    assert np.all(
        np.isnan(skyline.row_px[none]) & np.isnan(skyline.sigma_px[none]) & (skyline.confidence[none] == 0)
    )


def empty_pictures() -> dict[str, tuple[NDArray[np.uint8], ColumnState | None]]:
    """Pictures with no skyline, and what their columns must say (None: either way)."""
    terrain = stand(blue_sky(), np.full(WIDTH, -9.0), ROCK)
    noise = np.random.default_rng(0).integers(0, 256, (HEIGHT, WIDTH, 3)).astype(np.uint8)
    return {
        "clear sky": (photograph(blue_sky()), ColumnState.NO_TERRAIN),
        "cloudy sky": (photograph(clouds(blue_sky(), 3)), ColumnState.NO_TERRAIN),
        "overcast sky": (photograph(overcast()), ColumnState.NO_TERRAIN),
        "terrain": (photograph(terrain), ColumnState.NO_SKY),
        "night": (photograph(np.zeros((HEIGHT, WIDTH, 3)), noise=3), ColumnState.NO_SKY),
        "noise": (noise, None),
        "black": (np.zeros((HEIGHT, WIDTH, 3), np.uint8), None),
        "white": (np.full((HEIGHT, WIDTH, 3), 255, np.uint8), None),
    }


@pytest.mark.parametrize("name", list(empty_pictures()))
def test_a_picture_without_a_skyline_says_so_in_all_columns(name: str) -> None:
    picture, state = empty_pictures()[name]
    skyline = find_skyline(picture)
    assert np.all(np.isnan(skyline.row_px))
    assert np.all(skyline.confidence == 0)
    assert np.all(
        np.isin(skyline.state, [ColumnState.NO_SKY, ColumnState.NO_TERRAIN] if state is None else [state])
    )


@pytest.mark.parametrize(
    ("width", "height"), [(16, 16), (17, 41), (64, 48), (1001, 97), (97, 601), (2000, 1500)]
)
def test_pictures_of_any_size(width: int, height: int) -> None:
    row = ridge(height * 0.5, height * 0.08, 1, width)
    skyline = find_skyline(photograph(stand(blue_sky(height, width), row, FOREST)))
    for values in (skyline.row_px, skyline.sigma_px, skyline.confidence, skyline.state):
        assert values.shape == (width,)
    assert np.nanmedian(np.abs(skyline.row_px - row)) < 0.4


@pytest.mark.parametrize(
    "picture",
    [
        np.zeros((40, 40), np.uint8),
        np.zeros((40, 40, 3)),
        np.zeros((40, 40, 4), np.uint8),
    ],
)
def test_an_array_that_is_no_picture_is_refused(picture: NDArray[np.uint8]) -> None:
    with pytest.raises(ValueError, match="uint8"):
        find_skyline(picture)


@dataclass(frozen=True)
class Measured:
    """How the skyline of some pictures compares with the known one, columns of all of them taken together."""

    name: str
    known: int
    error_px: Floats
    normalised: Floats

    @property
    def share_confident(self) -> float:
        return self.error_px.size / self.known

    def percentile(self, percent: float) -> float:
        return float(np.percentile(np.abs(self.error_px), percent))

    def __str__(self) -> str:
        return (
            f"{self.name:24s} {self.known:6d} columns, {100 * self.share_confident:5.1f} % confident; of these median "
            f"{self.percentile(50):5.2f} px, 95 % {self.percentile(95):6.2f} px, 99 % {self.percentile(99):6.2f} px, "
            f"{100 * np.mean(np.abs(self.error_px) > 10):5.2f} % more than 10 px off"
        )


def measure(name: str, pictures: Iterable[tuple[NDArray[np.uint8], Floats, float]]) -> Measured:
    """Pictures, their known skylines (NaN where unknown) and the factor that errors are multiplied by."""
    known = 0
    errors, normalised = [], []
    for picture, row, factor in pictures:
        skyline = find_skyline(picture)
        here = np.isfinite(row) & confident(skyline)
        known += int(np.isfinite(row).sum())
        errors.append((skyline.row_px - row)[here] * factor)
        normalised.append(((skyline.row_px - row) / skyline.sigma_px)[here])
    return Measured(name, known, np.concatenate(errors), np.concatenate(normalised))


def picture_file(path: Path) -> NDArray[np.uint8]:
    picture = cv2.imread(str(path))
    assert picture is not None, path
    return np.asarray(picture, np.uint8)


def rendered(folder: Path) -> Iterator[tuple[NDArray[np.uint8], Floats, float]]:
    """Frames of a rendered bundle, with the terrain's skyline where no tree or rock stands before it."""
    truth = json.loads((folder / "truth.json").read_text())
    for label, image in truth["images"].items():
        row = np.array(image["terrain_row"], np.float64)
        yield picture_file(folder / "bundle" / "frames" / f"{label}.png"), row, 1.0


def test_rendered_frames(skyfix_data: Path) -> None:
    folders = sorted(path for path in (skyfix_data / "rendered").iterdir() if path.is_dir())
    each = [measure(folder.name, rendered(folder)) for folder in folders]
    assert len(each) > 0
    whole = measure("all", (picture for folder in folders for picture in rendered(folder)))
    for measured in (*each, whole):
        print(measured)
        assert measured.percentile(50) < 0.3
        assert (
            measured.share_confident > 0.45
        )  # bt_ridge has a far ridge as pale as its clouds: much is doubted
    assert whole.share_confident > 0.7
    assert whole.percentile(95) < 1
    inliers = whole.normalised[np.abs(whole.error_px) < 1]
    assert 0.7 < inliers.std() < 1.3


def photographs(folder: Path) -> Iterator[tuple[str, NDArray[np.uint8], Floats]]:
    """Photographs with skylines traced by hand, one marked pixel per column."""
    for path in sorted(folder.glob("???.jpg")):
        mark = picture_file(path.with_name(f"{path.stem}_skyline.png"))[..., 0] > 0
        yield path.stem, picture_file(path), np.where(mark.any(axis=0), mark.argmax(axis=0), np.nan)


@pytest.mark.long
def test_photographs(skyfix_data: Path) -> None:
    each = []
    for name, picture, row in photographs(skyfix_data / "local-only" / "skylines"):
        each.append(measure(name, [(picture, row, 1000 / picture.shape[1])]))
        print(each[-1])
    assert len(each) > 0
    known = sum(measured.known for measured in each)
    off = np.concatenate([measured.error_px for measured in each])
    whole = Measured("all, px at 1000 px width", known, off, off)
    print(whole)
    assert whole.share_confident > 0.9
    assert whole.percentile(50) < 0.5
    assert whole.percentile(95) < 1.5
    assert np.mean(np.abs(off) > 10) < 0.005


@pytest.mark.long
def test_hazy_and_snowy_photographs_of_the_columbia_glacier(skyfix_data: Path) -> None:
    folder = skyfix_data / "local-only" / "columbia"
    each = []
    for photo in json.loads((folder / "truth.json").read_text())["photos"]:
        picture = picture_file(folder / photo["photo"])
        row = np.full(picture.shape[1], np.nan)
        for line in photo["horizon_px"]:
            # their image corner is (0, 0), ours the centre of the corner pixel
            u, v = np.array(line)[np.argsort(np.array(line)[:, 0])].T - 0.5
            column = np.arange(max(0, math.ceil(u[0])), min(row.size, math.floor(u[-1]) + 1))
            row[column] = np.interp(column, u, v)
        each.append(measure(photo["photo"][:22], [(picture, row, 1000 / picture.shape[1])]))
        print(each[-1])
    known = sum(measured.known for measured in each)
    off = np.concatenate([measured.error_px for measured in each])
    whole = Measured("all, px at 1000 px width", known, off, off)
    print(whole)
    assert whole.share_confident > 0.6
    assert whole.percentile(50) < 0.6
    assert whole.percentile(95) < 9


@pytest.mark.long
def test_a_frame_takes_less_than_60_ms() -> None:
    picture = photograph(stand(clouds(blue_sky(480, 640), 10), ridge(220, 40, 1, 640), FOREST))
    taken_s = []
    for _ in range(20):
        begin = time.perf_counter()
        find_skyline(picture)
        taken_s.append(time.perf_counter() - begin)
    print(f"{1e3 * min(taken_s):.1f} ms")
    assert min(taken_s) < 0.06
