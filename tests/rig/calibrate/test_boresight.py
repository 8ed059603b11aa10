"""The boresight from the DEM's skyline; a wrong place and a hidden ridge are rejected."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from fakes.whole_rig import FakeRig, running_rig

from localizer.camera import camera_to_world
from rig.attitude.heading import TrueHeading
from rig.attitude.kinematics import Attitude, body_rotation, wrapped_deg
from rig.attitude.level import BaseLevel
from rig.calibrate.boresight.fit import fit_boresight
from rig.calibrate.boresight.horizon_profile import STEP_DEG, HorizonProfile
from rig.calibrate.boresight.known_place import KnownPlace, PlaceSigmas
from rig.calibrate.boresight.procedure import measure_boresight
from rig.calibrate.boresight.skyline_frame import SkylineFrame
from rig.calibrate.boresight.skyline_survey import require_unmoved
from rig.capture.base_attitude import BaseEstimate
from rig.config.calibration_files import CalibrationError

AZIMUTHS_DEG = np.arange(0.0, 360.0, STEP_DEG)
CAMERA = Attitude(2.6, -1.4, 1.1)
HEADING_DEG = -0.3
UNKNOWN = Attitude(0.0, 0.0, 0.0)
SIGMAS = PlaceSigmas(4.0, 1.5, 0.5)


def ridges(seed: int) -> HorizonProfile:
    """A rugged skyline some kilometres away, the same from a few metres aside."""
    rng = np.random.default_rng(seed)
    elevation = 6.0 + sum(
        rng.normal(0.0, 2.5 / k**0.9) * np.sin(np.radians(k * AZIMUTHS_DEG) + rng.uniform(0.0, 6.28))
        for k in range(1, 60)
    )
    distance = np.full(len(AZIMUTHS_DEG), 3000.0)
    return HorizonProfile(
        elevation, distance, np.zeros((3, len(AZIMUTHS_DEG))), np.zeros(len(AZIMUTHS_DEG), bool)
    )


def frames(profile: HorizonProfile, share: float = 1.0) -> list[SkylineFrame]:
    """Sixteen frames all round, high and low, by a camera that sits like CAMERA, azimuths off by HEADING_DEG."""
    rng = np.random.default_rng(8)
    found = []
    for stop, azimuth_deg in enumerate(np.arange(0.0, 360.0, 45.0)):
        for tilt_deg in (-3.0, 11.0):
            head = Attitude(azimuth_deg, tilt_deg, rng.normal(0.0, 3.0))
            true = Attitude(azimuth_deg + HEADING_DEG + rng.normal(0.0, 0.03), head.tilt_deg, head.roll_deg)
            turn = body_rotation(true) @ camera_to_world(CAMERA.azimuth_deg, CAMERA.tilt_deg, CAMERA.roll_deg)
            at = azimuth_deg + np.arange(-28.0, 28.0, 1.0)
            up = profile.elevation(at) + rng.normal(0.0, 0.03, len(at))
            a, e = np.radians(at), np.radians(up)
            world = np.column_stack([np.sin(a) * np.cos(e), np.cos(a) * np.cos(e), np.sin(e)])
            rays = world @ turn
            found.append(SkylineFrame("f", head, rays, np.full(len(at), 0.04), share, 0.1, 0.01, stop))
    return found


def test_degrees_of_mounting_error_are_found() -> None:
    profile = ridges(1)
    fit = fit_boresight(frames(profile), profile, UNKNOWN, 0.5, SIGMAS)
    sigma = np.sqrt(np.diag(fit.covariance_deg2))
    together = fit.boresight.azimuth_deg + fit.heading_offset_deg
    assert together == pytest.approx(CAMERA.azimuth_deg + HEADING_DEG, abs=0.04)
    assert fit.boresight.tilt_deg == pytest.approx(CAMERA.tilt_deg, abs=0.01)
    assert fit.boresight.roll_deg == pytest.approx(CAMERA.roll_deg, abs=0.02)
    assert fit.boresight.azimuth_deg == pytest.approx(CAMERA.azimuth_deg, abs=0.1), "told from the heading"
    assert (sigma < [0.06, 0.02, 0.03]).all()
    assert sigma[1] > 0.01, "a bright sky shifts every traced skyline by that, however many points there are"


def test_frames_at_one_tilt_do_not_tell_camera_from_heading() -> None:
    profile = ridges(1)
    level = [frame for frame in frames(profile) if frame.head.tilt_deg < 0.0]
    fit = fit_boresight(level, profile, UNKNOWN, 0.01, SIGMAS)
    together = fit.boresight.azimuth_deg + fit.heading_offset_deg
    assert together == pytest.approx(CAMERA.azimuth_deg + HEADING_DEG, abs=0.1)
    assert abs(fit.heading_offset_deg) < 0.05, "a compass that is sure is believed"


@pytest.mark.parametrize("seed", range(3))
def test_far_ridges_traced_too_low_do_not_tilt_the_camera(seed: int) -> None:
    """Haze hides a third of the far skyline, and what is traced there is the nearer ridge below it."""
    rugged = ridges(1)
    far = AZIMUTHS_DEG % 90.0 < 45.0
    distance = np.where(far, 6000.0, 1500.0)
    by_place = np.zeros((3, len(AZIMUTHS_DEG)))
    by_place[2] = -np.degrees(1.0 / distance)
    profile = replace(rugged, distance_m=distance, by_place=by_place)
    rng = np.random.default_rng(seed)
    hazy = []
    for frame in frames(profile):
        azimuth_deg = frame.head.azimuth_deg + np.arange(-28.0, 28.0, 1.0)
        missed = (profile.distance(azimuth_deg) > 3000.0) & (rng.uniform(size=len(azimuth_deg)) < 0.35)
        low = np.where(missed, rng.uniform(0.05, 0.25, len(azimuth_deg)), 0.0)
        rays = frame.rays + np.radians(low)[:, None] * [0.0, 1.0, 0.0]
        hazy.append(replace(frame, rays=rays / np.linalg.norm(rays, axis=1)[:, None]))
    fit = fit_boresight(hazy, profile, UNKNOWN, 0.5, PlaceSigmas(4.0, 1.5, 1.5))
    assert fit.boresight.tilt_deg == pytest.approx(CAMERA.tilt_deg, abs=0.015)


def test_a_skyline_at_which_the_dem_ends_is_left_out() -> None:
    """Behind the DEM's last cells the terrain rises a degree higher."""
    known = ridges(1)
    ends = (AZIMUTHS_DEG > 100.0) & (AZIMUTHS_DEG < 190.0)
    seen = frames(replace(known, elevation_deg=known.elevation_deg + 1.0 * ends))
    fit = fit_boresight(seen, replace(known, at_end=ends), UNKNOWN, 0.5, SIGMAS)
    assert fit.boresight.tilt_deg == pytest.approx(CAMERA.tilt_deg, abs=0.01)
    assert fit.boresight.roll_deg == pytest.approx(CAMERA.roll_deg, abs=0.02)
    assert fit.misfit_deg < 0.1
    with pytest.raises(
        CalibrationError, match="in 14 of the 16 frames that show a skyline it is where the DEM ends"
    ):
        fit_boresight(seen, replace(known, at_end=AZIMUTHS_DEG > 20.0), UNKNOWN, 0.5, SIGMAS)


