"""A DEM of three craters that look alike, and what a rig observes in them.

A hillock near the eastern spot tells craters 0 and 2 from crater 1 there, and one near the western spot tells crater 2 from the
others there. From either spot alone two craters remain; only the way between them says which. The contours come from the
simulator's own surface.
"""

import dataclasses
import functools
from pathlib import Path

import numpy as np
import rasterio
from affine import Affine

from localizer.dem.horizon import Terrain, prepare_terrain
from localizer.dem.lattice import load_dem
from localizer.observation import Observation
from localizer.track import Movement, Tracker, follow
from sim.paper.observations import aimed_tilt_deg, frame_observation, half_view_deg
from sim.world.contour import skyline_contour
from sim.world.mechanics import Attitude, camera_in_world
from sim.world.scenario import CameraOptics
from sim.world.surface import Surface
from sim.world.terrain import read_terrain

CELL_M = 30.0
SIDE = 96
CRATERS = 3
WEST_SPOT = (50.0, 44.0)
STEP_CELLS = 200.0 / CELL_M
EAST_SPOT = (WEST_SPOT[0], WEST_SPOT[1] + STEP_CELLS)
EAST_HILLOCK = (EAST_SPOT[0] - 1.0, EAST_SPOT[1] + 4.0)
WEST_HILLOCK = (WEST_SPOT[0] + 1.0, WEST_SPOT[1] - 4.0)
MAST_M = 2.0
OPTICS = CameraOptics(distortion=(0.0, 0.0, 0.0, 0.0, 0.0))


def crater(hillocks: list[tuple[float, float]]) -> np.ndarray:
    """Elevations (SIDE, SIDE): a ragged rim, the same each time, around ground that slopes gently."""
    row, col = np.mgrid[:SIDE, :SIDE].astype(float)
    y, x = row - SIDE / 2, col - SIDE / 2
    angle, radius = np.arctan2(y, x), np.hypot(y, x)
    rim_m = (
        420.0 + 20.0 * np.sin(3 * angle + 1.0) + 15.0 * np.sin(7 * angle) + 10.0 * np.sin(13 * angle + 2.0)
    )
    z = 500.0 + 0.4 * x - 0.3 * y + rim_m * np.exp(-(((radius - 40.0) / 4.0) ** 2))
    for at in hillocks:
        z += 60.0 * np.exp(-((row - at[0]) ** 2 + (col - at[1]) ** 2) / 2.0)
    return z


@dataclasses.dataclass(frozen=True, eq=False)
class Scene:
    dem_path: Path
    terrain: Terrain
    surface: Surface

    @functools.cache  # noqa: B019 - one scene lives as long as the module
    def look(self, number: int, spot: tuple[float, float], azimuths=(0.0, 90.0, 180.0, 270.0), seed=0):
        """What the rig observes at a spot of a crater; the same object for the same one."""
        rng = np.random.default_rng([seed, number, int(spot[1])])
        place = (spot[0], spot[1] + number * SIDE)
        eye_m = self.surface.height(*place) + MAST_M
        observer = self.surface.observer(*place, eye_m)
        columns_px = np.arange(0.0, float(OPTICS.width_px), 2.0)  # half the columns: half the time
        frames = []
        for azimuth_deg in azimuths:
            tilt_deg = aimed_tilt_deg(self.surface, observer, azimuth_deg, half_view_deg(OPTICS))
            contour = skyline_contour(
                self.surface, observer, OPTICS, camera_in_world(azimuth_deg, tilt_deg, 0.0), columns_px
            )
            frames.append(
                frame_observation(
                    f"{azimuth_deg:.0f}",
                    OPTICS,
                    Attitude(azimuth_deg, tilt_deg, 0.0),
                    (0.1, 0.01, 0.02),
                    columns_px,
                    contour + rng.normal(0.0, 0.5, len(contour)),
                    0.5,
                )
            )
        return Observation(tuple(frames), MAST_M, eye_m, 5.0, 0.5, 0.02)

    def error_cells(self, fix, number: int, spot: tuple[float, float]) -> float:
        return float(np.hypot(fix.position.row - spot[0], fix.position.col - spot[1] - number * SIDE))


def make_scene(folder: Path) -> Scene:
    """Writes the DEM into a folder and reads it."""
    z_m = np.hstack([crater([EAST_HILLOCK]), crater([]), crater([EAST_HILLOCK, WEST_HILLOCK])])
    path = folder / "craters.tif"
    profile = {"driver": "GTiff", "count": 1, "dtype": "float32", "crs": "EPSG:32610"}
    transform = Affine(CELL_M, 0.0, 500_000.0, 0.0, -CELL_M, 4_600_000.0)
    with rasterio.open(
        path, "w", height=z_m.shape[0], width=z_m.shape[1], transform=transform, **profile
    ) as raster:
        raster.write(z_m.astype(np.float32), 1)
    return Scene(path, prepare_terrain(load_dem([path])), Surface(read_terrain([path])))


def driven(east_m: float, north_m: float = 0.0, sigma_m: float = 4.0) -> Movement:
    return Movement(np.array([east_m, north_m]), sigma_m**2 * np.eye(2))


def track(scene: Scene, *looks: tuple[Movement | None, Observation], tracker: Tracker | None = None):
    """Follows the looks and returns the steps."""
    steps = []
    tracker = tracker or Tracker()
    for number, (leg, observation) in enumerate(looks):
        steps.append(follow(tracker, leg, scene.terrain, observation, f"look {number}"))
        tracker = steps[-1].tracker
    return steps


def blinded(observation: Observation) -> Observation:
    """The same in fog."""
    empty = np.zeros(0)
    return dataclasses.replace(
        observation,
        frames=tuple(
            dataclasses.replace(f, u_px=empty, v_px=empty, sigma_px=empty) for f in observation.frames
        ),
    )
