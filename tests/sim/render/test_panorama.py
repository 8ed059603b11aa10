"""The view all around is a picture of the surface, skyline and all."""

from pathlib import Path

import numpy as np
import pytest

from sim.render.contact_sheet import contact_sheet
from sim.render.panorama import BOTTOM_DEG, Panorama, render_panorama
from sim.render.renderer import Renderer
from sim.world.mechanics import camera_in_world
from sim.world.scenario import Scenario
from sim.world.truth import World


def made(santa_cruz: Path, seed: int, **weather: object) -> tuple[World, Panorama]:
    camera = {"fx_px": 150.0, "fy_px": 150.0}  # coarse, and so the panorama
    world = World.create([santa_cruz], Scenario.model_validate({"weather": weather, "camera": camera}), seed)
    return world, render_panorama(world)


@pytest.fixture(scope="module")
def clear(santa_cruz: Path) -> tuple[World, Panorama]:
    return made(santa_cruz, 4, sky="clear", sun_elevation_deg=40.0, sun_azimuth_deg=180.0)


def test_it_reaches_all_around_and_far_enough_up_and_down(clear: tuple[World, Panorama]) -> None:
    _, panorama = clear
    rows, columns, channels = panorama.image.shape
    assert columns * panorama.step_deg == pytest.approx(360.0)
    assert panorama.top_deg - (rows - 1) * panorama.step_deg <= BOTTOM_DEG
    assert channels == 3
    seam = panorama.image[:, 0].astype(float) - panorama.image[:, -1]
    inside = panorama.image[:, 1].astype(float) - panorama.image[:, 0]
    assert np.abs(seam).mean() < 2.0 * np.abs(inside).mean() + 1.0


def test_blue_sky_ends_where_the_surface_says(clear: tuple[World, Panorama]) -> None:
    world, panorama = clear
    columns = np.arange(0, panorama.image.shape[1], 11)
    elevation_deg, _ = world.surface.horizon(world.observer, columns * panorama.step_deg)
    skyline = (panorama.top_deg - elevation_deg) / panorama.step_deg
    blue_over_red = panorama.image[..., 0].astype(int) - panorama.image[..., 2]
    for column, row in zip(columns, skyline, strict=True):
        above, below = int(np.floor(row - 0.5)), int(np.ceil(row + 0.5))
        step = panorama.image[above, column].astype(int) - panorama.image[below, column]
        assert step.sum() > 20, "the sky is brighter than what it meets"
        away = panorama.image[above - 3 : above + 1, column].astype(int)
        assert np.abs(np.diff(away, axis=0)).max() < 12, "and is smooth down to it"
    assert (blue_over_red[: int(skyline.min()) - 1].mean(axis=1) > 10).all()


def test_what_lies_farther_off_is_hazier(santa_cruz: Path) -> None:
    """With the air thinned to nothing and thickened, the terrain's blue light grows with distance."""
    world, thin = made(santa_cruz, 1, sky="clear", visibility_km=500.0)
    _, thick = made(santa_cruz, 1, sky="clear", visibility_km=10.0)
    columns = np.arange(0, thin.image.shape[1], 3)
    elevation_deg, distance_m = world.surface.horizon(world.observer, columns * thin.step_deg)
    rows = np.ceil((thin.top_deg - elevation_deg) / thin.step_deg).astype(int) + 2
    gain = thick.image[rows, columns, 0].astype(float) - thin.image[rows, columns, 0]
    far, near = gain[distance_m > 4000.0], gain[distance_m < 150.0]
    assert len(far) > 50
    assert len(near) > 50
    assert far.mean() > 40.0
    assert abs(near.mean()) < 20.0


@pytest.mark.parametrize("sky", ["scattered", "broken", "overcast"])
def test_clouds_never_hang_before_the_terrain(
    santa_cruz: Path, clear: tuple[World, Panorama], sky: str
) -> None:
    _, cloudy = made(santa_cruz, 4, sky=sky, sun_elevation_deg=40.0, sun_azimuth_deg=180.0)
    world, bare = clear
    columns = np.arange(0, bare.image.shape[1], 7)
    elevation_deg, _ = world.surface.horizon(world.observer, columns * bare.step_deg)
    highest = int((bare.top_deg - elevation_deg.max()) / bare.step_deg)
    assert np.abs(cloudy.image[:highest].astype(int) - bare.image[:highest]).max() > 40
    for column, elevation in zip(columns, elevation_deg, strict=True):
        top = int(np.ceil((bare.top_deg - elevation) / bare.step_deg)) + 1
        ground = cloudy.image[top : top + 60, column].mean(axis=1)
        assert ground.max() < cloudy.image[top - 6 : top - 2, column].mean() + 25.0


def test_snow_lies_above_its_line(santa_cruz: Path, clear: tuple[World, Panorama]) -> None:
    _, bare = clear
    _, snowy = made(
        santa_cruz, 4, sky="clear", sun_elevation_deg=40.0, sun_azimuth_deg=180.0, snow_line_m=0.0
    )
    assert snowy.image[-250:].mean() > bare.image[-250:].mean() + 60.0


def test_the_same_world_looks_the_same(santa_cruz: Path, clear: tuple[World, Panorama]) -> None:
    _, again = made(santa_cruz, 4, sky="clear", sun_elevation_deg=40.0, sun_azimuth_deg=180.0)
    np.testing.assert_array_equal(again.image, clear[1].image)


def test_an_open_view_ends_in_sky(santa_cruz: Path) -> None:
    place = {"lat_deg": 37.3470, "lon_deg": -122.17, "enclosed_fraction": 0.0}  # at the northern edge
    world = World.create(
        [santa_cruz], Scenario.model_validate({"place": place, "weather": {"sky": "clear"}}), 1
    )
    panorama = render_panorama(world)
    assert (panorama.image.max(axis=2) > 0).all()


def test_a_contact_sheet_shows_all_of_it(clear: tuple[World, Panorama]) -> None:
    world, panorama = clear
    renderer = Renderer(world, panorama)
    sheet = contact_sheet(world, panorama, renderer)
    assert sheet.shape[1:] == (1280, 3)
    assert sheet.shape[0] > 960
    assert renderer.frame(camera_in_world(0.0, 5.0, 0.0), None).shape == (480, 640, 3)
