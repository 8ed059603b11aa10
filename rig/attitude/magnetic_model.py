"""The Earth's magnetic field at a place and time from the World Magnetic Model."""

from dataclasses import dataclass
from datetime import MAXYEAR, UTC, datetime

from pygeomag import GeoMag, calculate_decimal_year

from rig.config.sections import Place


@dataclass(frozen=True)
class ModelField:
    """Horizontal and downward strength, uT, declination (east positive), and the model's own sigma of that.

    ``problem`` says why the requested date could not be used (None: it was). ``date_sigma_deg`` is the change of
    declination over the model's validity, if the date is unknown.
    """

    horizontal_ut: float
    down_ut: float
    declination_deg: float
    declination_sigma_deg: float
    problem: str | None = None
    date_sigma_deg: float = 0.0


def model_field(place: Place, when: datetime) -> ModelField:
    """The field at a place; outside the model's validity, that of the nearest valid date."""
    model = GeoMag()
    first, last = model.life_span
    year = _decimal_year(when)
    nearest = min(max(year, first), last)
    where = place.lat_deg, place.lon_deg, place.altitude_m / 1000.0
    field = model.calculate(*where, nearest)
    change_deg = 0.0
    if nearest != year:
        change_deg = abs(float(model.calculate(*where, last).d) - float(model.calculate(*where, first).d))
    return ModelField(
        float(field.h) / 1000.0,
        float(field.z) / 1000.0,
        float(field.d),
        float(field.calculate_uncertainty().d),
        date_problem(when),
        min(change_deg, 180.0),
    )


def date_problem(when: datetime) -> str | None:
    """Why a date is outside the model's validity; None if it is inside."""
    first, last = GeoMag().life_span
    if first <= _decimal_year(when) <= last:
        return None
    side = "before" if when < datetime(int(first), 1, 1, tzinfo=UTC) else "after"
    return f"the computer's clock says {when:%Y-%m-%d}, {side} the World Magnetic Model's years {first:g} to {last:g}"


def _decimal_year(when: datetime) -> float:
    return float(calculate_decimal_year(when)) if when.year < MAXYEAR else float(MAXYEAR)
