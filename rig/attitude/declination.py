"""Magnetic declination: from the configuration, from the compass talker, or from the World Magnetic Model.

A talker's variation is not trusted by itself: the field often holds 0.0, or a value that was set years ago elsewhere.
If the place is known, the model is better.
"""

from dataclasses import dataclass, field
from datetime import datetime
from typing import Any

from rig.attitude.kinematics import wrapped_deg
from rig.attitude.magnetic_model import model_field
from rig.config.sections import Place
from rig.errors import ConfigError
from rig.fault_notes import note_fault

AGREES_DEG = 2.0
"""A talker's variation within this of the model at a rough [place] may be as good: another year or model, rounded."""
FILLER_DEG = 0.5
"""A variation of exactly 0.0 is accepted only if the model's is smaller than this."""
MODEL_SIGMAS = 3.0


@dataclass(frozen=True)
class Declination:
    """Magnetic to true north, east positive, and its source.

    ``sigma_deg`` is its error in addition to the compass's configured sigma. ``doubt`` says what was wrong with a
    talker's value, ``action`` what was used instead.
    """

    declination_deg: float
    source: str
    sigma_deg: float = field(default=0.0, compare=False)
    doubt: str | None = field(default=None, compare=False)
    action: str = field(default="", compare=False)

    def record(self) -> dict[str, Any]:
        """JSON values; fields without content are left out."""
        doubted = {"doubt": self.doubt, "action": self.action} if self.doubt else {}
        unsure = {"sigma_deg": self.sigma_deg} if self.sigma_deg else {}
        return {"declination_deg": self.declination_deg, "source": self.source, **unsure, **doubted}

    def note(self) -> None:
        """Note the doubt, if any, as a recovered fault."""
        if self.doubt:
            note_fault("compass", self.doubt, self.action)


def declination(
    configured_deg: float | None, sent_deg: float | None, place: Place | None, when: datetime
) -> Declination:
    """The configured declination; else the talker's variation if the magnetic model agrees; else the model's.

    ``ConfigError`` if there is none of the three. A talker's 0.0 does not count unless [place] confirms it.
    """
    if configured_deg is not None:
        return Declination(configured_deg, "configuration")
    model = model_field(place, when) if place else None
    if model is None:
        if sent_deg:
            return Declination(sent_deg, "talker")
        filler = "; the variation 0.0 that it sends may be a filler" if sent_deg is not None else ""
        raise ConfigError(
            f"[compass] declination_deg: needed, for this compass gives magnetic headings{filler}; give it, "
            "or the rough [place] to compute it from"
        )
    doubt, action = model.problem, "the nearest date's declination is used"
    if sent_deg is not None:
        off_deg = abs(wrapped_deg(sent_deg - model.declination_deg))
        is_filler = sent_deg == 0.0 and abs(model.declination_deg) > FILLER_DEG
        agrees_deg = max(AGREES_DEG, MODEL_SIGMAS * model.declination_sigma_deg, 2.0 * model.date_sigma_deg)
        if off_deg <= agrees_deg and not is_filler:
            return Declination(sent_deg, "talker", off_deg / 2.0)
        sent = f"sends the variation {sent_deg:z.1f} deg, and the World Magnetic Model has {model.declination_deg:z.1f}"
        doubt = f"{sent} deg at [place]" + (f" ({doubt})" if doubt else "")
        action = "the model's is used"
    return Declination(model.declination_deg, "World Magnetic Model", model.date_sigma_deg, doubt, action)
