"""Cases without images: exact contours plus errors drawn from a scenario."""

import numpy as np
from numpy.typing import NDArray

from localizer import Observation, azimuth_elevation_deg, camera_to_world, pixel_rays
from localizer.experiments import Terrain, horizon_around
from sim.evaluate.disturb import Disturbed
from sim.evaluate.scenario import EvaluationScenario
from sim.evaluate.truth import TrueFrame, Truth
from sim.paper.observations import frame_observation

Array = NDArray[np.float64]

MIN_SIGMA_PX = 0.05
SECANT_STEPS = 8


def observation_of(
    truth: Truth, scenario: EvaluationScenario, columns_px: Array, disturbed: Disturbed
) -> Observation:
    """The localizer's input for a case."""
    assumed = scenario.assumed_sigma
    errors = scenario.errors
    sigma_px = scenario.told.contour_sigma_px or max(
        float(np.hypot(errors.contour_sigma_px, errors.contour_correlated_sigma_px)), MIN_SIGMA_PX
    )
    sigmas_deg = (assumed("azimuth_sigma_deg"), assumed("tilt_sigma_deg"), assumed("roll_sigma_deg"))
    frames = tuple(
        frame_observation(
            frame.label, scenario.camera, frame.measured, sigmas_deg, columns_px, rows, sigma_px
        )
        for frame, rows in zip(truth.frames, disturbed.rows_px, strict=True)
    )
    return Observation(
        frames=frames,
        mast_height_m=scenario.vehicle.mast_height_m,
        altitude_m=truth.measured_altitude_m,
        altitude_sigma_m=assumed("altitude_sigma_m") if errors.altimeter else float("inf"),
        azimuth_bias_sigma_deg=assumed("azimuth_bias_sigma_deg"),
        tilt_bias_sigma_deg=assumed("tilt_bias_sigma_deg"),
    )


def searched_contour(
    terrain: Terrain,
    place: tuple[float, float, float],
    frame: TrueFrame,
    scenario: EvaluationScenario,
    columns_px: Array,
) -> Array:
    """The contour (n,) of the searched surface itself, by the localizer's own geometry.

    The remaining error is then the estimator's, not that between two surfaces. ``place``: row, col, altitude.
    """
    attitude = frame.attitude
    rotation = camera_to_world(attitude.heading_deg, attitude.pitch_deg, attitude.roll_deg)

    def above(rows: Array) -> Array:
        """Elevation of the lines of sight above the horizon, degrees."""
        azimuth, elevation = azimuth_elevation_deg(pixel_rays(scenario.camera, columns_px, rows) @ rotation.T)
        tangent, _ = horizon_around(terrain, *place, np.radians(azimuth))
        return np.asarray(elevation - np.degrees(np.arctan(tangent)))

    px_per_deg = scenario.camera.fy_px * np.pi / 180.0
    before = np.full(len(columns_px), scenario.camera.cy_px)
    above_before = above(before)
    rows = before + above_before * px_per_deg
    for _ in range(SECANT_STEPS):
        above_now = above(rows)
        with np.errstate(invalid="ignore", divide="ignore"):
            step = above_now * (rows - before) / (above_now - above_before)
        step = np.where(np.isfinite(step), step, 0.0)
        before, above_before, rows = rows, above_now, rows - step
    inside = (rows > -0.5) & (rows < scenario.camera.height_px - 0.5) & (np.abs(step) < 0.01)
    return np.where(inside, rows, np.nan)
