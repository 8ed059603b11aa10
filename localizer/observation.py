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
    """The skyline in one frame, and how well the frame's attitude is known.

    Angles are the camera's as the sensors gave them; sigmas are one standard deviation, independent in each frame.

    Attributes
    ----------
    label : str
        Names the frame, as ``N``.
    camera : Camera
        Its intrinsics; any object with ``fx_px``, ``fy_px``, ``cx_px``, ``cy_px`` and ``distortion`` will do.
    azimuth_deg, azimuth_sigma_deg : float
        True azimuth of the optical axis.
    tilt_deg, tilt_sigma_deg : float
        Angle of the optical axis above the horizontal.
    roll_deg, roll_sigma_deg : float
        Positive when the camera is turned clockwise, seen from behind it.
    u_px, v_px : ndarray of float, shape (n,)
        Column and row of the contour's points, distorted pixels, centres at whole numbers.
    sigma_px : ndarray of float, shape (n,)
        Of each point, across the contour.

    Raises
    ------
    ValueError
        The arrays differ in length, a number is not finite, a point has no positive sigma, or an angle a negative one.

    Examples
    --------
    >>> import numpy as np
    >>> camera = localizer.Camera(width_px=640, height_px=480, fx_px=492.8, fy_px=492.8, cx_px=319.5, cy_px=239.5)
    >>> frame = localizer.FrameObservation(
    ...     label="N", camera=camera, azimuth_deg=0.1, azimuth_sigma_deg=0.1, tilt_deg=5.0, tilt_sigma_deg=0.01,
    ...     roll_deg=0.0, roll_sigma_deg=0.02,
    ...     u_px=np.arange(640.0), v_px=np.full(640, 200.0), sigma_px=np.full(640, 0.5),
    ... )
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
    """A circle within which the camera is known to be.

    Attributes
    ----------
    lat_deg, lon_deg : float
        Its centre, WGS84.
    radius_m : float
        On the ground.

    Raises
    ------
    ValueError
        There is no such circle.
    """

    lat_deg: float
    lon_deg: float
    radius_m: float

    def __post_init__(self) -> None:
        if not (abs(self.lat_deg) <= 90.0 and np.isfinite(self.lon_deg) and 0.0 < self.radius_m < np.inf):
            raise ValueError(
                f"circle of {self.radius_m:g} m around {self.lat_deg:g}, {self.lon_deg:g}: give latitude, longitude and a "
                "radius above 0"
            )


@dataclass(frozen=True)
class Observation:
    """All frames from one standpoint, with the errors that they share.

    Attributes
    ----------
    frames : tuple of FrameObservation
        In any directions.
    mast_height_m : float
        Height of the optical centre above the ground.
    altitude_m : float or None
        Of the optical centre above the DEM's vertical datum; None without an altimeter.
    altitude_sigma_m : float
        One standard deviation; of no account without an altimeter.
    azimuth_bias_sigma_deg, tilt_bias_sigma_deg : float
        One standard deviation of the errors common to all frames; 180 for the azimuth without a compass.
    prior : PriorCircle or None
        Where the camera is known to be; None in the ordinary case.

    Raises
    ------
    ValueError
        The altitude has no positive sigma, or a bias a negative one.

    See Also
    --------
    observation_from_bundle : Makes one from a bundle.

    Examples
    --------
    >>> import dataclasses
    >>> observation = localizer.observation_from_bundle(localizer.load_bundle("bundles/first"))
    >>> without_compass = dataclasses.replace(observation, azimuth_bias_sigma_deg=180.0)
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
