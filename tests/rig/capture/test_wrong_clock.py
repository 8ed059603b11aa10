"""A wrong wall clock is reported, and no capture is refused for it."""

from datetime import UTC, datetime
from pathlib import Path

import pytest

from rig import clock
from rig.attitude.magnetic_model import date_problem, model_field
from rig.check import devices
from rig.config.sections import Place


@pytest.mark.parametrize(
    ("now", "said"),
    [
        (datetime(1970, 1, 1, 0, 2, tzinfo=UTC), "the computer's clock says 1970-01-01 00:02 UTC"),
        (datetime(2016, 11, 3, 17, 17, tzinfo=UTC), "the computer's clock says 2016-11-03 17:17 UTC"),
        (datetime(2106, 2, 7, 6, 28, tzinfo=UTC), "the computer's clock says 2106-02-07 06:28 UTC"),
        (datetime(2026, 11, 30, tzinfo=UTC), None),
    ],
)
def test_an_implausible_clock_is_reported(now: datetime, said: str | None) -> None:
    assert clock.problem(now) == said


@pytest.mark.parametrize("year", [1, 1970, 2024, 2030, 2031, 9999])
def test_the_magnetic_model_gives_the_nearest_date_for_any(year: int) -> None:
    field = model_field(Place(lat_deg=47.0, lon_deg=8.0), datetime(year, 6, 1, tzinfo=UTC))
    assert field.declination_deg == pytest.approx(3.6, abs=0.4)
    assert field.problem == date_problem(datetime(year, 6, 1, tzinfo=UTC))
    assert field.problem is not None
    assert 0.3 < field.date_sigma_deg < 1.0


def test_a_right_date_has_no_problem() -> None:
    field = model_field(Place(lat_deg=47.0, lon_deg=8.0), datetime(2026, 6, 1, tzinfo=UTC))
    assert (field.problem, field.date_sigma_deg) == (None, 0.0)


@pytest.mark.parametrize(
    ("offset_s", "said"),
    [
        (0.0, None),
        (-1.79e9, "the computer's clock says 19"),
        (2.0e8, "after the World Magnetic Model's years"),
    ],
)
def test_rig_check_has_a_row_for_a_clock_that_is_wrong(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, offset_s: float, said: str | None
) -> None:
    offset = tmp_path / "offset"
    offset.write_text(str(offset_s))
    monkeypatch.setenv(clock.OFFSET_VARIABLE, str(offset))
    rows = devices.check_clock()
    assert len(rows) == (said is not None)
    if said:
        assert said in (rows[0].problem or "")
        assert "set it: from a GPS" in (rows[0].problem or "")
