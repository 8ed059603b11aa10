"""Contact sheet of a simulated world: the whole panorama, and camera frames."""

import cv2
import numpy as np
from numpy.typing import NDArray

from sim.render.panorama import Panorama
from sim.render.renderer import Renderer
from sim.world.mechanics import camera_in_world
from sim.world.truth import World

STRIP_ABOVE_DEG, STRIP_BELOW_DEG = 45.0, -20.0
DIRECTIONS = {"N": 0.0, "E": 90.0, "S": 180.0, "W": 270.0}


def contact_sheet(world: World, panorama: Panorama, renderer: Renderer) -> NDArray[np.uint8]:
    """BGR image: the panorama from north to north, above frames to N, E, S and W."""
    frames = [_frame(world, renderer, label, azimuth_deg) for label, azimuth_deg in DIRECTIONS.items()]
    pictures = np.vstack([np.hstack(frames[:2]), np.hstack(frames[2:])])
    top, bottom = ((panorama.top_deg - deg) / panorama.step_deg for deg in (STRIP_ABOVE_DEG, STRIP_BELOW_DEG))
    strip = panorama.image[round(top) : round(bottom)]
    width = pictures.shape[1]
    height = round(width * strip.shape[0] / strip.shape[1])
    small = np.asarray(cv2.resize(strip, (width, height), interpolation=cv2.INTER_AREA), dtype=np.uint8)
    for label, azimuth_deg in DIRECTIONS.items():
        _write(small, label, round(width * azimuth_deg / 360.0))
    return np.vstack([small, pictures])


def _frame(world: World, renderer: Renderer, label: str, azimuth_deg: float) -> NDArray[np.uint8]:
    """A frame without roll, tilted to the skyline."""
    around_deg = azimuth_deg + np.linspace(-20.0, 20.0, 41)
    skyline_deg = float(np.nanmedian(np.nan_to_num(world.surface.horizon(world.observer, around_deg)[0])))
    frame = renderer.frame(
        camera_in_world(azimuth_deg, skyline_deg, 0.0), world.rng(f"contact sheet {label}")
    )
    _write(frame, label, 0)
    return frame


def _write(picture: NDArray[np.uint8], text: str, left: int) -> None:
    for thickness, shade in ((4, 0), (2, 255)):
        cv2.putText(
            picture, text, (left + 8, 28), cv2.FONT_HERSHEY_SIMPLEX, 0.8, (shade,) * 3, thickness, cv2.LINE_AA
        )
