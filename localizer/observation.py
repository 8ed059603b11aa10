"""What the search is given: the skyline's points in each frame and how well everything about them is known.

It does not matter here whether the points came from an image, from a person with a pencil or from a simulation.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from localizer.camera import Intrinsics

NO_COMPASS_SIGMA_DEG = 180.0
"""An azimuth bias of this sigma or more says that nothing is known about the heading."""


@dataclass(frozen=True)
class FrameObservation:
    """The skyline in one frame.

    ``u_px``, ``v_px``, ``sigma_px``: arrays (n,) of contour points in raw (distorted) pixels and their standard deviations
    across the contour. Angles are the camera's as the sensors gave them; their sigmas are independent in each frame.
    """

    label: str
    camera: Intrinsics
    azimuth_deg: float
    azimuth_sigma_deg: float
    tilt_deg: float
    tilt_sigma_deg: float
    roll_deg: float
    roll_sigma_deg: float
    u_px: NDArray[np.float64]
    v_px: NDArray[np.float64]
    sigma_px: NDArray[np.float64]


@dataclass(frozen=True)
class PriorCircle:
    """Where the camera is known to be: within ``radius_m`` of a place (WGS84)."""

    lat_deg: float
    lon_deg: float
    radius_m: float


@dataclass(frozen=True)
class Observation:
    """All frames from one standpoint, with the errors that they share.

    ``altitude_m`` is that of the optical centre above the DEM's datum, None without an altimeter.
    """

    frames: tuple[FrameObservation, ...]
    mast_height_m: float
    altitude_m: float | None
    altitude_sigma_m: float
    azimuth_bias_sigma_deg: float
    tilt_bias_sigma_deg: float
    prior: PriorCircle | None = None