def test_another_place_is_refused() -> None:
    with pytest.raises(CalibrationError, match=r"another place"):
        fit_boresight(frames(ridges(1)), ridges(2), UNKNOWN, 0.5, SIGMAS)


def test_cloud_before_the_ridge_is_refused() -> None:
    profile = ridges(1)
    with pytest.raises(CalibrationError, match="shows in 0 of 16 frames"):
        fit_boresight(frames(profile, share=0.1), profile, UNKNOWN, 0.5, SIGMAS)


def base_estimate(heading_deg: float, pitch_deg: float) -> BaseEstimate:
    level = BaseLevel(pitch_deg, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    heading = TrueHeading(heading_deg, 0.3, None)
    return BaseEstimate(level.attitude(heading_deg), level, heading, {}, {}, ())


def test_a_vehicle_that_stands_may_read_a_little_otherwise() -> None:
    require_unmoved(base_estimate(359.9, 2.0), base_estimate(0.1, 2.01))


def test_the_heading_is_of_the_stops_before_the_pictures_and_the_stops_after(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Three stops, two pictures of one direction, three stops: the compass turns by half a degree with the pictures."""
    fitted: list[Any] = []
    dem: Any = None
    place = KnownPlace(47.0, 8.0, dem, 0.0, 0.0, 500.0)
    monkeypatch.setattr("rig.calibrate.boresight.procedure.horizon_profile", lambda *_: None)
    monkeypatch.setattr(
        "rig.calibrate.boresight.procedure.fit_boresight", lambda *given: fitted.append(given)
    )
    rig = FakeRig(base=Attitude(30.0, 0.0, 0.0))
    rig.compass_off_deg = lambda number: 0.5 if number > 3 else 0.0
    with running_rig(monkeypatch, rig) as running:
        measure_boresight(running.config(), place, SIGMAS, 1, lambda line: None)
    found, _, _, sigma_deg, _ = fitted[0]
    assert [frame.label for frame in found] == ["A000", "A000 tilted"]
    nearest_tick_deg = round(-30.0 * 4096 / 360) * 360 / 4096
    for frame in found:
        heading_deg = wrapped_deg(frame.head.azimuth_deg - nearest_tick_deg)
        assert 30.28 < heading_deg < 30.40, "30.25 is the mean of before and after"
    assert sigma_deg > 1.0


@pytest.mark.parametrize(("heading_deg", "pitch_deg"), [(31.5, 2.0), (30.0, 2.3)])
def test_a_vehicle_that_moved_meanwhile_is_refused(heading_deg: float, pitch_deg: float) -> None:
    with pytest.raises(CalibrationError, match="the vehicle moved while it was measured"):
        require_unmoved(base_estimate(30.0, 2.0), base_estimate(heading_deg, pitch_deg))
