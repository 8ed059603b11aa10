"""Details of a result: found and predicted skylines of each frame, cells left by stage 1, candidates and estimated errors."""

import numpy as np
from numpy.typing import NDArray

from localizer.bundle import Bundle
from localizer.camera import camera_to_world, project
from localizer.dem.horizon import Terrain, at_dem_edge, horizon
from localizer.observation import FrameObservation, Observation
from localizer.search.answer import metric_covariance
from localizer.search.details import FrameDetail, LocateDetails, SolvedErrors
from localizer.search.fit.refine import Refined
from localizer.search.leave_one_out import CheckedAnswer
from localizer.skyline.find import CONFIDENT, ColumnState, Skyline
from localizer.skyline.upright import upright

Floats = NDArray[np.float64]
OwnErrors = tuple[float, float, float]

STEP_DEG = 0.05
"""Between the points of a predicted skyline."""
MARGIN_DEG = 5.0
"""A predicted skyline is computed so far beyond the sides of the view."""


def usable_columns(skyline: Skyline) -> NDArray[np.bool_]:
    """Mask of the columns of a skyline that the search uses."""
    return np.asarray(
        (skyline.state == ColumnState.OK) & (skyline.confidence >= CONFIDENT) & np.isfinite(skyline.row_px)
    )


def details_of(
    terrain: Terrain,
    bundle: Bundle,
    observation: Observation,
    skylines: list[Skyline],
    checked: CheckedAnswer,
) -> LocateDetails:
    """Found and predicted skylines of a bundle's frames, as recorded; cells left by stage 1, and candidates."""
    frames = []
    estimated = _estimated_errors(observation, checked)
    for recorded, frame, skyline, own in zip(
        bundle.frames, observation.frames, skylines, estimated, strict=True
    ):
        turned = upright(bundle.camera, recorded.roll_deg)
        width_px = turned.camera.width_px
        found = np.isfinite(skyline.row_px)
        half_view_deg = float(np.degrees(np.arctan(width_px / turned.camera.fx_px))) + MARGIN_DEG
        u_px, v_px, edge_share = _predicted(
            terrain, frame, checked.located.best, own, half_view_deg, (-1.0, width_px)
        )
        found_u_px, found_v_px = turned.as_recorded(np.nonzero(found)[0].astype(float), skyline.row_px[found])
        u_px, v_px = turned.as_recorded(u_px, v_px)
        frames.append(
            FrameDetail(
                label=frame.label,
                found_u_px=found_u_px,
                found_v_px=found_v_px,
                used=usable_columns(skyline)[found],
                predicted_u_px=u_px,
                predicted_v_px=v_px,
                errors_deg=own,
                agreement=checked.agreement.get(frame.label),
                left_out=frame.label == checked.left_out,
                dem_edge_share=edge_share,
                quarter_turns=turned.quarter_turns,
            )
        )
    return _details(terrain, checked, frames)


def details_of_contours(terrain: Terrain, observation: Observation, checked: CheckedAnswer) -> LocateDetails:
    """The same without pictures: the predicted skyline reaches from each contour's first column to its last."""
    frames = []
    for frame, own in zip(observation.frames, _estimated_errors(observation, checked), strict=True):
        u_px, v_px, edge_share = np.zeros(0), np.zeros(0), 0.0
        if len(frame.u_px):
            aside_px = float(np.abs(frame.u_px - frame.camera.cx_px).max())
            half_view_deg = float(np.degrees(np.arctan(aside_px / frame.camera.fx_px))) + MARGIN_DEG
            columns = float(frame.u_px.min()) - 1.0, float(frame.u_px.max()) + 1.0
            u_px, v_px, edge_share = _predicted(
                terrain, frame, checked.located.best, own, half_view_deg, columns
            )
        frames.append(
            FrameDetail(
                label=frame.label,
                found_u_px=frame.u_px,
                found_v_px=frame.v_px,
                used=np.ones(len(frame.u_px), bool),
                predicted_u_px=u_px,
                predicted_v_px=v_px,
                errors_deg=own,
                agreement=checked.agreement.get(frame.label),
                left_out=frame.label == checked.left_out,
                dem_edge_share=edge_share,
            )
        )
    return _details(terrain, checked, frames)


def _estimated_errors(observation: Observation, checked: CheckedAnswer) -> list[OwnErrors | None]:
    """Each frame's own errors of azimuth, tilt and roll, degrees; None where they were not estimated."""
    best = checked.located.best
    errors = iter(best.frame_errors_deg) if best is not None else iter(())
    estimated: list[OwnErrors | None] = []
    for frame in observation.frames:
        if best is None or len(frame.u_px) < 2 or frame.label == checked.left_out:
            estimated.append(None)
        else:
            azimuth, tilt, roll = next(errors)
            estimated.append((float(azimuth), float(tilt), float(roll)))
    return estimated


def _predicted(
    terrain: Terrain,
    frame: FrameObservation,
    best: Refined | None,
    own_errors_deg: OwnErrors | None,
    half_view_deg: float,
    columns_px: tuple[float, float],
) -> tuple[Floats, Floats, float]:
    """The skyline from the place found between two columns, u and v in pixels; its share that lies at the DEM edge."""
    if best is None:
        return np.zeros(0), np.zeros(0), 0.0
    own = own_errors_deg or (0.0, 0.0, 0.0)
    attitude = (
        frame.azimuth_deg - best.azimuth_bias_deg - own[0],
        frame.tilt_deg - best.tilt_bias_deg - own[1],
        frame.roll_deg - own[2],
    )
    azimuth_deg = attitude[0] + np.arange(-half_view_deg, half_view_deg, STEP_DEG)
    elevation_deg, distance_m = horizon(terrain, best.row, best.col, best.altitude_m, azimuth_deg)
    u_px, v_px = project(frame.camera, camera_to_world(*attitude), azimuth_deg, elevation_deg[0])
    inside = (u_px >= columns_px[0]) & (u_px <= columns_px[1])
    edge_share = 0.0
    if inside.any() and not terrain.exact:
        azimuth_rad = np.radians(azimuth_deg[inside])
        edge_share = float(
            at_dem_edge(terrain, best.row, best.col, azimuth_rad, distance_m[0][inside]).mean()
        )
    return u_px[inside], v_px[inside], edge_share


def _details(terrain: Terrain, checked: CheckedAnswer, frames: list[FrameDetail]) -> LocateDetails:
    located = checked.located
    candidates = located.decision.candidates
    return LocateDetails(
        tuple(frames),
        located.stage1.survivors,
        np.array([[c.row, c.col] for c in candidates]).reshape(-1, 2),
        np.array([metric_covariance(terrain, c) for c in candidates]).reshape(-1, 2, 2),
        None if located.best is None else _solved_errors(located.best),
    )


def _solved_errors(best: Refined) -> SolvedErrors:
    return SolvedErrors(
        altitude_m=best.altitude_m,
        dem_error_m=best.dem_error_m,
        correlation_columns=best.correlation_columns,
        inlier_share=best.inlier_share,
        prior_chi2=best.prior_chi2,
        evidence=best.evidence,
    )
