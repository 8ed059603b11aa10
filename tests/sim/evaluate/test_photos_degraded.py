"""Pictures made harder keep a truth that is theirs."""

import numpy as np
import pytest

from sim.evaluate.photos.degraded_pictures import DEGRADATIONS, degraded_pictures
from sim.evaluate.photos.traced_pictures import HELD_OUT, TUNED_ON, TracedPicture

WIDTH, HEIGHT = 400, 300
BESIDE_PX = 6


def picture(half: str = TUNED_ON) -> TracedPicture:
    """A dark ridge under a bright sky; the truth is unknown at the left."""
    row = 150.0 + 20.0 * np.sin(np.arange(WIDTH) / 40.0)
    image = np.where(np.arange(HEIGHT)[:, None] + 0.5 > row, 70, 210).astype(np.uint8)
    row[:20] = np.nan
    return TracedPicture("made", "ridge", half, np.repeat(image[..., None], 3, axis=2), row)


@pytest.mark.parametrize(
    "name", [n for n in DEGRADATIONS if n not in ("haze that thickens towards the skyline, to 75 %",)]
)
def test_the_truth_lies_between_sky_and_terrain_whatever_was_done(name: str) -> None:
    (degraded,) = [picture for change, picture in degraded_pictures([picture()]) if change == name]
    image, row = degraded.image_bgr.mean(axis=2), degraded.true_row_px
    assert image.shape[1] == len(row)
    inside = np.isfinite(row) & (row > BESIDE_PX) & (row < len(image) - BESIDE_PX - 1)
    assert inside.mean() > 0.5
    columns = np.flatnonzero(inside)
    at = np.round(row[columns]).astype(int)
    darker = image[at - BESIDE_PX, columns] > image[at + BESIDE_PX, columns] + 10.0
    assert darker.mean() > (0.7 if "sun" in name else 0.95)


def test_only_pictures_that_were_tuned_on_are_spoilt() -> None:
    assert list(degraded_pictures([picture(HELD_OUT)])) == []
    assert len(list(degraded_pictures([picture()] * 4))) == 2 * len(DEGRADATIONS)


def test_a_cloud_and_a_mast_leave_the_truth_unknown_where_they_hide_it() -> None:
    degraded = dict(degraded_pictures([picture()]))
    for name in ("cloud that lies on the ridge", "masts"):
        assert np.isnan(degraded[name].true_row_px).sum() > 22
