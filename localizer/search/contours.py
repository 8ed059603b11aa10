"""The observed horizon line contour (HLC, the paper's term) as directions in the world, by the measured attitude alone.

A *measured* azimuth is the true one plus the unknown bias of the heading.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from localizer.camera import azimuth_elevation_deg, camera_to_world, pixel_rays
from localizer.observation import FrameObservation, Observation

Floats = NDArray[np.float64]

STEP_DEG = 0.25
"""Spacing of the measured skyline over the azimuth."""
BINS = int(360 / STEP_DEG)


@dataclass(frozen=True)
class FrameContour:
    """One frame's contour: rays (n, 3) in the camera frame and the contour's sigma (n,) in radians, seen from the camera."""

    frame: FrameObservation
    rays: Floats
    sigma_rad: Floats

    def directions(self, azimuth_deg: float, tilt_deg: float, roll_deg: float) -> tuple[Floats, Floats]:
        """Azimuth and elevation in radians (n,) of the contour's points, were the camera's attitude this."""
        vectors = self.rays @ camera_to_world(azimuth_deg, tilt_deg, roll_deg).T
        return np.arctan2(vectors[:, 0], vectors[:, 1]), np.arcsin(np.clip(vectors[:, 2], -1.0, 1.0))


def frame_contour(frame: FrameObservation) -> FrameContour:
    """The contour's points as rays; the angle that a pixel subtends is that at the point itself."""
    rays = pixel_rays(frame.camera, frame.u_px, frame.v_px)
    above = pixel_rays(frame.camera, frame.u_px, frame.v_px - 1.0)
    rad_per_px = np.linalg.norm(rays - above, axis=1)
    return FrameContour(frame, rays, frame.sigma_px * rad_per_px)


@dataclass(frozen=True)
class MeasuredSkyline:
    """The skyline of all frames over the measured azimuth, in bins of STEP_DEG whose centres are whole multiples of it.

    ``elevation_deg`` (BINS,): NaN where no frame has a contour. ``sigma_deg`` (BINS,): its standard deviation, from the
    contour's noise, the tilt and roll errors, and the azimuth errors times the slope. ``slope`` (BINS,): degrees of elevation
    per degree of azimuth. ``centres_deg``: measured azimuth of each frame's principal point, by label.
    """

    elevation_deg: Floats
    sigma_deg: Floats
    slope: Floats
    centres_deg: dict[str, float]


def measured_skyline(observation: Observation, contours: tuple[FrameContour, ...]) -> MeasuredSkyline:
    """Merge the frames' contours into one function of the measured azimuth; the median of each bin suppresses outliers."""
    bins: list[list[tuple[float, float]]] = [[] for _ in range(BINS)]
    attitude_sigma = np.zeros(BINS)
    azimuth_sigma = np.zeros(BINS)
    centres: dict[str, float] = {}
    for contour in contours:
        frame = contour.frame
        azimuth, elevation = contour.directions(frame.azimuth_deg, frame.tilt_deg, frame.roll_deg)
        index = np.round(np.degrees(azimuth) / STEP_DEG).astype(int) % BINS
        for i, e, s in zip(index, np.degrees(elevation), np.degrees(contour.sigma_rad), strict=True):
            bins[i].append((e, s))
        offset_rad = np.radians((np.degrees(azimuth) - frame.azimuth_deg + 180.0) % 360.0 - 180.0)
        attitude_sigma[index] = np.hypot(
            frame.tilt_sigma_deg, frame.roll_sigma_deg * np.sin(np.abs(offset_rad))
        )
        azimuth_sigma[index] = frame.azimuth_sigma_deg
        centre = np.array([[frame.camera.cx_px, frame.camera.cy_px]])
        ray = pixel_rays(frame.camera, centre[:, 0], centre[:, 1])
        rotation = camera_to_world(frame.azimuth_deg, frame.tilt_deg, frame.roll_deg)
        centres[frame.label] = float(azimuth_elevation_deg(ray @ rotation.T)[0][0])

    elevation_deg = np.full(BINS, np.nan)
    noise = np.full(BINS, np.nan)
    for i, points in enumerate(bins):
        if points:
            e, s = np.array(points).T
            elevation_deg[i] = np.median(e)
            # The variance of the median of n Gaussian values is pi/2 times that of their mean.
            noise[i] = np.sqrt(np.pi / 2.0 if len(points) > 2 else 1.0) * np.mean(s) / np.sqrt(len(points))
    slope = _slope(elevation_deg)
    tilt_bias = observation.tilt_bias_sigma_deg
    sigma = np.sqrt(noise**2 + attitude_sigma**2 + tilt_bias**2 + (slope * azimuth_sigma) ** 2)
    return MeasuredSkyline(elevation_deg, sigma, slope, centres)


def _slope(elevation_deg: Floats) -> Floats:
    """Change of elevation per azimuth over two bins, 0 at the ends of a frame."""
    slope = (np.roll(elevation_deg, -1) - np.roll(elevation_deg, 1)) / (2.0 * STEP_DEG)
    return np.where(np.isfinite(slope), slope, 0.0)
