"""Dead reckoning against closed forms: every figure is worked out here from the listed constants.

A speed's error of 3 % and a heading's of 3 deg hold for the whole leg. Slip and steering are independent after each 50 m:
over a distance d their variance is (max(0.03, 3 deg in radians))^2 * 50 m * d. Half a metre is unknown in any case.
"""

import math

import numpy as np
import pytest

from localizer.track.odometry import Movement, parse_leg
from rig.config.run import OdometryInput
from rig.daemon.odometry.receiver import Odometer, Velocity

HEADING = math.radians(3.0)
SLIP_M2 = HEADING**2 * 50.0
"""Of each metre."""
FLOOR_M2 = 0.25
EAST, NORTH = 90.0, 0.0
A_LEG = parse_leg('{"east_m": 10, "north_m": -5, "sigma_m": 3}')


def begun(at_s: float = 0.0, **keys: float) -> Odometer:
    """At a capture."""
    odometer = Odometer(
        OdometryInput(speed_sigma_share=0.03, heading_sigma_deg=3.0).model_copy(update=keys), at_s
    )
    odometer.begin(at_s)
    odometer.keep()
    return odometer


def moved(odometer: Odometer, at_s: float) -> Movement:
    movement = odometer.movement(at_s)
    assert movement is not None
    return movement


def any_direction(movement: Movement) -> float:
    """The variance, which is the same in every direction."""
    assert movement.covariance_m2 == pytest.approx(movement.covariance_m2[0, 0] * np.eye(2), abs=1e-9)
    return float(movement.covariance_m2[0, 0])


def test_a_straight_drive() -> None:
    """100 m towards 30 deg."""
    odometer = begun()
    for second in range(11):
        odometer.velocity(Velocity(10.0, 30.0), float(second))
    leg = moved(odometer, 10.0)
    along = np.array([0.5, math.sqrt(0.75)])
    aside = np.array([math.sqrt(0.75), -0.5])
    assert leg.step_m == pytest.approx(100.0 * along)
    expected = 3.0**2 * np.outer(along, along) + (100.0 * HEADING) ** 2 * np.outer(aside, aside)
    assert leg.covariance_m2 == pytest.approx(expected + (100.0 * SLIP_M2 + FLOOR_M2) * np.eye(2))


def test_the_larger_of_both_errors_is_that_of_slip_and_steering() -> None:
    odometer = begun(speed_sigma_share=0.2, heading_sigma_deg=1.0)
    odometer.velocity(Velocity(10.0, NORTH), 0.0)
    odometer.velocity(Velocity(10.0, NORTH), 2.0)
    slip_m2 = 0.2**2 * 50.0 * 20.0
    assert np.diag(moved(odometer, 2.0).covariance_m2) == pytest.approx(
        [(20.0 * math.radians(1.0)) ** 2 + slip_m2 + FLOOR_M2, 4.0**2 + slip_m2 + FLOOR_M2]
    )


def test_the_speed_changes_evenly_between_two_readings() -> None:
    odometer = begun()
    odometer.velocity(Velocity(10.0, EAST), 0.0)
    odometer.velocity(Velocity(20.0, EAST), 2.0)
    assert moved(odometer, 2.0).step_m == pytest.approx([30.0, 0.0])


def test_a_speed_from_before_a_capture_goes_on_after_it() -> None:
    odometer = begun()
    odometer.velocity(Velocity(10.0, EAST), 0.0)
    odometer.velocity(Velocity(10.0, EAST), 1.0)
    odometer.begin(1.5)
    odometer.keep()
    assert moved(odometer, 1.5).step_m == pytest.approx([0.0, 0.0]), "nothing has been driven since"
    odometer.velocity(Velocity(20.0, EAST), 3.0)
    assert moved(odometer, 3.0).step_m == pytest.approx([30.0, 0.0])


def test_readings_of_the_past_move_nothing() -> None:
    odometer = begun()
    odometer.velocity(Velocity(10.0, EAST), 2.0)
    odometer.velocity(Velocity(10.0, EAST), 1.0)
    assert moved(odometer, 2.0).step_m == pytest.approx([20.0, 0.0])


# ---- without a course


def test_a_course_that_was_unknown_before_a_capture_is_unknown_after_it() -> None:
    """Up to the first reading with a course 10 m lead in any direction: half of their square each way."""
    odometer = begun()
    odometer.velocity(Velocity(10.0, None), 0.0)
    odometer.begin(0.0)
    odometer.keep()
    odometer.velocity(Velocity(10.0, EAST), 1.0)
    leg = moved(odometer, 1.0)
    assert leg.step_m == pytest.approx([0.0, 0.0])
    assert any_direction(leg) == pytest.approx(10.0**2 / 2.0 + FLOOR_M2)


