"""The boresight's fit on rendered pictures: errors from tracing the skyline, and from everything else.

``pytest tests/sim/render/test_boresight_pictures.py -m long -s`` says how far off each place's fit is.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from localizer.camera import camera_to_world, pixel_rays
from localizer.skyline.find import CONFIDENT, ColumnState, Skyline, find_skyline
from rig.attitude.kinematics import Attitude
from rig.calibrate.boresight.fit import BoresightFit, fit_boresight
from rig.calibrate.boresight.horizon_profile import horizon_profile
from rig.calibrate.boresight.known_place import PlaceSigmas, known_place
from rig.calibrate.boresight.skyline_frame import SkylineFrame
from sim.commands.options import EMBEDDED_DEM
from sim.render.panorama import render_panorama
from sim.render.renderer import Renderer
from sim.world.contour import skyline_contour
from sim.world.scenario import load_scenario
from sim.world.truth import World

UNCALIBRATED = Path(__file__).parents[3] / "configs" / "scenarios" / "uncalibrated.toml"
PLACES = {  # of the rigs of these seeds, as rig calibrate sites advised them; the first two show far ridges in haze
    6: (37.2601177, -122.2437064),
    2: (37.2563251, -122.2399245),
    1: (37.2664135, -122.1636028),
}
COLUMNS_PX = np.arange(6, 640, 12)
LEVEL = Attitude(0.0, 0.0, 0.0)

pytestmark = [pytest.mark.long, pytest.mark.timeout(900)]


@dataclass(frozen=True)
class Look:
    """One picture: where the camera pointed, the skyline as it is and as it was traced."""

    stop: int
    azimuth_deg: float
    tilt_deg: float
    true_row_px: NDArray[np.float64]
    traced: Skyline


def look_round(world: World, seed: int) -> list[Look]:
    """Eight directions, in each the skyline in the middle and further up or down, as the calibration does it."""
    rng, optics = np.random.default_rng(seed), world.scenario.camera
    renderer, middle_px = Renderer(world, render_panorama(world)), (optics.height_px - 1) / 2.0
    looks = []
    for stop in range(8):
        azimuth_deg, tilt_deg = 45.0 * stop + 5.0, 5.0
        for lean in (0.0, 0.65 if stop % 2 else -0.65):
            for _ in range(3):
                here_px = np.nanmedian(true_rows(world, azimuth_deg, tilt_deg))
                target_px = middle_px * (1.0 + lean)
                turn = np.arctan((target_px - middle_px) / optics.fy_px) - np.arctan(
                    (here_px - middle_px) / optics.fy_px
                )
                tilt_deg += float(np.degrees(turn))
            pictures = [renderer.frame(camera_to_world(azimuth_deg, tilt_deg, 0.0), rng) for _ in range(4)]
            traced = find_skyline(np.rint(np.mean(pictures, axis=0)).astype(np.uint8))
            looks.append(Look(stop, azimuth_deg, tilt_deg, true_rows(world, azimuth_deg, tilt_deg), traced))
    return looks


def true_rows(world: World, azimuth_deg: float, tilt_deg: float) -> NDArray[np.float64]:
    rotation = camera_to_world(azimuth_deg, tilt_deg, 0.0)
    columns = COLUMNS_PX.astype(float)
    return skyline_contour(world.surface, world.observer, world.scenario.camera, rotation, columns)


def fitted(world: World, looks: Sequence[Look], as_traced: bool) -> BoresightFit:
    place = known_place(world.place.lat_deg, world.place.lon_deg, (EMBEDDED_DEM,))
    profile = horizon_profile(place, place.ground_m + world.scenario.vehicle.mast_height_m)
    optics, frames = world.scenario.camera, []
    for look in looks:
        traced = look.traced
        rows = traced.row_px[COLUMNS_PX] if as_traced else look.true_row_px
        sure = (traced.state[COLUMNS_PX] == ColumnState.OK) & (traced.confidence[COLUMNS_PX] >= CONFIDENT)
        sure &= np.isfinite(rows)
        sigma_px = np.maximum(traced.sigma_px[COLUMNS_PX][sure], 0.3)
        frames.append(
            SkylineFrame(
                f"{look.azimuth_deg:.0f}",
                Attitude(look.azimuth_deg, look.tilt_deg, 0.0),
                pixel_rays(optics, COLUMNS_PX[sure], rows[sure]).reshape(-1, 3),
                np.degrees(sigma_px / optics.fy_px),
                float(sure.mean()),
                0.05,
                0.01,
                look.stop,
            )
        )
    return fit_boresight(frames, profile, LEVEL, 0.4, PlaceSigmas(4.0, 1.5, 1.5))


def tell_tracing(world: World, looks: Sequence[Look]) -> None:
    """Print by how much the traced skyline lies lower than the true one, by the distance of the ridge."""
    low_px, distance_m = [], []
    for look in looks:
        sure = look.traced.confidence[COLUMNS_PX] >= CONFIDENT
        sure &= (look.traced.state[COLUMNS_PX] == ColumnState.OK) & np.isfinite(look.true_row_px)
        rays = pixel_rays(world.scenario.camera, COLUMNS_PX[sure], look.true_row_px[sure]).reshape(-1, 3)
        east, north, _ = camera_to_world(look.azimuth_deg, look.tilt_deg, 0.0) @ rays.T
        azimuth_deg = np.degrees(np.arctan2(east, north))
        distance_m.append(world.surface.horizon(world.observer, azimuth_deg)[1])
        low_px.append(look.traced.row_px[COLUMNS_PX][sure] - look.true_row_px[sure])
    low, far = np.concatenate(low_px), np.concatenate(distance_m)
    for name, these in (("within 2 km", far < 2000.0), ("beyond 4 km", far > 4000.0)):
        if these.any():
            print(
                f"ridges {name}: traced {np.median(low[these]):+.2f} px low, "
                f"{np.mean(low[these] > 0.5):.0%} more than 0.5, {np.mean(low[these] > 2.0):.0%} more than 2"
            )


@pytest.mark.parametrize("seed", PLACES)
def test_the_tilt_is_found_from_the_true_skyline_and_from_the_traced_one(seed: int) -> None:
    lat_deg, lon_deg = PLACES[seed]
    scenario = load_scenario(UNCALIBRATED)
    at = scenario.place.model_copy(update={"lat_deg": lat_deg, "lon_deg": lon_deg})
    world = World.create([EMBEDDED_DEM], scenario.model_copy(update={"place": at}), seed)
    looks = look_round(world, seed)
    print()
    tell_tracing(world, looks)
    off_deg = {}
    for name, as_traced in (("true", False), ("traced", True)):
        fit = fitted(world, looks, as_traced)
        azimuth_deg = fit.boresight.azimuth_deg + fit.heading_offset_deg
        off_deg[name] = (fit.boresight.tilt_deg, fit.boresight.roll_deg, azimuth_deg)
        print(f"rig {seed}, {name} skyline: tilt, roll, azimuth off by", np.round(off_deg[name], 4))
    assert np.abs(off_deg["true"]).max() < 0.005
    tilt_deg, roll_deg, azimuth_deg = off_deg["traced"]
    assert abs(tilt_deg) < 0.02
    assert abs(roll_deg) < 0.02
    assert abs(azimuth_deg) < 0.04
