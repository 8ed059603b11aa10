"""The camera's view from the vehicle's present place."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sim.render.panorama import render_panorama
from sim.render.renderer import Renderer
from sim.world.true_values import Standpoint, Vehicle
from sim.world.truth import World

Picture = Callable[[NDArray[np.float64], np.random.Generator], NDArray[np.uint8]]


class SceneCamera:
    """Renders the world's terrain and sky, or a given picture function."""

    def __init__(self, world: World, picture: Picture | None) -> None:
        self._world = world
        self._drawn = picture is None
        self._picture = picture or Renderer(world, render_panorama(world)).frame

    def picture(self, rotation: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.uint8]:
        """Render, as ``Picture``; single-threaded."""
        return self._picture(rotation, rng)

    def move_to(self, standpoint: Standpoint) -> None:
        """Render the panorama of another place and use it from now on."""
        if self._drawn:
            there = replace(self._world, vehicle=Vehicle(standpoint))
            self._picture = Renderer(there, render_panorama(there)).frame
