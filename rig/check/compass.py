"""``rig check`` for compasses: the field of a magnetometer, or the headings of a talker."""

import math
from collections.abc import Sequence

import numpy as np

from rig.attitude.declination import declination
from rig.attitude.heading import PLAUSIBLE_FIELD_UT, circular_mean_deg
from rig.attitude.kinematics import wrapped_deg
from rig.attitude.level import in_axes
from rig.check.result import DeviceCheck
from rig.config.sections import Mmc5983maSection, NmeaCompassSection, Place
from rig.devices.readings import FieldReading, HeadingReading
from rig.errors import RigError

HEADING_NOISE_LIMIT_DEG = 2.0
REFERENCES_DISAGREE_DEG = 5.0


def field_check(identity: str, fields: Sequence[FieldReading], section: Mmc5983maSection) -> DeviceCheck:
    """Check of magnetometer readings."""
    chip_ut = np.array([[reading.x_ut, reading.y_ut, reading.z_ut] for reading in fields])
    stage_ut = in_axes(chip_ut, section.axes) - np.array(section.hard_iron_ut)
    x_ut, y_ut, z_ut = (float(value) for value in stage_ut.mean(axis=0))
    total_ut = math.hypot(x_ut, y_ut, z_ut)
    noise_ut = float(chip_ut.std(axis=0).max())
    limit_ut = max(0.5, math.hypot(x_ut, y_ut) * math.radians(HEADING_NOISE_LIMIT_DEG))
    low, high = PLAUSIBLE_FIELD_UT
    problem = None
    if not low <= total_ut <= high:
        problem = f"{total_ut:.0f} uT is not the Earth's field; check axes, hard_iron_ut, and for magnets"
    elif noise_ut > limit_ut:
        problem = (
            f"noise of {noise_ut:.2f} uT is above {limit_ut:.2f} uT, {HEADING_NOISE_LIMIT_DEG:g} deg of heading; switch motors "
            "and radios near it off, look for loose iron"
        )
    return DeviceCheck(
        "compass",
        identity,
        f"{total_ut:.1f} uT (right {x_ut:.1f}, ahead {y_ut:.1f}, up {z_ut:.1f})",
        f"{noise_ut:.3f} uT",
        (),
        tuple(each.temperature_c for each in fields[-1:] if each.temperature_c is not None),
        problem,
        {
            "field_ut": total_ut,
            "field_right_ut": x_ut,
            "field_ahead_ut": y_ut,
            "field_up_ut": z_ut,
            "noise_ut": noise_ut,
        },
    )


def heading_check(
    identity: str, headings: Sequence[HeadingReading], section: NmeaCompassSection, place: Place | None
) -> DeviceCheck:
    """Check of a talker's headings, magnetic and true ones separately."""
    means, scatters = {}, {}
    for reference in sorted({reading.reference for reading in headings}):
        angles_deg = [reading.heading_deg for reading in headings if reading.reference == reference]
        mean_deg = circular_mean_deg(angles_deg)
        means[reference] = mean_deg
        scatters[reference] = float(np.std([wrapped_deg(angle - mean_deg) for angle in angles_deg]))
    scatter_deg = max(scatters.values())
    problem = None
    if scatter_deg > HEADING_NOISE_LIMIT_DEG:
        problem = (
            f"scatter of {scatter_deg:.1f} deg is above {HEADING_NOISE_LIMIT_DEG:g} deg; hold the vehicle still, switch motors "
            "and radios near it off"
        )
    elif len(means) == 2:
        problem = _contradiction(means["true"] - means["magnetic"], headings, section, place)
    return DeviceCheck(
        "compass",
        identity,
        ", ".join(f"{round(means[reference], 1) % 360.0:.1f} deg {reference}" for reference in means),
        f"{scatter_deg:.2f} deg",
        (),
        (),
        problem,
        {f"{reference}_heading_deg": mean_deg for reference, mean_deg in means.items()}
        | {"reference": next(iter(means)) if len(means) == 1 else "both", "noise_deg": scatter_deg},
    )


def _contradiction(
    true_minus_magnetic_deg: float,
    headings: Sequence[HeadingReading],
    section: NmeaCompassSection,
    place: Place | None,
) -> str | None:
    """Why a talker's true and magnetic headings are inconsistent; None if they are consistent."""
    variation_deg = next((r.variation_deg for r in headings if r.variation_deg is not None), None)
    between_deg = wrapped_deg(true_minus_magnetic_deg)
    try:
        expected_deg = declination(
            section.declination_deg, variation_deg, place, headings[-1].utc
        ).declination_deg
    except RigError:
        return None
    if abs(wrapped_deg(between_deg - expected_deg)) <= REFERENCES_DISAGREE_DEG:
        return None
    return (
        f"its true heading is {between_deg:+.1f} deg from its magnetic one, where the declination is {expected_deg:+.1f} deg; "
        "set the variation in the instrument, or have it send one of them"
    )
