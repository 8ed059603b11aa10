"""Skylines of a bundle's frames, found and predicted, stored beside its answer.

Lines are in pixels of the recorded frame (pixel centres at whole numbers), split where the skyline has gaps.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from localizer.bundle import Bundle, Frame
from localizer.camera import camera_to_world, project
from localizer.dem.horizon import Terrain, horizon
from localizer.fix import Fix
from localizer.skyline.find import CONFIDENT, ColumnState, Skyline
from localizer.skyline.upright import upright

Floats = NDArray[np.float64]
Line = tuple[tuple[float, float], ...]
"""Points u, v from left to right, two or more."""

AZIMUTH_STEP_DEG = 0.05
BEYOND_DEG = 5.0
"""Margin beyond the picture's edges, for what a roll brings into view."""
COLUMNS_EVERY, PREDICTED_EVERY = 2, 4
"""Every n-th found column and predicted azimuth is enough for display."""
FILE_NAME = "skylines.json"
"""File in the bundle's folder, once it is located."""


class FrameSkylines(BaseModel):
    """The skylines of one frame."""

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)

    label: str
    width_px: int
    height_px: int
    found: tuple[Line, ...]
    """Found in the picture and used by the search."""
    doubtful: tuple[Line, ...]
    """Found in the picture, but too uncertain for the search."""
    predicted: tuple[Line, ...]
    """Predicted from the terrain at the answer's position; empty without one."""


class BundleSkylines(BaseModel):
    """The skylines of all frames, in the bundle's order."""

    model_config = ConfigDict(frozen=True)

    bundle: str
    frames: tuple[FrameSkylines, ...]


def bundle_skylines(
    bundle: Bundle, skylines: Sequence[Skyline], fix: Fix, terrain: Terrain
) -> BundleSkylines:
    """The skylines of ``bundle``, in which ``skylines`` were found, for the answer ``fix``.

    The prediction applies the solved errors common to all frames. A frame's own error, a hundredth of a degree or two,
    remains as an offset.
    """
    frames = []
    for frame, skyline in zip(bundle.frames, skylines, strict=True):
        columns = np.arange(skyline.row_px.size, dtype=np.float64)
        found = upright(bundle.camera, frame.roll_deg).as_recorded(columns, skyline.row_px)
        used = (skyline.state == ColumnState.OK) & (skyline.confidence >= CONFIDENT)
        frames.append(
            FrameSkylines(
                label=frame.label,
                width_px=bundle.camera.width_px,
                height_px=bundle.camera.height_px,
                found=_lines(*found, used, COLUMNS_EVERY),
                doubtful=_lines(*found, ~used, COLUMNS_EVERY),
                predicted=_predicted(bundle, frame, fix, terrain),
            )
        )
    return BundleSkylines(bundle=bundle.id, frames=tuple(frames))


def _predicted(bundle: Bundle, frame: Frame, fix: Fix, terrain: Terrain) -> tuple[Line, ...]:
    if fix.position is None or fix.nuisance is None:
        return ()
    turned = upright(bundle.camera, frame.roll_deg)
    camera = turned.camera
    altitude_m = fix.position.ground_m + bundle.mast_height_m
    if bundle.altitude is not None:
        altitude_m = bundle.altitude.value_m - fix.nuisance.altitude_bias_m
    attitude_deg = (
        frame.azimuth_deg - fix.nuisance.azimuth_bias_deg,
        frame.tilt_deg - fix.nuisance.tilt_bias_deg,
        turned.roll_deg,
    )
    half_view_deg = float(np.degrees(np.arctan(camera.width_px / camera.fx_px))) + BEYOND_DEG
    azimuth_deg = attitude_deg[0] + np.arange(-half_view_deg, half_view_deg, AZIMUTH_STEP_DEG)
    elevation_deg, _ = horizon(terrain, fix.position.row, fix.position.col, altitude_m, azimuth_deg)
    u_px, v_px = project(camera, camera_to_world(*attitude_deg), azimuth_deg, elevation_deg[0])
    inside = (u_px >= -1.0) & (u_px <= camera.width_px)
    return _lines(*turned.as_recorded(u_px, v_px), inside, PREDICTED_EVERY)


def _lines(u_px: Floats, v_px: Floats, chosen: NDArray[np.bool_], every: int) -> tuple[Line, ...]:
    """Runs of chosen finite points; each with its ends and every n-th point between."""
    shown = chosen & np.isfinite(u_px) & np.isfinite(v_px)
    edges = np.flatnonzero(np.diff(np.concatenate(([False], shown, [False])).astype(np.int8)))
    lines = []
    for begin, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        if end - begin > 1:
            kept = sorted({*range(begin, end, every), end - 1})
            lines.append(tuple((round(float(u_px[i]), 1), round(float(v_px[i]), 1)) for i in kept))
    return tuple(lines)
