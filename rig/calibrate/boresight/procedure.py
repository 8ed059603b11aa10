"""Boresight calibration at a known place, and the check whether a calibration still holds."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from localizer.observation import NO_COMPASS_SIGMA_DEG
from rig.attitude.kinematics import Attitude, wrapped_deg
from rig.calibrate.boresight.fit import BoresightFit, fit_boresight
from rig.calibrate.boresight.horizon_profile import STEP_DEG, HorizonProfile, horizon_profile
from rig.calibrate.boresight.known_place import KnownPlace, PlaceSigmas
from rig.calibrate.boresight.skyline_survey import head_attitude, require_unmoved, survey_skyline
from rig.calibrate.figures import new_figure
from rig.calibrate.run import CalibrationRun
from rig.capture.base_attitude import estimate_base, measure_base
from rig.config.calibration_files import BoresightCalibration, Matrix
from rig.config.directions import parse_direction
from rig.config.model import RigConfig
from rig.devices.connect import connect

Vector = NDArray[np.float64]

ACCEPTED_SIGMAS = 3.0
CHECK_DIRECTIONS = 8
NEGLIGIBLE_DEG = (0.15, 0.03, 0.08)
"""Differences below these (azimuth, tilt, roll) are accepted even if they are significant."""


@dataclass(frozen=True)
class Offset:
    """Difference of one angle from the calibration, its sigma, and whether it is acceptable."""

    name: str
    off_deg: float
    sigma_deg: float
    holds: bool


def calibrate_boresight(run: CalibrationRun, place: KnownPlace, sigmas: PlaceSigmas, directions: int) -> None:
    """Guide the operator, measure, fit and write. ``CalibrationError`` says why a result is rejected."""
    run.guide.ready("Park exactly at the known place, with a clear view of the ridges all round.")
    fit, profile, device = measure_boresight(run.config, place, sigmas, directions, run.guide.say)
    found, compass = fit.boresight, run.config.compass
    # Added to the offset that is already configured.
    heading_offset_deg = (
        wrapped_deg(compass.heading_offset_deg + fit.heading_offset_deg) if compass is not None else None
    )
    document = BoresightCalibration(
        **run.header("boresight", device),
        azimuth_deg=found.azimuth_deg,
        tilt_deg=found.tilt_deg,
        roll_deg=found.roll_deg,
        heading_offset_deg=heading_offset_deg,
        covariance_deg2=_matrix(fit.covariance_deg2),
        fit={
            "lat_deg": place.lat_deg,
            "lon_deg": place.lon_deg,
            "points": len(fit.residual_deg),
            "misfit_deg": fit.misfit_deg,
            "misfit_sigmas": fit.misfit_sigmas,
            "dem_factor": fit.dem_factor,
            "off_m": list(fit.off_m),
        },
    )
    sigma = np.sqrt(np.diag(fit.covariance_deg2))
    east_m, north_m, up_m = fit.off_m
    rows = [
        ("camera in the head: azimuth, deg", f"{found.azimuth_deg:.3f}", f"{sigma[0]:.3f} with the heading"),
        ("tilt, deg", f"{found.tilt_deg:.3f}", f"{sigma[1]:.3f}"),
        ("roll, deg", f"{found.roll_deg:.3f}", f"{sigma[2]:.3f}"),
        ("heading: correction, deg", f"{fit.heading_offset_deg:.3f}", ""),
        ("place, m (east, north, up)", f"{east_m:.1f}, {north_m:.1f}, {up_m:.1f}", "from what was given"),
        ("misfit, deg", f"{fit.misfit_deg:.3f}", f"{len(fit.residual_deg)} points"),
        ("DEM's ridges, m", "", f"{sigmas.dem_m * fit.dem_factor:.1f} as the skyline has it"),
    ]
    run.finish(document, rows, draw(fit, profile))


def measure_boresight(
    config: RigConfig,
    place: KnownPlace,
    sigmas: PlaceSigmas,
    directions: int,
    say: Callable[[str], None],
) -> tuple[BoresightFit, HorizonProfile, str]:
    """Survey the skyline and fit; returns also the DEM's skyline and the camera's identity."""
    profile = horizon_profile(place, place.ground_m + config.rig.mast_height_m)
    around = [parse_direction(str(i * 360.0 / directions)) for i in range(directions)]
    with connect(config) as rig:
        base_estimate = measure_base(rig)
        say(
            f"vehicle: heading {base_estimate.attitude.azimuth_deg:.1f} +- {base_estimate.heading.sigma_deg:.1f} deg"
        )
        frames, views = survey_skyline(rig, base_estimate, around, say)
        after = measure_base(rig)
        device = rig.camera.identify()
    require_unmoved(base_estimate, after)
    whole = estimate_base(config, [*base_estimate.stops, *after.stops], base_estimate.raw["compass"], views)
    frames = [
        replace(frame, head=head_attitude(whole, view)) for frame, view in zip(frames, views, strict=True)
    ]
    camera = config.camera
    start = Attitude(camera.boresight_azimuth_deg, camera.boresight_tilt_deg, camera.boresight_roll_deg)
    return (
        fit_boresight(frames, profile, start, whole.heading.sigma_deg, sigmas),
        profile,
        device,
    )


def check_boresight(config: RigConfig, place: KnownPlace, sigmas: PlaceSigmas) -> list[Offset]:
    """Survey the skyline at a known place and compare. ``CalibrationError`` if the skyline does not determine the
    angles.
    """
    fit, _, _ = measure_boresight(config, place, sigmas, CHECK_DIRECTIONS, lambda line: None)
    return offsets(
        config, fit, config.compass.azimuth_bias_sigma_deg if config.compass else NO_COMPASS_SIGMA_DEG
    )


def offsets(config: RigConfig, fit: BoresightFit, heading_sigma_deg: float) -> list[Offset]:
    """Differences between the skyline and the calibration in force. The compass's sigma is allowed for in azimuth."""
    camera = config.camera
    azimuth_deg = fit.boresight.azimuth_deg + fit.heading_offset_deg - camera.boresight_azimuth_deg
    off_deg = (
        wrapped_deg(azimuth_deg),
        fit.boresight.tilt_deg - camera.boresight_tilt_deg,
        wrapped_deg(fit.boresight.roll_deg - camera.boresight_roll_deg),
    )
    trusted_deg = (
        float(np.hypot(heading_sigma_deg, camera.boresight_azimuth_sigma_deg)),
        camera.boresight_tilt_sigma_deg,
        camera.boresight_roll_sigma_deg,
    )
    found = []
    for i, (name, off, trusted) in enumerate(
        zip(("azimuth", "tilt", "roll"), off_deg, trusted_deg, strict=True)
    ):
        sigma_deg = float(np.hypot(np.sqrt(fit.covariance_deg2[i, i]), trusted))
        found.append(
            Offset(name, off, sigma_deg, abs(off) <= max(ACCEPTED_SIGMAS * sigma_deg, NEGLIGIBLE_DEG[i]))
        )
    return found


