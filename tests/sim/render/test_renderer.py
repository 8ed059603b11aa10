"""Frames put everything where the lens does, and add what a sensor adds."""

from pathlib import Path

import numpy as np
import pytest

import sim.render.panorama
from sim.render.renderer import Renderer
from sim.world.contour import skyline_contour
from sim.world.mechanics import camera_in_world
from sim.world.scenario import CameraOptics, Scenario
from sim.world.truth import World

WHITE = 255.0
COLUMNS = np.arange(640)


def renderer_of(world: World, image: np.ndarray) -> Renderer:
    return Renderer(world, sim.render.panorama.Panorama(image, 0.05, 65.0))


def plain(value: int) -> np.ndarray:
    return np.full((2101, 7200, 3), value, dtype=np.uint8)


@pytest.fixture
def black_on_white(santa_cruz: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[World, Renderer]:
    """A world whose terrain is black and whose sky is white: what is left of the sky in a column is the skyline."""
    prepare, paint = sim.render.panorama.prepare_ground, sim.render.panorama.sky_picture

    def unlit(*arguments):
        return prepare(*arguments)._replace(sun_radiance=np.zeros(3), sky_radiance=np.zeros(3))

    monkeypatch.setattr(sim.render.panorama, "prepare_ground", unlit)
    monkeypatch.setattr(
        sim.render.panorama, "sky_picture", lambda *arguments: np.full_like(paint(*arguments), 255)
    )
    monkeypatch.setattr(
        sim.render.panorama, "air_light", lambda _, azimuth_deg: np.zeros((len(azimuth_deg), 3))
    )
    world = World.create([santa_cruz], Scenario.model_validate({"camera": {"vignetting": 0.0}}), 4)
    return world, Renderer(world, sim.render.panorama.render_panorama(world))


def test_the_skyline_is_where_the_contour_says(black_on_white: tuple[World, Renderer]) -> None:
    world, renderer = black_on_white
    for azimuth, tilt, roll in ((0.0, 8.0, 0.0), (77.0, 6.0, 5.0), (200.0, 6.0, -5.0), (290.0, 7.0, 2.0)):
        rotation = camera_in_world(azimuth, tilt, roll)
        frame = renderer.frame(rotation, None)[..., 0].astype(float)
        rows = skyline_contour(
            world.surface, world.observer, world.scenario.camera, rotation, COLUMNS.astype(float)
        )
        seen = np.isfinite(rows) & (rows > 10.0) & (rows < 470.0)
        assert seen.sum() > 500
        first = np.round(rows[seen]).astype(int) - 5
        window = frame[first[:, None] + np.arange(11), COLUMNS[seen, None]]
        off_px = first - 0.5 + window.sum(axis=1) / WHITE - rows[seen]
        assert abs(off_px.mean()) < 0.005
        assert np.sqrt(np.mean(off_px**2)) < 0.02
        # Only where the skyline bends within a pixel does the pixel see its mean, which the blur widens.
        assert np.quantile(np.abs(off_px), 0.98) < 0.05


def test_a_mark_in_the_panorama_appears_where_the_lens_puts_it(world: World) -> None:
    """A bright spot at azimuth 359.9 deg, across the panorama's seam, on the optical axis and beside it."""
    image = plain(0)
    azimuth_deg, elevation_deg = 359.9, 5.0
    image[round((65.0 - elevation_deg) / 0.05), round(azimuth_deg / 0.05)] = 255
    renderer = renderer_of(world, image)
    for turned_deg in (0.0, 0.3, -12.0):
        frame = renderer.frame(camera_in_world(azimuth_deg + turned_deg, elevation_deg, 0.0), None)[
            ..., 0
        ].astype(float)
        v, u = np.mgrid[:480, :640]
        centre = np.array([(frame * u).sum(), (frame * v).sum()]) / frame.sum()
        optics = world.scenario.camera
        if turned_deg == 0.0:
            np.testing.assert_allclose(centre, (optics.cx_px, optics.cy_px), atol=0.1)
        assert (centre[0] - optics.cx_px) * -turned_deg >= 0.0


def test_noise_has_its_size_and_is_fresh_in_every_frame(world: World) -> None:
    renderer = renderer_of(world, plain(128))
    rotation = camera_in_world(10.0, 0.0, 0.0)
    rng = world.rng("camera")
    frames = [renderer.frame(rotation, rng).astype(float) for _ in range(2)]
    middle = slice(200, 280), slice(260, 380)
    difference = frames[1][middle] - frames[0][middle]
    assert difference.std() / np.sqrt(2.0) == pytest.approx(world.scenario.camera.noise, rel=0.15)
    again = renderer.frame(rotation, world.rng("camera"))
    np.testing.assert_array_equal(again, frames[0])


def test_corners_are_darker_and_exposure_brightens(santa_cruz: Path) -> None:
    optics = {"vignetting": 0.36, "noise": 0.0, "exposure": 1.21}
    world = World.create([santa_cruz], Scenario.model_validate({"camera": optics}), 1)
    frame = renderer_of(world, plain(100)).frame(camera_in_world(0.0, 0.0, 0.0), None)
    assert frame[240, 320, 0] == 110
    assert frame[0, 0, 0] == pytest.approx(110 * 0.8, abs=1)


def test_looking_above_the_panorama_shows_its_sky(world: World) -> None:
    image = plain(40)
    image[:800] = 200
    frame = renderer_of(world, image).frame(camera_in_world(123.0, 60.0, 0.0), None)
    assert frame[:200].min() > 140


def test_other_cameras_have_other_frames(santa_cruz: Path) -> None:
    optics = CameraOptics(width_px=320, height_px=200, fx_px=250.0, fy_px=260.0, cx_px=150.0, cy_px=90.0)
    world = World.create([santa_cruz], Scenario(camera=optics), 1)
    frame = Renderer(world, sim.render.panorama.render_panorama(world)).frame(
        camera_in_world(0.0, 5.0, 0.0), None
    )
    assert frame.shape == (200, 320, 3)
