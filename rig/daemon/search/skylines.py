"""The skylines over a bundle's frames, as they are kept beside its answer: what the picture shows, what the terrain would.

Lines are in pixels of the frame as recorded (pixel centres at whole numbers), broken where the skyline is.
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
"""So far past the picture's edges the terrain is looked at, for what a roll brings in."""
COLUMNS_EVERY, PREDICTED_EVERY = 2, 4
"""Of the columns found and the azimuths predicted, so many are enough for an eye."""
FILE_NAME = "skylines.json"
"""In the bundle's folder, once it has been located."""


class FrameSkylines(BaseModel):
    """One frame's."""

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)

    label: str
    width_px: int
    height_px: int
    found: tuple[Line, ...]
    """In the picture, as the search used it."""
    doubtful: tuple[Line, ...]
    """In the picture, too doubtful for the search."""
    predicted: tuple[Line, ...]
    """The terrain's, seen from the answer's position; empty where there is none."""


class BundleSkylines(BaseModel):
    """All frames', in the bundle's order."""

    model_config = ConfigDict(frozen=True)

    bundle: str
    frames: tuple[FrameSkylines, ...]


def bundle_skylines(
    bundle: Bundle, skylines: Sequence[Skyline], fix: Fix, terrain: Terrain
) -> BundleSkylines:
    """What belongs over the frames of ``bundle``, in which ``skylines`` were found, once ``fix`` is its answer.

    The prediction turns each frame by the errors that are common to all; a frame's own, a hundredth of a degree or
    two, stay as a shift between the lines.
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
    """The runs of chosen points that are somewhere; of each run the ends and every so manieth between."""
    shown = chosen & np.isfinite(u_px) & np.isfinite(v_px)
    edges = np.flatnonzero(np.diff(np.concatenate(([False], shown, [False])).astype(np.int8)))
    lines = []
    for begin, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        if end - begin > 1:
            kept = sorted({*range(begin, end, every), end - 1})
            lines.append(tuple((round(float(u_px[i]), 1), round(float(v_px[i]), 1)) for i in kept))
    return tuple(lines)
