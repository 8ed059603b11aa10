"""The Earth's magnetic field at a place and time, by the World Magnetic Model."""

from dataclasses import dataclass
from datetime import datetime

from pygeomag import GeoMag, calculate_decimal_year

from rig.config import Place


@dataclass(frozen=True)
class ModelField:
    """Horizontal and downward strength, uT, declination (east positive), and the model's own sigma of that."""

    horizontal_ut: float
    down_ut: float
    declination_deg: float
    declination_sigma_deg: float


def model_field(place: Place, when: datetime) -> ModelField:
    """The field at a place. ``ValueError`` outside the years that the model is good for."""
    year = calculate_decimal_year(when)
    field = GeoMag().calculate(place.lat_deg, place.lon_deg, place.altitude_m / 1000.0, year)
    return ModelField(
        float(field.h) / 1000.0,
        float(field.z) / 1000.0,
        float(field.d),
        float(field.calculate_uncertainty().d),
    )
