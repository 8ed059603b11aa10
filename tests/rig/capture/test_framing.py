"""Where to tilt for a skyline that lies well in the picture."""

import numpy as np
import pytest

from localizer.skyline.find import ColumnState, Skyline
from rig.capture.pictures.framing import confident_fraction, state_counts, tilt_correction_deg

FY_PX = 492.8
HEIGHT_PX = 480
WIDTH_PX = 640
MARGIN = 0.15


def skyline(rows: np.ndarray, state: ColumnState = ColumnState.OK, confidence: float = 0.9) -> Skyline:
    return Skyline(
        rows.astype(float),
        np.full(len(rows), 0.3),
        np.full(len(rows), confidence),
        np.full(len(rows), int(state), np.uint8),
    )


def joined(*parts: Skyline) -> Skyline:
    fields = ("row_px", "sigma_px", "confidence", "state")
    return Skyline(*(np.concatenate([getattr(part, name) for part in parts]) for name in fields))


def correction(line: Skyline) -> float | None:
    return tilt_correction_deg(line, FY_PX, HEIGHT_PX, MARGIN)


def test_a_skyline_within_the_margins_stays() -> None:
    assert correction(skyline(np.linspace(80, 400, WIDTH_PX))) == 0.0


def test_a_skyline_at_the_top_is_followed_upwards() -> None:
    found = correction(skyline(np.full(WIDTH_PX, 20.0)))
    assert found == pytest.approx(np.degrees(np.arctan((239.5 - 20.0) / FY_PX)))


def test_a_skyline_at_the_bottom_is_followed_downwards() -> None:
    found = correction(skyline(np.full(WIDTH_PX, 460.0)))
    assert found is not None
    assert found < 0


def test_terrain_above_the_picture_counts_as_high() -> None:
    hidden = skyline(np.full(300, np.nan), ColumnState.NO_SKY, 0.0)
    found = correction(joined(skyline(np.full(340, 100.0)), hidden))
    assert found is not None
    assert 15 < found < 30
    everything_hidden = correction(skyline(np.full(WIDTH_PX, np.nan), ColumnState.NO_SKY, 0.0))
    assert everything_hidden is not None
    assert everything_hidden > 25


def test_sky_down_to_the_lower_edge_counts_as_low() -> None:
    found = correction(skyline(np.full(WIDTH_PX, np.nan), ColumnState.NO_TERRAIN, 0.0))
    assert found is not None
    assert found < -25


def test_a_skyline_too_high_for_the_picture_is_centred_by_its_median() -> None:
    steep = np.concatenate([np.linspace(5, 100, 200), np.linspace(100, 475, 440)])
    found = correction(skyline(steep))
    assert found == pytest.approx(np.degrees(np.arctan((239.5 - np.median(steep)) / FY_PX)))
    centred = np.concatenate([np.full(200, 5.0), np.full(240, 240.0), np.full(200, 475.0)])
    assert correction(skyline(centred)) == 0.0


def test_a_pole_does_not_decide() -> None:
    rows = np.full(WIDTH_PX, 240.0)
    rows[100:106] = 3.0
    assert correction(skyline(rows)) == 0.0


def test_nothing_to_go_by() -> None:
    assert correction(skyline(np.full(WIDTH_PX, 240.0), ColumnState.DOUBTFUL, 0.2)) is None


def test_what_is_recorded() -> None:
    line = joined(skyline(np.full(480, 240.0)), skyline(np.full(160, np.nan), ColumnState.NO_SKY, 0.0))
    assert confident_fraction(line) == 0.75
    assert state_counts(line) == {"ok": 480, "no_sky": 160, "no_terrain": 0, "doubtful": 0}
