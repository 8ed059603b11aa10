"""Headings from compasses read at uneven pan angles: deviation, degrees of freedom and noise by their closed forms."""

from dataclasses import replace

import numpy as np
import pytest

from rig.attitude.heading import (
    FieldAtPan,
    HeadingsAtPan,
    circular_mean_deg,
    distinct_pans,
    heading_from_field,
    heading_from_talker,
)
from rig.attitude.level import BaseLevel
from rig.errors import DeviceError

FLAT = BaseLevel(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def says(pan_deg: float, heading_deg: float, *off_deg: float) -> HeadingsAtPan:
    return HeadingsAtPan(pan_deg, tuple((heading_deg + off) % 360.0 for off in off_deg or (0.0,)))


@pytest.mark.parametrize("pans_deg", [(-100.0, -20.0, 30.0, 60.0), (-40.0, 0.0, 40.0, 80.0, 120.0, 160.0)])
@pytest.mark.parametrize("heading_deg", [10.0, 200.0])
def test_a_deviation_is_solved_for_from_four_uneven_angles_on(
    pans_deg: tuple[float, ...], heading_deg: float
) -> None:
    """3 deg of sine: the mean of these headings is a degree and more off."""
    said = []
    for pan_deg in pans_deg:
        true_deg = heading_deg + pan_deg
        said.append(says(pan_deg, true_deg + 3.0 * np.sin(np.radians(true_deg) + 0.7)))
    mean_off_deg = np.mean([3.0 * np.sin(np.radians(heading_deg + pan) + 0.7) for pan in pans_deg])
    found = heading_from_talker(said, FLAT)
    assert found.heading_deg == pytest.approx(heading_deg, abs=0.15)
    assert abs(mean_off_deg) > 0.5


def test_three_angles_are_averaged_and_their_spread_is_the_misfit() -> None:
    """Off by 2, -1 and -1: a sum of squares of 6 over 2 degrees of freedom, and the mean of three."""
    found = heading_from_talker([says(0.0, 22.0), says(120.0, 139.0), says(240.0, 259.0)], FLAT)
    assert found.heading_deg == pytest.approx(20.0, abs=0.001)
    assert found.misfit_deg == pytest.approx(np.sqrt(6.0 / 2.0), rel=1e-3)
    assert found.scatter_deg == pytest.approx(np.sqrt(3.0 / 3.0), rel=1e-3)


def test_what_no_deviation_explains_is_the_misfit() -> None:
    """1 deg to the right and left by turns at four even angles: 4 over the one degree of freedom that is left."""
    found = heading_from_talker([says(90.0 * i, 90.0 * i + (-1.0) ** i) for i in range(4)], FLAT)
    assert found.misfit_deg == pytest.approx(2.0, rel=0.01)
    assert found.scatter_deg == pytest.approx(1.0, rel=0.01)


def test_the_noisiest_angle_counts() -> None:
    """0.3 deg over the root of four readings, in the mean of three angles; the others are silent."""
    said = [says(0.0, 0.0, 0.3, -0.3, 0.3, -0.3), says(120.0, 120.0), says(240.0, 240.0)]
    found = heading_from_talker(said, FLAT)
    assert found.scatter_deg == pytest.approx(0.3 / 2.0 / np.sqrt(3.0), rel=1e-6)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_one_heading_far_to_one_side_is_refused(sign: float) -> None:
    """24 against three times 8 to the other side."""
    said = [says(90.0 * i, 90.0 * i + sign * (24.0 if i == 0 else -8.0)) for i in range(4)]
    with pytest.raises(DeviceError, match=r"do not turn with the pan \(2\d deg off\)"):
        heading_from_talker(said, FLAT)


@pytest.mark.parametrize(
    ("pans_deg", "count"),
    [([0.0], 1), ([0.0, 0.19], 1), ([0.21, 0.0], 2), ([0.0, 0.15, 0.3], 1), ([90.0, -90.0, 0.0, 90.1], 3)],
)
def test_angles_within_two_ticks_of_the_encoder_are_one(pans_deg: list[float], count: int) -> None:
    assert distinct_pans(pans_deg) == count


def test_a_mean_direction_is_between_0_and_360() -> None:
    assert circular_mean_deg([-10.0]) == pytest.approx(350.0)
    assert circular_mean_deg([350.0, -20.0]) == pytest.approx(345.0)


def test_the_noise_of_a_field_at_uneven_angles_is_that_of_least_squares() -> None:
    """The largest noise of any angle, through the normal equations of field (x, y) and iron (x, y), written out."""
    pans_deg = (-30.0, 0.0, 40.0)
    rows, read = [], []
    for pan_deg, noise_ut, up_ut in zip(pans_deg, (0.01, 0.3, 0.1), (-42.0, -40.0, -38.0), strict=True):
        c, s = np.cos(np.radians(pan_deg)), np.sin(np.radians(pan_deg))
        rows += [[c, -s, 1.0, 0.0], [s, c, 0.0, 1.0]]
        read.append(FieldAtPan(pan_deg, np.array([-s * 20.0, c * 20.0, up_ut]), noise_ut))
    deviations = 0.3 * np.sqrt(np.diag(np.linalg.inv(np.array(rows).T @ np.array(rows))))
    found = heading_from_field(read, FLAT)
    assert found.heading_deg % 360.0 == pytest.approx(0.0, abs=1e-6) or found.heading_deg > 359.999
    assert found.down_ut == pytest.approx(40.0), "the mean of the three"
    by_noise_deg = np.degrees(np.sqrt((deviations[0] ** 2 + deviations[1] ** 2) / 2.0) / 20.0)
    assert found.scatter_deg == pytest.approx(by_noise_deg, rel=1e-6)
    less = heading_from_field([replace(field, noise_ut=0.1) for field in read], FLAT)
    assert less.scatter_deg == pytest.approx(by_noise_deg / 3.0, rel=1e-6)
