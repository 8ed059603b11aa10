"""Magnetic declination: from the configuration, from the talker itself, or from the World Magnetic Model.

What a talker sends is a claim: a field that has to hold something often holds 0.0, or what was set years ago and elsewhere.
Where the place is known, the model knows better.
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
"""A talker's variation so near the model's at a rough [place] may be as good: another year, another model, rounded."""
FILLER_DEG = 0.5
"""A variation of just 0.0 is taken at its word only where the model has less than this."""
MODEL_SIGMAS = 3.0


@dataclass(frozen=True)
class Declination:
    """Magnetic to true north, east positive, and where the number is from.

    ``sigma_deg`` is its own error beyond what every compass is trusted with; ``doubt`` and ``action`` say what was not right
    with a claim, and what was made of it.
    """

    declination_deg: float
    source: str
    sigma_deg: float = field(default=0.0, compare=False)
    doubt: str | None = field(default=None, compare=False)
    action: str = field(default="", compare=False)

    def record(self) -> dict[str, Any]:
        """As JSON values, without what there is nothing to be said of."""
        doubted = {"doubt": self.doubt, "action": self.action} if self.doubt else {}
        unsure = {"sigma_deg": self.sigma_deg} if self.sigma_deg else {}
        return {"declination_deg": self.declination_deg, "source": self.source, **unsure, **doubted}

    def note(self) -> None:
        """Note the doubt as a fault that was overcome, where there is one."""
        if self.doubt:
            note_fault("compass", self.doubt, self.action)


def declination(
    configured_deg: float | None, sent_deg: float | None, place: Place | None, when: datetime
) -> Declination:
    """The configured declination, else the variation that the talker sends where the magnetic model agrees, else the model's.

    ``ConfigError`` where there is none of the three; a talker's 0.0 is none where no [place] shows that it is meant.
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
