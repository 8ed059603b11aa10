"""The search for a program: a bundle, or contours that come from elsewhere, and a DEM."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from localizer.bundle import Bundle, Prior
from localizer.camera import camera_to_world, project
from localizer.dem.crs import wrapped_lon_deg
from localizer.dem.horizon import Terrain, at_rim, horizon
from localizer.dem.lattice import Dem
from localizer.dem.prepared import prepared
from localizer.observation import FrameObservation, Observation, PriorCircle
from localizer.search.answer import fix_of, metric_covariance
from localizer.search.contradiction import Settled, settle_frames
from localizer.search.details import FrameDetail, LocateDetails, LocateResult, SolvedErrors
from localizer.search.doubts import altitude_as_trusted, without_altimeter
from localizer.search.fit.refine import Refined
from localizer.search.locate import load_kernels, locate_bundle, observe
from localizer.search.locate import locate as locate_contours
from localizer.skyline.find import Skyline
from localizer.skyline.upright import frame_skyline

Floats = NDArray[np.float64]

STEP_DEG = 0.05
"""Between the points of a predicted skyline."""
BESIDE_DEG = 5.0
"""A predicted skyline is computed so far beyond the outermost points of a contour."""

NO_MEASUREMENT = "measurement: is a {}; give a Bundle, as load_bundle reads it, or an Observation"


def locate(
    measurement: Bundle | Observation,
    dem: Dem,
    *,
    prior: PriorCircle | None = None,
    name: str = "observation",
) -> LocateResult:
    """Search a DEM for the place from which the terrain has the measured skyline.

    Parameters
    ----------
    measurement : Bundle or Observation
        A bundle, in whose pictures the skylines are found first, or contours that you have found yourself.
    dem : Dem
        The elevation model. Its error, where you know it, is an option of `load_dem`.
    prior : PriorCircle, optional
        Search only within this circle. It takes the place of the measurement's own prior.
    name : str, optional
        What the result calls an observation; a bundle goes by its id.

    Returns
    -------
    LocateResult
        The fix, and what led to it.

    Raises
    ------
    BundleError
        A picture of the bundle cannot be read.
    TypeError
        The measurement is something else, as the name of a bundle.

    See Also
    --------
    Tracker : For several bundles of a drive.
    observation_from_bundle : The contours of a bundle, to be changed before the search.

    Notes
    -----
    Look at ``result.fix.status`` before you use a position. Only ``fix`` says that one place stands out; ``ambiguous`` has
    several candidates, ``none`` has no position. A frame that contradicts all others is left out, if there are three or more.

    The method is that of Talluri and Aggarwal, "Position Estimation for an Autonomous Mobile Robot in an Outdoor
    Environment", 1992, with a robust fit of position, biases and DEM error in place of its grid search; see "How it works" in
    the documentation.

    Examples
    --------
    >>> dem = localizer.load_dem("terrain.tif")
    >>> result = localizer.locate(localizer.load_bundle("bundles/first"), dem)
    >>> result.fix.status
    'fix'
    >>> truth = localizer.load_truth("truth.json")
    >>> truth.distance_m(result.fix.position, dem) < 5.0
    True
    """
    if isinstance(measurement, Bundle):
        if prior is not None:
            circle = Prior(
                lat_deg=prior.lat_deg, lon_deg=wrapped_lon_deg(prior.lon_deg), radius_m=prior.radius_m
            )
            measurement = measurement.model_copy(update={"prior": circle})
        return locate_bundle(measurement, dem)
    if not isinstance(measurement, Observation):
        raise TypeError(NO_MEASUREMENT.format(type(measurement).__name__))
    terrain = prepared(dem)
    load_kernels(terrain)
    observation = altitude_as_trusted(
        measurement if prior is None else replace(measurement, prior=prior), dem
    )
    located = locate_contours(terrain, observation)
    settled = settle_frames(
        terrain, observation, located, lambda fewer: locate_contours(terrain, fewer, everywhere=False)
    )
    fix = fix_of(terrain, observation, settled.located, name, located.timing_s)
    fix = without_altimeter(
        terrain, observation, fix, lambda blind: locate_contours(terrain, blind, everywhere=False)
    )
    return LocateResult(fix, _details(terrain, observation, settled))


def observation_from_bundle(bundle: Bundle, skylines: Sequence[Skyline] | None = None) -> Observation:
    """Take the contours of a bundle, and its readings, as the search is given them.

    Parameters
    ----------
    bundle : Bundle
        The measurement.
    skylines : sequence of Skyline, optional
        One for each frame, in the bundle's order, as from a finder of your own; by default `find_skyline` looks for them. The
        picture of a frame whose roll is nearest to 90, 180 or 270 degrees counts as turned upright.

    Returns
    -------
    Observation
        Of each frame the columns whose state is ``OK`` and whose confidence is at least 0.5.

    Raises
    ------
    BundleError
        A picture of the bundle cannot be read.
    ValueError
        There are more or fewer skylines than frames.

    Examples
    --------
    >>> observation = localizer.observation_from_bundle(localizer.load_bundle("bundles/first"))
    >>> [(frame.label, frame.v_px.shape) for frame in observation.frames]
    [('N', (640,)), ('E', (640,)), ('S', (640,)), ('W', (640,))]
    """
    found = [frame_skyline(bundle, frame) for frame in bundle.frames] if skylines is None else list(skylines)
    if len(found) != len(bundle.frames):
        raise ValueError(f"skylines: are {len(found)} for {len(bundle.frames)} frames; give one for each")
    return observe(bundle, found)


def _details(terrain: Terrain, observation: Observation, settled: Settled) -> LocateDetails:
    located = settled.located
    best = located.best
    solved = iter(best.frame_errors_deg) if best is not None else iter(())
    frames = []
    for frame in observation.frames:
        left_out = frame.label == settled.left_out
        own = None if best is None or left_out or len(frame.u_px) < 2 else next(solved)
        u_px, v_px, edge_share = np.zeros(0), np.zeros(0), 0.0
        if best is not None and len(frame.u_px):
            u_px, v_px, edge_share = _predicted(terrain, frame, best, np.zeros(3) if own is None else own)
        frames.append(
            FrameDetail(
                label=frame.label,
                found_u_px=frame.u_px,
                found_v_px=frame.v_px,
                used=np.ones(len(frame.u_px), bool),
                predicted_u_px=u_px,
                predicted_v_px=v_px,
                errors_deg=None if own is None else (float(own[0]), float(own[1]), float(own[2])),
                agreement=settled.agreement.get(frame.label),
                left_out=left_out,
                rim_share=edge_share,
            )
        )
    candidates = located.decision.candidates
    errors = None
    if best is not None:
        errors = SolvedErrors(
            altitude_m=best.altitude_m,
            dem_error_m=best.dem_error_m,
            correlation_columns=best.correlation_columns,
            inlier_share=best.inlier_share,
            prior_chi2=best.prior_chi2,
            evidence=best.evidence,
        )
    return LocateDetails(
        frames=tuple(frames),
        survivors=located.stage1.survivors,
        candidates_rowcol=np.array([[c.row, c.col] for c in candidates]).reshape(-1, 2),
        candidate_covariances_m2=np.array([metric_covariance(terrain, c) for c in candidates]).reshape(
            -1, 2, 2
        ),
        errors=errors,
    )


def _predicted(
    terrain: Terrain, frame: FrameObservation, best: Refined, own_errors_deg: Floats
) -> tuple[Floats, Floats, float]:
    """The skyline from the place found, u and v in pixels from the contour's first to its last column; the share of it that
    lies where the DEM ends."""
    camera = frame.camera
    attitude = (
        frame.azimuth_deg - best.azimuth_bias_deg - own_errors_deg[0],
        frame.tilt_deg - best.tilt_bias_deg - own_errors_deg[1],
        frame.roll_deg - own_errors_deg[2],
    )
    aside_px = float(np.abs(frame.u_px - camera.cx_px).max())
    half_view_deg = float(np.degrees(np.arctan(aside_px / camera.fx_px))) + BESIDE_DEG
    azimuth_deg = attitude[0] + np.arange(-half_view_deg, half_view_deg, STEP_DEG)
    elevation_deg, distance_m = horizon(terrain, best.row, best.col, best.altitude_m, azimuth_deg)
    u_px, v_px = project(camera, camera_to_world(*attitude), azimuth_deg, elevation_deg[0])
    inside = (u_px >= frame.u_px.min() - 1.0) & (u_px <= frame.u_px.max() + 1.0)
    edge_share = 0.0
    if inside.any() and not terrain.exact:
        azimuth_rad = np.radians(azimuth_deg[inside])
        edge_share = float(at_rim(terrain, best.row, best.col, azimuth_rad, distance_m[0][inside]).mean())
    return u_px[inside], v_px[inside], edge_share
