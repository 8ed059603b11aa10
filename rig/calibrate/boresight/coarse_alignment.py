"""Coarse alignment of observed points to a known skyline: the start of the fit, from any rotation."""

import numpy as np
from numpy.typing import NDArray

from rig.attitude.kinematics import Attitude
from rig.calibrate.boresight.horizon_profile import HorizonProfile
from rig.calibrate.boresight.skyline_frame import Points
from rig.config.calibration_files import CalibrationError

Vector = NDArray[np.float64]

STEP_DEG = 0.25
RIVAL_APART_DEG = 3.0
RIVAL_FACTOR = 1.3
ROUNDS = 4


def align_coarsely(
    points: Points, profile: HorizonProfile, start: Attitude, within_deg: float
) -> tuple[float, float, float]:
    """Rotation in azimuth, tilt and roll (degrees) that fits best, roughly. ``CalibrationError`` if two azimuths fit
    equally well.
    """
    azimuth, elevation = points.seen(start, np.zeros(len(points.frame)))
    design = np.column_stack([np.ones(len(azimuth)), np.degrees(points.across)])
    shifts = np.arange(-within_deg, within_deg + STEP_DEG / 2, STEP_DEG)
    scores, levels = [], []
    for shift in shifts:
        difference = profile.elevation(azimuth + shift) - elevation
        weights = np.ones(len(difference))
        for _ in range(ROUNDS):  # least absolute differences
            weighted = design * (weights**2)[:, None]
            level = np.linalg.solve(design.T @ weighted, weighted.T @ difference)
            off = np.abs(difference - design @ level)
            weights = 1.0 / np.sqrt(np.maximum(off, 0.02))
        scores.append(float(np.median(off)))
        levels.append(level)
    best = int(np.argmin(scores))
    rivals = np.abs((shifts - shifts[best] + 180.0) % 360.0 - 180.0) > RIVAL_APART_DEG
    if rivals.any() and np.array(scores)[rivals].min() < RIVAL_FACTOR * scores[best]:
        raise CalibrationError(
            "boresight: the skyline fits no one direction better than the others: this is another place than given, or too "
            "little of the ridge is seen; check --at, wait for better sight, or drive where the skyline is rugged"
        )
    # A roll to the right lowers the right side of the view, so the sign of the fit is reversed.
    return float(shifts[best]), float(levels[best][0]), -float(np.degrees(levels[best][1]))
