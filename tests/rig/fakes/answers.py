"""Answers as in the daemon state, for publishers."""

from datetime import UTC, datetime, timedelta

from localizer.fix import Candidate, Fix, Nuisance, Position, Stage1Counts
from rig import timebase
from rig.clock import Instant
from rig.daemon.state import Answer

CAPTURED_UTC = datetime(2026, 11, 26, 23, 59, 58, 470_000, tzinfo=UTC)
STAGE1 = Stage1Counts(cells=100, after_altitude=9, after={"N": 1}, points_explored=1000)


def an_answer(
    bundle="20261126T235958Z-3f9a",
    status="fix",
    age_s=10.0,
    utc=CAPTURED_UTC,
    position=None,
    covariance_m2=((9.0, 0.0), (0.0, 4.0)),
    altitude_m=1432.6,
    heading_deg=271.25,
    took_s=8.0,
):
    """An answer to a capture of ``age_s`` ago, by the clock that does not step."""
    captured_s = timebase.monotonic_s() - age_s
    has_place = status != "none"
    place = position or Position(
        easting_m=562310.4,
        northing_m=5116402.8,
        crs="EPSG:26910",
        lat_deg=46.199,
        lon_deg=-122.192,
        ground_m=1430.6,
        row=233.4,
        col=101.8,
    )
    candidate = Candidate(easting_m=place.easting_m, northing_m=place.northing_m, probability=0.9, rms_px=0.8)
    fix = Fix(
        bundle=bundle,
        status=status,
        position=place if has_place else None,
        covariance_m2=covariance_m2 if has_place else None,
        probability=0.9 if has_place else 0.0,
        candidates=(candidate,) if has_place else (),
        stage1=STAGE1,
        residual={"N": 0.8} if has_place else {},
        nuisance=Nuisance(azimuth_bias_deg=0.4, tilt_bias_deg=0.0, altitude_bias_m=2.1)
        if has_place
        else None,
        timing_s={"stage1": 0.02},
    )
    return Answer(
        bundle=bundle,
        captured=Instant(captured_s, utc),
        answered=Instant(captured_s + took_s, utc + timedelta(seconds=took_s)),
        trigger="command",
        fix=fix,
        mode="whole DEM",
        hypotheses=(),
        elsewhere=0.0,
        altitude_m=altitude_m if has_place else None,
        vehicle_heading_deg=heading_deg if has_place else None,
        vehicle_heading_sigma_deg=0.3 if has_place else None,
    )
