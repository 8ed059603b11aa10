"""The observation, input of the search: skyline points and attitude of each frame, altitude, and all sigmas.

The points can come from an image, from manual tracing or from a simulation.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from localizer.camera import Intrinsics

NO_COMPASS_SIGMA_DEG = 180.0
"""An azimuth bias sigma of this or more means that the heading is unknown."""


@dataclass(frozen=True)
class FrameObservation:
    """The skyline in one frame.

    ``u_px``, ``v_px``, ``sigma_px``: arrays (n,) of contour points in raw (distorted) pixels and their standard deviations
    across the contour. Angles are the camera's as the sensors gave them; their sigmas are independent in each frame.

    Raises:
        ValueError: the arrays differ in length, a number is not finite, a point has no positive sigma, an angle a negative one.
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

    def __post_init__(self) -> None:
        if self.u_px.ndim != 1 or not self.u_px.shape == self.v_px.shape == self.sigma_px.shape:
            raise ValueError(f"frame {self.label}: u_px, v_px and sigma_px must be of one length")
        numbers = np.concatenate([self.u_px, self.v_px, self.sigma_px])
        if not (np.isfinite(numbers).all() and (self.sigma_px > 0.0).all()):
            raise ValueError(f"frame {self.label}: points must be finite, their sigmas positive")
        angles = (self.azimuth_deg, self.tilt_deg, self.roll_deg)
        sigmas = (self.azimuth_sigma_deg, self.tilt_sigma_deg, self.roll_sigma_deg)
        if not np.isfinite(angles).all() or not all(sigma >= 0.0 for sigma in sigmas):
            raise ValueError(f"frame {self.label}: angles must be finite, their sigmas not negative")


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

    Raises:
        ValueError: the altitude has no positive sigma, or a bias a negative one.
    """

    frames: tuple[FrameObservation, ...]
    mast_height_m: float
    altitude_m: float | None
    altitude_sigma_m: float
    azimuth_bias_sigma_deg: float
    tilt_bias_sigma_deg: float
    prior: PriorCircle | None = None

    def __post_init__(self) -> None:
        if self.altitude_m is not None and not (np.isfinite(self.altitude_m) and self.altitude_sigma_m > 0.0):
            raise ValueError("the altitude must be finite, its sigma positive")
        if not (self.azimuth_bias_sigma_deg >= 0.0 and self.tilt_bias_sigma_deg >= 0.0):
            raise ValueError("the sigmas of the azimuth's and the tilt's bias must not be negative")
