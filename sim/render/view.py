"""One view of a world: the picture that its camera takes, and where the skyline truly lies in it."""

import numpy as np
from numpy.typing import NDArray

from sim.render.panorama import Panorama, render_panorama
from sim.render.renderer import Renderer
from sim.world.contour import skyline_contour
from sim.world.mechanics import camera_in_world
from sim.world.truth import World


def render_view(
    world: World,
    azimuth_deg: float,
    tilt_deg: float = 0.0,
    roll_deg: float = 0.0,
    *,
    panorama: Panorama | None = None,
    noise: bool = True,
) -> NDArray[np.uint8]:
    """Take a picture with the world's camera: terrain, sky and light, seen through lens and sensor.

    Parameters
    ----------
    world : World
        Its place, weather and camera.
    azimuth_deg : float
        Of the optical axis, clockwise from true north.
    tilt_deg : float
        Of the optical axis, above the horizontal.
    roll_deg : float
        How far the camera is turned clockwise about its axis.
    panorama : Panorama, optional
        From `render_panorama`, for several views of one place; drawn anew unless given, which takes a second or two.
    noise : bool
        Whether the sensor has noise.

    Returns
    -------
    array of uint8
        (height, width, 3): blue, green, red.

    Examples
    --------
    >>> import sim
    >>> world = sim.World.create(seed=7, scenario=small_camera)  # or any scenario
    >>> panorama = sim.render_panorama(world)
    >>> views = [sim.render_view(world, azimuth_deg, 4.0, panorama=panorama) for azimuth_deg in (0, 90, 180, 270)]
    >>> views[0].shape, views[0].dtype
    ((120, 160, 3), dtype('uint8'))
    """
    renderer = Renderer(world, panorama or render_panorama(world))
    rotation = camera_in_world(azimuth_deg, tilt_deg, roll_deg)
    return renderer.frame(rotation, world.rng(f"view {azimuth_deg} {tilt_deg} {roll_deg}") if noise else None)


def true_skyline(
    world: World, azimuth_deg: float, tilt_deg: float = 0.0, roll_deg: float = 0.0
) -> NDArray[np.float64]:
    """Where the sky begins in each column of a view, computed from the terrain and not from the picture.

    Parameters
    ----------
    world : World
        Its place and camera.
    azimuth_deg, tilt_deg, roll_deg : float
        As for `render_view`.

    Returns
    -------
    array of float
        (width,): the row of the boundary, px; an edge between the pixels of rows 99 and 100 is 99.5. NaN where the skyline
        leaves the picture.

    Examples
    --------
    >>> import numpy as np, sim
    >>> world = sim.World.create(seed=7, scenario=small_camera)  # or any scenario
    >>> rows = sim.true_skyline(world, azimuth_deg=0.0, tilt_deg=4.0)
    >>> rows.shape, bool(np.isfinite(rows).all())
    ((160,), True)
    """
    camera = world.scenario.camera
    rotation = camera_in_world(azimuth_deg, tilt_deg, roll_deg)
    return skyline_contour(
        world.surface, world.observer, camera, rotation, np.arange(camera.width_px, dtype=np.float64)
    )
