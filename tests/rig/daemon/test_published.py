"""What of the answers counts as current, and how uncertain it is in true directions."""

import dataclasses
import math
import time
from datetime import timedelta

import numpy as np
import pytest
from fakes.answers import an_answer
from pyproj import CRS, Geod, Transformer

from localizer.fix import Position
from rig.clock import Instant
from rig.daemon.publish.published import current_fix, expiry_reason, published, true_covariance_m2
from rig.daemon.state import DaemonState

VALID_S = 30.0


def of(*answers, **changes):
    daemon_state = DaemonState()
    for answer in answers:
        daemon_state.set_answer(answer)
    now = Instant.now()
    return current_fix(daemon_state.snapshot(), dataclasses.replace(now, **changes), VALID_S)


def test_before_the_first_answer_there_is_no_fix():
    assert of() is None


def test_a_fix_is_current_until_its_capture_is_too_long_ago():
    assert of(an_answer(age_s=VALID_S - 2.0)).bundle == "20261126T235958Z-3f9a"
    assert of(an_answer(age_s=VALID_S + 0.1)) is None


def test_the_age_counts_from_the_capture_and_not_from_the_answer():
    assert of(an_answer(age_s=40.0, took_s=39.0)) is None


@pytest.mark.parametrize("status", ["none", "ambiguous"])
def test_a_later_capture_without_a_fix_ends_the_earlier_one(status):
    assert of(an_answer("a", age_s=20.0), an_answer("b", status, age_s=10.0)) is None


@pytest.mark.parametrize("status", ["fix", "none", "ambiguous"])
def test_an_answer_that_had_to_wait_in_the_spool_says_nothing_of_the_present(status):
    old = an_answer("old", status, age_s=4000.0)
    assert of(old) is None
    if status != "fix":
        assert of(an_answer("new", age_s=20.0), old).bundle == "new"


@pytest.mark.parametrize("step_h", [-1e5, -2.0, 2.0, 1e5])
def test_a_step_of_the_wall_clock_makes_no_fix_older_or_younger(step_h):
    stepped_utc = Instant.now().utc + timedelta(hours=step_h)
    assert of(an_answer(age_s=10.0), utc=stepped_utc) is not None
    assert of(an_answer(age_s=31.0), utc=stepped_utc) is None


def test_a_capture_of_the_future_is_of_another_clock_and_not_current():
    assert of(an_answer(age_s=-5.0)) is None


def test_a_vehicle_that_has_moved_since_is_not_there_any_more():
    daemon_state = DaemonState()
    daemon_state.set_moving()
    daemon_state.set_answer(an_answer("b", age_s=-0.001))
    at = Instant(time.monotonic() + 5.0, Instant.now().utc)
    assert current_fix(daemon_state.snapshot(), at, VALID_S).bundle == "b"
    daemon_state.set_answer(an_answer("c", age_s=-0.002))
    time.sleep(0.01)
    daemon_state.set_moving()
    assert current_fix(daemon_state.snapshot(), at, VALID_S) is None
    assert (
        expiry_reason(daemon_state.snapshot().last, daemon_state.snapshot(), at, VALID_S)
        == "the vehicle has moved on"
    )


def place(crs, lat_deg, lon_deg):
    easting_m, northing_m = Transformer.from_crs(4326, crs, always_xy=True).transform(lon_deg, lat_deg)
    return Position(
        easting_m=easting_m,
        northing_m=northing_m,
        crs=crs,
        lat_deg=lat_deg,
        lon_deg=lon_deg,
        ground_m=0.0,
        row=0.0,
        col=0.0,
    )


@pytest.mark.parametrize(
    ("crs", "lat_deg", "lon_deg"),
    [
        ("EPSG:26910", 46.199, -122.192),
        ("EPSG:32632", 46.5, 11.9),  # 2 degrees of convergence
        ("EPSG:32719", -54.2, -71.9),
        ("EPSG:3031", -77.8, 166.7),  # polar: grid north is elsewhere altogether
        ("EPSG:2056", 46.0, 7.7),
    ],
)
def test_the_ellipse_is_turned_from_grid_to_true_north(crs, lat_deg, lon_deg):
    towards_deg = 33.0
    # the map's direction of a geodesic in true azimuth 33 degrees, straight from its two ends
    lon2_deg, lat2_deg, _ = Geod(ellps="WGS84").fwd(lon_deg, lat_deg, towards_deg, 50.0)
    here, there = place(crs, lat_deg, lon_deg), place(crs, lat2_deg, lon2_deg)
    along = np.array([there.easting_m - here.easting_m, there.northing_m - here.northing_m])
    along /= np.linalg.norm(along)
    covariance_m2 = 9.0 * np.outer(along, along) + 4.0 * (np.eye(2) - np.outer(along, along))
    (ee, en), (ne, nn) = covariance_m2.tolist()
    fix = published(an_answer(position=here, covariance_m2=((ee, en), (ne, nn))))
    assert fix.major_azimuth_deg == pytest.approx(towards_deg, abs=0.05)
    assert (fix.sigma_major_m, fix.sigma_minor_m) == pytest.approx((3.0, 2.0), rel=2e-3)
    turn = math.radians(towards_deg)
    north_m = math.sqrt(9.0 * math.cos(turn) ** 2 + 4.0 * math.sin(turn) ** 2)
    east_m = math.sqrt(9.0 * math.sin(turn) ** 2 + 4.0 * math.cos(turn) ** 2)
    assert (fix.sigma_north_m, fix.sigma_east_m) == pytest.approx((north_m, east_m), rel=2e-3)


def test_the_sigmas_of_a_fix_are_metres_of_the_ground_whatever_the_map_s_scale():
    mercator = place("EPSG:3857", 60.0, 10.0)  # twice as long as the ground, there
    of_true_m2 = true_covariance_m2(mercator, ((9.0, 0.0), (0.0, 4.0)))
    assert np.sqrt(np.diag(of_true_m2)) == pytest.approx([3.0, 2.0], rel=0.01)
    assert CRS.from_user_input(mercator.crs).is_projected


def test_an_answer_without_a_position_cannot_be_published():
    with pytest.raises(ValueError, match="no fix"):
        published(an_answer(status="none"))


def test_the_age_is_that_of_the_capture():
    fix = published(an_answer(age_s=12.0))
    assert fix.age_s(Instant(time.monotonic(), fix.utc)) == pytest.approx(12.0, abs=2.0)
