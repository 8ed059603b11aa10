"""The sigmas that a fit states against the spread of its true errors.

Everything that the search calls uncertain is drawn with the sigma that it is told: the contour's noise, the readings, and an
error of the DEM's ridges that is correlated along the ground. Elsewhere in the tests contours come from the very surface that
is searched, so that no sigma could be too small.
"""

from dataclasses import dataclass

import numpy as np
import pytest
from local_map import local_dem
from seen_from import Lens

from localizer.camera import camera_to_world, project
from localizer.dem.horizon import Terrain, horizon, prepare_terrain
from localizer.observation import FrameObservation, Observation
from localizer.search.contours import frame_contour
from localizer.search.fit.noise import initial_noise
from localizer.search.fit.problem import Problem
from localizer.search.fit.refine import Refined, refine

CELL_M, SIDE = 30.0, 121
PLACE = (60.3, 59.8)
MAST_M = 2.0
AZIMUTHS_DEG = (0.0, 90.0, 180.0, 270.0)
ASIDE_DEG = np.arange(-30.0, 30.1, 2.5)
FITS = 24
LENS = Lens(distortion=(0.0,) * 5)


@pytest.fixture(scope="module")
def terrain() -> Terrain:
    """Ground that slopes, inside a ragged rim of hills about 1.2 km away."""
    row, col = np.mgrid[:SIDE, :SIDE].astype(float)
    north, east = SIDE // 2 - row, col - SIDE // 2
    angle, away = np.arctan2(east, north), np.hypot(east, north)
    rim_m = (
        300.0 + 40.0 * np.sin(3.0 * angle + 1.0) + 30.0 * np.sin(7.0 * angle) + 12.0 * np.sin(17.0 * angle)
    )
    reach = 40.0 + 6.0 * np.sin(2.0 * angle)
    height_m = 500.0 + 0.5 * east - 0.3 * north + rim_m * np.exp(-(((away - reach) / 6.0) ** 2))
    return prepare_terrain(local_dem(height_m, CELL_M))


@dataclass(frozen=True)
class Errors:
    """Of the contour, pixels, and of the DEM's ridges: metres, and the length of an exponential correlation."""

    contour_px: float = 1.0
    dem_m: float = 0.0
    length_m: float = CELL_M


def observe(terrain: Terrain, errors: Errors, rng: np.random.Generator) -> tuple[Observation, float]:
    """What a rig at PLACE reads, with errors of everything; and the bias of its heading."""
    ground_m = float(terrain.dem.ground_m(*PLACE))
    eye_m = ground_m + MAST_M + rng.normal(0.0, 0.5)
    azimuth_bias_deg, tilt_bias_deg = rng.normal(0.0, 1.0), rng.normal(0.0, 0.02)
    azimuth_deg = np.concatenate([azimuth + ASIDE_DEG for azimuth in AZIMUTHS_DEG])
    elevation_deg, distance_m = (values[0] for values in horizon(terrain, *PLACE, eye_m, azimuth_deg))
    apart_m = np.abs(np.radians((azimuth_deg[:, None] - azimuth_deg + 180.0) % 360.0 - 180.0)) * distance_m
    correlation = np.exp(-0.5 * (apart_m + apart_m.T) / errors.length_m)
    error_m = (
        errors.dem_m
        * np.linalg.cholesky(correlation + 1e-9 * np.eye(len(correlation)))
        @ rng.normal(size=len(correlation))
    )
    elevation_deg = elevation_deg + np.degrees(error_m / distance_m)
    frames = []
    for number, azimuth in enumerate(AZIMUTHS_DEG):
        own = slice(number * len(ASIDE_DEG), (number + 1) * len(ASIDE_DEG))
        tilt_deg, roll_deg = float(np.median(elevation_deg[own])), float(rng.normal(0.0, 1.0))
        u, v = project(
            LENS, camera_to_world(azimuth, tilt_deg, roll_deg), azimuth_deg[own], elevation_deg[own]
        )
        frames.append(
            FrameObservation(
                label=str(number),
                camera=LENS,
                azimuth_deg=azimuth + azimuth_bias_deg + rng.normal(0.0, 0.1),
                azimuth_sigma_deg=0.1,
                tilt_deg=tilt_deg + tilt_bias_deg + rng.normal(0.0, 0.05),
                tilt_sigma_deg=0.05,
                roll_deg=roll_deg + rng.normal(0.0, 0.05),
                roll_sigma_deg=0.05,
                u_px=u,
                v_px=v + rng.normal(0.0, errors.contour_px, len(v)),
                sigma_px=np.full(len(v), errors.contour_px),
            )
        )
    observation = Observation(tuple(frames), MAST_M, eye_m + rng.normal(0.0, 5.0), 5.0, 1.0, 0.02)
    return observation, azimuth_bias_deg


def fit(terrain: Terrain, errors: Errors, seed: int) -> tuple[Refined, float]:
    """A fit that starts at the place, and the error of its heading in sigmas."""
    observation, azimuth_bias_deg = observe(terrain, errors, np.random.default_rng(seed))
    problem = Problem(terrain, observation, tuple(frame_contour(f) for f in observation.frames))
    found = refine(
        problem,
        *PLACE,
        observation.altitude_m,
        0.0,
        iterations=24,
        noise=initial_noise(terrain, 2.0 * terrain.nominal_error_m),
        largest_dem_error_m=terrain.largest_error_m,
        estimate_noise=True,
    )
    return found, (found.azimuth_bias_deg - azimuth_bias_deg) / found.azimuth_bias_sigma_deg


def normalised(fits: list[Refined]) -> np.ndarray:
    """Errors (n, 2) of the places in units of their covariances."""
    out = []
    for found in fits:
        off_m = CELL_M * np.array([found.col - PLACE[1], PLACE[0] - found.row])
        out.append(np.linalg.solve(np.linalg.cholesky(found.covariance_enu_m2), off_m))
    return np.array(out)


@pytest.mark.parametrize(
    "errors",
    [
        pytest.param(Errors(contour_px=2.0), id="noisy contour"),
        pytest.param(Errors(contour_px=0.3, dem_m=4.0), id="DEM error that differs from cell to cell"),
        pytest.param(Errors(contour_px=0.3, dem_m=4.0, length_m=240.0), id="DEM error that 8 cells share"),
    ],
)
def test_true_errors_spread_as_the_stated_sigmas_say(terrain, errors):
    fits = [fit(terrain, errors, seed) for seed in range(FITS)]
    assert 0.7 < np.sqrt(np.mean(normalised([found for found, _ in fits]) ** 2)) < 1.3
    assert 0.6 < np.sqrt(np.mean(np.square([heading for _, heading in fits]))) < 1.4
    assert min(found.inlier_share for found, _ in fits) > 0.85
    assert min(found.evidence for found, _ in fits) > 25.0
