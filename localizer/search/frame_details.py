"""Details of a result: found and predicted skylines of each frame, cells left by stage 1, candidates and estimated errors."""

import numpy as np
from numpy.typing import NDArray

from localizer.bundle import Bundle
from localizer.camera import camera_to_world, project
from localizer.dem.horizon import Terrain, at_dem_edge, horizon
from localizer.observation import Observation
from localizer.search.answer import metric_covariance
from localizer.search.details import FrameDetail, LocateDetails, SolvedErrors
from localizer.search.fit.refine import Refined
from localizer.search.leave_one_out import CheckedAnswer
from localizer.skyline.find import CONFIDENT, ColumnState, Skyline
from localizer.skyline.upright import upright


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
    """Found and predicted skylines, cells left by stage 1, and candidates."""
    located = checked.located
    best = located.best
    errors = iter(best.frame_errors_deg) if best else iter(())
    frames = []
    for recorded, frame, skyline in zip(bundle.frames, observation.frames, skylines, strict=True):
        turned = upright(bundle.camera, recorded.roll_deg)
        camera = turned.camera
        found = np.isfinite(skyline.row_px)
        u = v = np.zeros(0)
        dem_edge_share = 0.0
        left_out = frame.label == checked.left_out
        solved = best is not None and len(frame.u_px) > 1 and not left_out
        own = next(errors) if solved else np.zeros(3)
        if best is not None:
            attitude = (
                frame.azimuth_deg - best.azimuth_bias_deg - own[0],
                frame.tilt_deg - best.tilt_bias_deg - own[1],
                frame.roll_deg - own[2],
            )
            half_view = np.degrees(np.arctan(camera.width_px / camera.fx_px)) + 5.0
            azimuth = attitude[0] + np.arange(-half_view, half_view, 0.05)
            elevation, distance_m = horizon(terrain, best.row, best.col, best.altitude_m, azimuth)
            u, v = project(camera, camera_to_world(*attitude), azimuth, elevation[0])
            inside = (u >= -1.0) & (u <= camera.width_px)
            u, v = u[inside], v[inside]
            if inside.any() and not terrain.exact:
                seen_m = distance_m[0][inside]
                dem_edge_share = float(
                    at_dem_edge(terrain, best.row, best.col, np.radians(azimuth[inside]), seen_m).mean()
                )
        found_u, found_v = turned.as_recorded(np.nonzero(found)[0].astype(float), skyline.row_px[found])
        u, v = turned.as_recorded(u, v)
        frames.append(
            FrameDetail(
                label=frame.label,
                found_u_px=found_u,
                found_v_px=found_v,
                used=usable_columns(skyline)[found],
                predicted_u_px=u,
                predicted_v_px=v,
                errors_deg=(float(own[0]), float(own[1]), float(own[2])) if solved else None,
                agreement=checked.agreement.get(frame.label),
                left_out=left_out,
                dem_edge_share=dem_edge_share,
                quarter_turns=turned.quarter_turns,
            )
        )
    candidates = located.decision.candidates
    return LocateDetails(
        tuple(frames),
        located.stage1.survivors,
        np.array([[c.row, c.col] for c in candidates]).reshape(-1, 2),
        np.array([metric_covariance(terrain, c) for c in candidates]).reshape(-1, 2, 2),
        None if best is None else _solved_errors(best),
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
