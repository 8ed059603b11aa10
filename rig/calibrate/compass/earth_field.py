"""Compares the measured strength and dip of the Earth's field with the World Magnetic Model.

A difference larger than the rig's iron explains means an external disturbance: a fence, a building, a current in the
ground. North is then disturbed too, by an unknown angle.

Turning pan and vehicle separates the horizontal strength from all iron except that which changes the field equally in
all directions. The vertical strength is observable only if the vehicle's slope differs between headings; on even ground
it cannot be separated from iron above or below the compass.
"""

from dataclasses import dataclass

import numpy as np

from rig.calibrate.compass.model import EarthField
from rig.config.calibration_files import CalibrationError

STRENGTH_TOLERANCE = 0.1
"""Allowed deviation of the horizontal strength: three times the effect of a typical rig's iron."""
DIP_TOLERANCE_DEG = 4.0
SIGMAS = 3.0
MAX_DIP_SIGMA_DEG = 3.0
"""A dip with a larger sigma than this does not count as measured."""
WARNING_SHARE = 0.5

_DISTURBED = (
    "iron or a current beside the rig bends the field (building, fence, power line, vehicle, reinforced ground), or [place] is "
    "elsewhere"
)


@dataclass(frozen=True)
class MeasuredField:
    """Measured horizontal strength (uT) and dip (degrees) with sigmas.

    ``vertical_iron_ut`` is the field of iron above or below the compass that would make the dip agree with the model.
    """

    horizontal_ut: float
    horizontal_sigma_ut: float
    dip_deg: float
    dip_sigma_deg: float
    vertical_iron_ut: float

    @property
    def dip_is_measured(self) -> bool:
        """Whether the dip was measured: the vehicle's slope differed between headings."""
        return self.dip_sigma_deg <= MAX_DIP_SIGMA_DEG


def dip_deg(earth: EarthField) -> float:
    """The model's dip, positive where the field points down."""
    return float(np.degrees(np.arctan2(earth.down_ut, earth.horizontal_ut)))


def check_field(measured: MeasuredField, earth: EarthField) -> list[str]:
    """Warnings, one sentence each, for a suspicious field. ``CalibrationError`` if it contradicts the model."""
    strength_ut = float(np.hypot(earth.horizontal_ut, earth.down_ut))
    if abs(measured.vertical_iron_ut) > strength_ut:
        raise CalibrationError(
            f"compass: reads {earth.down_ut - measured.vertical_iron_ut:.0f} uT downward where the World Magnetic Model has "
            f"{earth.down_ut:.0f}: check the sign of z in [compass] axes and [place], or move the compass away from iron "
            "right beside it"
        )
    warnings = []
    for what, off, allowed in _differences(measured, earth):
        if abs(off) > allowed:
            raise CalibrationError(
                f"compass: {what}: {_DISTURBED}; calibrate again on open ground, 20 m from all iron"
            )
        if abs(off) > WARNING_SHARE * allowed:
            warnings.append(f"The {what}. If that is more than the rig's own iron does, {_DISTURBED}.")
    return warnings


def _differences(measured: MeasuredField, earth: EarthField) -> list[tuple[str, float, float]]:
    """Each difference in words, its size, and its tolerance."""
    share = measured.horizontal_ut / earth.horizontal_ut - 1.0
    share_allowed = max(STRENGTH_TOLERANCE, SIGMAS * measured.horizontal_sigma_ut / earth.horizontal_ut)
    strength = (
        f"horizontal field is {measured.horizontal_ut:.1f} uT, {abs(share):.0%} {_more_or_less(share)} than the World Magnetic "
        f"Model's {earth.horizontal_ut:.1f} uT here ({share_allowed:.0%} is allowed)"
    )
    if not measured.dip_is_measured:
        return [(strength, share, share_allowed)]
    off_deg = measured.dip_deg - dip_deg(earth)
    allowed_deg = max(DIP_TOLERANCE_DEG, SIGMAS * measured.dip_sigma_deg)
    dip = (
        f"field dips by {measured.dip_deg:.1f} deg, {abs(off_deg):.1f} deg {_more_or_less(off_deg)} than the World Magnetic "
        f"Model's {dip_deg(earth):.1f} deg here ({allowed_deg:.1f} is allowed)"
    )
    return [(strength, share, share_allowed), (dip, off_deg, allowed_deg)]


def _more_or_less(difference: float) -> str:
    return "more" if difference > 0.0 else "less"