@pytest.mark.parametrize("courses", [(None, EAST), (EAST, None), (None, None)])
def test_between_two_readings_the_course_is_known_if_both_say_it(
    courses: tuple[float | None, float | None],
) -> None:
    odometer = begun()
    odometer.velocity(Velocity(10.0, courses[0]), 0.0)
    odometer.velocity(Velocity(20.0, courses[1]), 2.0)
    leg = moved(odometer, 2.0)
    assert leg.step_m == pytest.approx([0.0, 0.0])
    assert any_direction(leg) == pytest.approx(30.0**2 / 2.0 + FLOOR_M2)


def test_a_course_counts_again_once_two_readings_say_it() -> None:
    odometer = begun()
    for second, course in enumerate((None, EAST, EAST)):
        odometer.velocity(Velocity(10.0, course), float(second))
    leg = moved(odometer, 2.0)
    assert leg.step_m == pytest.approx([10.0, 0.0])
    assert leg.covariance_m2[0, 0] == pytest.approx(10.0**2 / 2.0 + 0.3**2 + 10.0 * SLIP_M2 + FLOOR_M2)


def test_a_silence_without_a_course_leads_in_any_direction() -> None:
    """10 s: 100 m that may not have been driven, and 100 m towards nobody knows where."""
    odometer = begun()
    odometer.velocity(Velocity(10.0, None), 0.0)
    leg = moved(odometer, 10.0)
    assert leg.step_m == pytest.approx([0.0, 0.0])
    assert any_direction(leg) == pytest.approx(100.0**2 + 100.0**2 / 2.0 + FLOOR_M2)


def test_distances_without_a_course_add_up_before_and_after_a_failed_capture() -> None:
    odometer = begun()
    for second in range(3):
        odometer.velocity(Velocity(10.0, None), float(second))
    odometer.begin(2.0)
    odometer.velocity(Velocity(10.0, None), 3.0)
    odometer.undo_capture()
    assert any_direction(moved(odometer, 3.0)) == pytest.approx(30.0**2 / 2.0 + FLOOR_M2)


# ---- silences


@pytest.mark.parametrize(
    ("speeds_m_s", "gap_s", "unknown_m"),
    [((0.0, 0.0), 3.0, 0.0), ((0.0, 0.0), 4.0, 4.0), ((5.0, 0.0), 4.0, 20.0), ((0.0, 5.0), 4.0, 20.0), ((0.5, 0.5), 4.0, 4.0)],
)  # fmt: skip
def test_a_gap_of_more_than_3_s_is_unknown_up_to_its_fastest_speed_1_m_s_at_least(
    speeds_m_s: tuple[float, float], gap_s: float, unknown_m: float
) -> None:
    odometer = begun()
    for at_s, speed_m_s in zip((0.0, gap_s), speeds_m_s, strict=True):
        odometer.velocity(Velocity(speed_m_s, NORTH), at_s)
    driven_m = sum(speeds_m_s) / 2.0 * gap_s
    assert moved(odometer, gap_s).covariance_m2[1, 1] == pytest.approx(
        unknown_m**2 + (0.03 * driven_m) ** 2 + driven_m * SLIP_M2 + FLOOR_M2
    )


@pytest.mark.parametrize(("gap_s", "known"), [(60.0, True), (60.1, False)])
def test_a_gap_of_more_than_60_s_leaves_nothing_known(gap_s: float, known: bool) -> None:
    odometer = begun()
    odometer.velocity(Velocity(1.0, NORTH), 0.0)
    odometer.velocity(Velocity(1.0, NORTH), gap_s)
    assert (odometer.movement(gap_s) is not None) == known


def test_a_silence_that_was_counted_is_not_counted_again() -> None:
    odometer = begun()
    odometer.velocity(Velocity(10.0, NORTH), 0.0)
    assert moved(odometer, 10.0).step_m == pytest.approx([0.0, 100.0])
    assert moved(odometer, 10.0).step_m == pytest.approx([0.0, 100.0])
    odometer.velocity(Velocity(10.0, NORTH), 11.0)
    assert moved(odometer, 11.0).step_m == pytest.approx([0.0, 110.0])


def test_without_any_reading_nothing_is_known() -> None:
    assert begun().movement(1.0) is None


# ---- legs


def test_after_a_capture_with_legs_there_is_no_movement_until_the_next_one() -> None:
    odometer = begun()
    odometer.leg(A_LEG, 1.0)
    leg = odometer.begin(2.0)
    odometer.keep()
    assert leg is not None
    assert leg.step_m == pytest.approx([10.0, -5.0])
    assert any_direction(leg) == pytest.approx(3.0**2 + FLOOR_M2)
    since = moved(odometer, 3.0)
    assert since.step_m == pytest.approx([0.0, 0.0])
    assert any_direction(since) == pytest.approx(FLOOR_M2)


