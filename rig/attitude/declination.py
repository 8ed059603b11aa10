"""Magnetic declination: from the configuration, from the talker itself, or from the World Magnetic Model."""

from dataclasses import dataclass
from datetime import datetime

from rig.attitude.magnetic_model import model_field
from rig.config import Place
from rig.errors import ConfigError


@dataclass(frozen=True)
class Declination:
    """Magnetic to true north, east positive, and where the number is from."""

    declination_deg: float
    source: str


def declination(
    configured_deg: float | None, sent_deg: float | None, place: Place | None, when: datetime
) -> Declination:
    """The configured declination, else the variation that the talker sends, else the World Magnetic Model's.

    ``ConfigError`` where there is none of the three.
    """
    if configured_deg is not None:
        return Declination(configured_deg, "configuration")
    if sent_deg is not None:
        return Declination(sent_deg, "talker")
    if place is None:
        raise ConfigError(
            "[compass] declination_deg: needed, for this compass gives magnetic headings; give it, "
            "or the rough [place] to compute it from"
        )
    try:
        field = model_field(place, when)
    except ValueError as error:
        raise ConfigError(
            f"[compass] declination_deg: give it; the World Magnetic Model cannot: {when:%Y-%m-%d}, {error}"
        ) from error
    return Declination(field.declination_deg, "World Magnetic Model")
