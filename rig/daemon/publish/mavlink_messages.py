"""Encodes a fix as MAVLink messages (common.xml). No I/O."""

import math
from datetime import UTC, datetime, timedelta
from types import ModuleType
from typing import Any

from rig.clock import Instant, problem
from rig.daemon.publish.published import PublishedFix
from rig.errors import ConfigError

AUTOPILOT_COMPONENT = 1
GPS_EPOCH = datetime(1980, 1, 6, tzinfo=UTC)
GPS_AHEAD_OF_UTC_S = 18
"""Leap seconds since GPS's epoch (IERS Bulletin C); the last was at the end of 2016."""
WEEK = timedelta(weeks=1)
TIME_WRAPS_S = 250.0
"""What common.xml wants for param1: ten microseconds are left of a 32 bit float."""


def dialect() -> ModuleType:
    """pymavlink's messages, MAVLink 2. Raises ``ConfigError`` if it is not installed; it is an optional extra."""
    try:
        from pymavlink.dialects.v20 import common
    except ImportError:
        raise ConfigError("[run.mavlink] needs pymavlink: pip install 'skyfix[mavlink]'") from None
    return common  # type: ignore[no-any-return]


def heartbeat(common: ModuleType) -> Any:
    """The heartbeat of this component."""
    return common.MAVLink_heartbeat_message(
        common.MAV_TYPE_ONBOARD_CONTROLLER, common.MAV_AUTOPILOT_INVALID, 0, 0, common.MAV_STATE_ACTIVE, 3
    )


def external_position_estimate(common: ModuleType, fix: PublishedFix, now: Instant, system_id: int) -> Any:
    """The command for occasional fixes: position at the capture, and its age."""
    return common.MAVLink_command_int_message(
        target_system=system_id,
        target_component=AUTOPILOT_COMPONENT,
        frame=common.MAV_FRAME_GLOBAL,
        command=common.MAV_CMD_EXTERNAL_POSITION_ESTIMATE,
        current=0,
        autocontinue=0,
        param1=now.monotonic_s % TIME_WRAPS_S,
        param2=fix.age_s(now),
        param3=fix.sigma_major_m,  # one number for both directions: the worse
        param4=0.0,
        x=_deg_e7(fix.lat_deg),
        y=_lon_e7(fix.lon_deg),
        z=math.nan,
    )


def gps_input(common: ModuleType, fix: PublishedFix | None, utc: datetime) -> Any:
    """As from a GPS without satellites: a fix, once, or no fix at the time ``utc``.

    The time is 0 (none) if the computer's clock is implausible, as an autopilot may set its own by it.
    """
    at = utc if fix is None else fix.utc
    if problem(at):
        at = GPS_EPOCH - timedelta(seconds=GPS_AHEAD_OF_UTC_S)
    week, in_week = divmod(at - GPS_EPOCH + timedelta(seconds=GPS_AHEAD_OF_UTC_S), WEEK)
    ignored = (
        common.GPS_INPUT_IGNORE_FLAG_HDOP
        | common.GPS_INPUT_IGNORE_FLAG_VDOP
        | common.GPS_INPUT_IGNORE_FLAG_VEL_HORIZ
        | common.GPS_INPUT_IGNORE_FLAG_VEL_VERT
        | common.GPS_INPUT_IGNORE_FLAG_SPEED_ACCURACY
        | common.GPS_INPUT_IGNORE_FLAG_VERTICAL_ACCURACY
    )
    altitude_m = None if fix is None else fix.altitude_m
    if altitude_m is None:
        ignored |= common.GPS_INPUT_IGNORE_FLAG_ALT
    if fix is None:
        ignored |= common.GPS_INPUT_IGNORE_FLAG_HORIZONTAL_ACCURACY
    fix_type = common.GPS_FIX_TYPE_NO_FIX
    if fix is not None:
        fix_type = common.GPS_FIX_TYPE_2D_FIX if altitude_m is None else common.GPS_FIX_TYPE_3D_FIX
    return common.MAVLink_gps_input_message(
        time_usec=round(at.timestamp() * 1e6) if week else 0,
        gps_id=0,
        ignore_flags=ignored,
        time_week_ms=in_week // timedelta(milliseconds=1),
        time_week=week,
        fix_type=fix_type,
        lat=0 if fix is None else _deg_e7(fix.lat_deg),
        lon=0 if fix is None else _lon_e7(fix.lon_deg),
        alt=0.0 if altitude_m is None else altitude_m,
        hdop=0.0,
        vdop=0.0,
        vn=0.0,
        ve=0.0,
        vd=0.0,
        speed_accuracy=0.0,
        horiz_accuracy=0.0 if fix is None else fix.sigma_major_m,
        vert_accuracy=0.0,
        satellites_visible=0,
        yaw=_yaw_cdeg(None if fix is None else fix.heading_deg),
    )


def _deg_e7(angle_deg: float) -> int:
    return round(angle_deg * 1e7)


def _lon_e7(lon_deg: float) -> int:
    """-180 <= lon < 180, after rounding, too."""
    return (_deg_e7(lon_deg) + 1_800_000_000) % 3_600_000_000 - 1_800_000_000


def _yaw_cdeg(heading_deg: float | None) -> int:
    """1 to 36000, north being 36000; 0 is that there is none."""
    return 0 if heading_deg is None else round(heading_deg * 100.0) % 36000 or 36000