def test_the_covariances_of_legs_add_up_with_their_correlation() -> None:
    odometer = begun()
    covariance_m2 = np.array([[4.0, 1.5], [1.5, 9.0]])
    for at_s in (1.0, 2.0):
        odometer.leg(Movement(np.array([1.0, 2.0]), covariance_m2), at_s)
    leg = moved(odometer, 2.0)
    assert leg.step_m == pytest.approx([2.0, 4.0])
    assert leg.covariance_m2 == pytest.approx(2.0 * covariance_m2 + FLOOR_M2 * np.eye(2))


def test_a_failed_capture_leaves_the_legs_from_before_it() -> None:
    odometer = begun()
    odometer.leg(A_LEG, 1.0)
    odometer.begin(2.0)
    odometer.leg(A_LEG, 3.0)
    odometer.undo_capture()
    leg = moved(odometer, 3.0)
    assert leg.step_m == pytest.approx([20.0, -10.0])
    assert any_direction(leg) == pytest.approx(2 * 3.0**2 + FLOOR_M2)


@pytest.mark.parametrize("unknown_first", [True, False])
def test_a_leg_that_was_unknown_before_or_during_a_failed_capture_stays_unknown(unknown_first: bool) -> None:
    odometer = begun()
    odometer.leg(None if unknown_first else A_LEG, 1.0)
    odometer.begin(2.0)
    odometer.leg(A_LEG if unknown_first else None, 3.0)
    odometer.undo_capture()
    assert odometer.movement(3.0) is None
    odometer.begin(4.0)
    assert odometer.movement(4.0) is not None, "the next leg begins anew"


def test_a_failed_capture_leaves_the_drive_from_before_it_with_its_errors() -> None:
    odometer = begun()
    for second in range(4):
        if second == 2:
            odometer.begin(2.0)
        odometer.velocity(Velocity(10.0, EAST), float(second))
    odometer.undo_capture()
    leg = moved(odometer, 3.0)
    assert leg.step_m == pytest.approx([30.0, 0.0])
    assert np.diag(leg.covariance_m2) == pytest.approx(
        [0.9**2 + 30.0 * SLIP_M2 + FLOOR_M2, (30.0 * HEADING) ** 2 + 30.0 * SLIP_M2 + FLOOR_M2]
    )


def test_a_silence_from_before_a_failed_capture_counts_from_its_begin() -> None:
    """Without any speed since 0 s the one at 61 s comes after a gap of more than a minute."""
    odometer = begun()
    odometer.begin(50.0)
    odometer.undo_capture()
    odometer.velocity(Velocity(1.0, NORTH), 61.0)
    assert odometer.movement(61.0) is None


# ---- a restart


@pytest.mark.parametrize(("heard_s", "captured_s", "missed_s"), [(100.0, 101.0, 10.0), (None, 101.0, 9.0)])
def test_legs_may_have_been_missed_since_the_last_one_or_since_the_capture(
    heard_s: float | None, captured_s: float, missed_s: float
) -> None:
    """At 15 m/s; without any leg since the capture."""
    odometer = begun()
    if heard_s is not None:
        odometer.leg(A_LEG, heard_s)
    odometer.begin(captured_s)
    after = Odometer(OdometryInput(), 110.0, odometer.to_json())
    after.leg(A_LEG, 111.0)
    leg = moved(after, 111.0)
    assert leg.step_m == pytest.approx([10.0, -5.0])
    assert any_direction(leg) == pytest.approx((15.0 * missed_s) ** 2 + 3.0**2 + FLOOR_M2)


@pytest.mark.parametrize(("missed_s", "known"), [(60.0, True), (60.1, False)])
def test_after_a_minute_without_legs_a_restart_knows_nothing(missed_s: float, known: bool) -> None:
    odometer = begun()
    odometer.leg(A_LEG, 0.0)
    after = Odometer(OdometryInput(), missed_s, odometer.to_json())
    assert (after.movement(missed_s) is not None) == known


def test_a_course_that_was_unknown_before_a_restart_is_unknown_after_it() -> None:
    odometer = begun()
    odometer.velocity(Velocity(10.0, None), 0.0)
    after = Odometer(OdometryInput(), 0.5, odometer.to_json())
    after.velocity(Velocity(10.0, EAST), 1.0)
    leg = moved(after, 1.0)
    assert leg.step_m == pytest.approx([0.0, 0.0])
    assert any_direction(leg) == pytest.approx(10.0**2 / 2.0 + FLOOR_M2)
