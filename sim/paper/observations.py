"""Observations for the localizer without images: contours with attitudes as measured by the sensors."""

import numpy as np
from numpy.typing import NDArray

from localizer import FrameObservation
from sim.world.mechanics import Attitude
from sim.world.scenario import CameraOptics
from sim.world.surface import Observer, Surface

Array = NDArray[np.float64]

NO_SKYLINE_TILT_DEG = 0.0


def half_view_deg(optics: CameraOptics) -> float:
    """Half of the horizontal angle of view, lens distortion ignored."""
    return float(np.degrees(np.arctan(optics.width_px / 2.0 / optics.fx_px)))


def aimed_tilt_deg(surface: Surface, observer: Observer, azimuth_deg: float, half_view_deg: float) -> float:
    """The tilt, degrees, that puts the skyline about the middle of the image."""
    ahead, _ = surface.horizon(observer, azimuth_deg + np.arange(-half_view_deg, half_view_deg, 1.0))
    return float(np.round(np.nanmedian(ahead), 2)) if np.isfinite(ahead).any() else NO_SKYLINE_TILT_DEG


def frame_observation(
    label: str,
    optics: CameraOptics,
    measured: Attitude,
    sigmas_deg: tuple[float, float, float],
    columns_px: Array,
    rows_px: Array,
    sigma_px: float,
) -> FrameObservation:
    """One frame as input of the localizer.

    Args:
        label: of the frame.
        optics: the camera as the rig believes it to be.
        measured: attitude as the sensors gave it (heading: azimuth, pitch: tilt).
        sigmas_deg: of the frame's own azimuth, tilt and roll.
        columns_px: image columns (n,).
        rows_px: contour (n,) there; columns without one are NaN.
        sigma_px: of the contour.
    """
    seen = np.isfinite(rows_px)
    return FrameObservation(
        label=label,
        camera=optics,
        azimuth_deg=measured.heading_deg,
        azimuth_sigma_deg=sigmas_deg[0],
        tilt_deg=measured.pitch_deg,
        tilt_sigma_deg=sigmas_deg[1],
        roll_deg=measured.roll_deg,
        roll_sigma_deg=sigmas_deg[2],
        u_px=columns_px[seen],
        v_px=rows_px[seen],
        sigma_px=np.full(int(seen.sum()), sigma_px),
    )