def draw(fit: BoresightFit, profile: HorizonProfile) -> Figure:
    """The DEM's skyline with the observed points, and the residuals."""
    figure, (above, below) = new_figure(
        f"boresight: misfit {fit.misfit_deg:.3f} deg, {len(fit.residual_deg)} points", 2
    )
    step = 5
    azimuths = np.arange(0.0, 360.0, STEP_DEG)[::step]
    above.plot(azimuths, profile.elevation_deg[::step], "k-", lw=0.7, label="DEM")
    for number in np.unique(fit.frame):
        mine = fit.frame == number
        at = fit.azimuth_deg[mine] % 360.0
        above.plot(at, fit.elevation_deg[mine], ".", ms=3)
        below.plot(at, fit.residual_deg[mine], ".", ms=3)
    above.set_ylabel("elevation, deg")
    above.legend()
    limit = max(6.0 * fit.misfit_deg, 0.05)
    below.set_ylim(-limit, limit)
    below.axhline(0.0, color="0.5", lw=0.8)
    below.set_ylabel("left after the fit, deg")
    for axes in (above, below):
        axes.set_xlabel("azimuth, deg")
    return figure


def _matrix(rows: Vector) -> Matrix:
    (a, b, c), (d, e, f), (g, h, i) = rows.tolist()
    return (a, b, c), (d, e, f), (g, h, i)
