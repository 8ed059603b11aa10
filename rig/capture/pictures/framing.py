"""Tilt correction that brings the whole skyline into the picture, away from its edges."""

import math

import numpy as np

from localizer.skyline.find import CONFIDENT, ColumnState, Skyline

EXTENT_PERCENT = (2.0, 98.0)  # a bush or a pole may stick out
BEYOND_EDGE = 0.1  # of the height: assumed distance of a skyline outside the picture
COLUMNS_NEEDED = 0.1  # of the width
CENTRED = 0.05  # of the height: tolerance for a skyline that does not fit


def tilt_correction_deg(
    skyline: Skyline, fy_px: float, height_px: int, margin_fraction: float
) -> float | None:
    """Tilt to add; 0 if the skyline is well placed, None without a skyline.

    Well placed: ``margin_fraction`` of the height away from the upper and lower edge. A skyline too high for that gets
    its median into the middle.
    """
    confident = (skyline.state == ColumnState.OK) & (skyline.confidence >= CONFIDENT)
    rows = np.concatenate(
        [
            skyline.row_px[confident],
            np.full(np.count_nonzero(skyline.state == ColumnState.NO_SKY), -BEYOND_EDGE * height_px),
            np.full(np.count_nonzero(skyline.state == ColumnState.NO_TERRAIN), (1 + BEYOND_EDGE) * height_px),
        ]
    )
    if len(rows) < COLUMNS_NEEDED * len(skyline.row_px):
        return None
    top, bottom = np.percentile(rows, EXTENT_PERCENT)
    usable_px = (1.0 - 2.0 * margin_fraction) * height_px
    if margin_fraction * height_px <= top and bottom <= (1.0 - margin_fraction) * height_px:
        return 0.0
    fits = bottom - top <= usable_px
    shift_px = (height_px - 1) / 2 - float((top + bottom) / 2 if fits else np.median(rows))
    if not fits and abs(shift_px) < CENTRED * height_px:
        return 0.0
    # Tilting up moves the skyline down the picture, to higher rows.
    return math.degrees(math.atan(shift_px / fy_px))


def confident_fraction(skyline: Skyline) -> float:
    """Share of columns with a confident skyline."""
    confident = (skyline.state == ColumnState.OK) & (skyline.confidence >= CONFIDENT)
    return float(np.mean(confident))


def state_counts(skyline: Skyline) -> dict[str, int]:
    """Number of columns in each state, by its name in lower case."""
    return {state.name.lower(): int(np.count_nonzero(skyline.state == state)) for state in ColumnState}
