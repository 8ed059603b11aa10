"""Odometry between captures, received over UDP: speed and course (NMEA VTG, RMC), or legs (JSON)."""

import math
import threading
from collections.abc import Callable

import numpy as np
import structlog
from pydantic import BaseModel, ConfigDict, ValidationError

from localizer.track.odometry import Movement, parse_leg
from rig import timebase
from rig.config.run import OdometryInput
from rig.daemon.boot import boot_id
from rig.daemon.odometry.velocity import StaleClock, Velocity, velocity_in
from rig.daemon.sockets import bound_udp
from rig.devices.sensors.nmea import parse_sentence
from rig.errors import MessageError

_log = structlog.get_logger(__name__)

GAP_S = 3.0
"""Between speeds further apart than this the motion is unknown ..."""
MAX_GAP_S = 60.0
"""... but bounded, up to this gap; beyond it the leg is unknown."""
GAP_SPEED_M_S = 1.0
"""Least uncertainty per second of a gap; the neighbouring speed if that is larger."""
MISSED_LEGS_M_S = 15.0
"""Uncertainty per second in which legs may have been missed: nothing bounds the speed."""
INDEPENDENT_M = 50.0
"""Errors of slip and steering are independent after this distance."""
FLOOR_M = 0.5
STATIONARY_M_S = 0.3
"""Up to this speed it may be the noise of a stationary vehicle."""
LARGEST_DATAGRAM = 4096


class OdometryState(BaseModel):
    """Dead reckoning since the last capture; stored as JSON, so that a restart continues it.

    ``step_m`` (east, north); ``random_m2`` the variance per direction of errors independent along the way;
    ``aimless_m`` the distance driven without a known course; ``legs_m2`` the covariance sent with legs; ``unknown``
    once any part is.
    """

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    boot: str
    began_s: float
    """Monotonic, like the other times."""
    unknown: bool = False
    fed: bool = False
    step_m: tuple[float, float] = (0.0, 0.0)
    random_m2: float = 0.0
    aimless_m: float = 0.0
    legs_step_m: tuple[float, float] = (0.0, 0.0)
    legs_m2: tuple[tuple[float, float], tuple[float, float]] = ((0.0, 0.0), (0.0, 0.0))
    leg_heard_s: float | None = None
    """Time of the latest leg, in this leg or before."""
    speed_m_s: tuple[float, float] | None = None
    """Last velocity, east and north; only its size counts if ``without_course``. Received at this monotonic time:"""
    heard_s: float = 0.0
    without_course: bool = False


class Odometer:
    """Dead reckoning. Thread-safe; times are monotonic."""

    def __init__(self, section: OdometryInput, at_s: float, state: str | None = None) -> None:
        """``state`` is the result of ``to_json`` before a restart that ends at ``at_s``.

        Without it, or with one of another boot, the motion up to the next capture is unknown.
        """
        self._section = section
        self._lock = threading.Lock()
        self._odometry_state = _way_after_restart(state, at_s) or OdometryState(
            boot=boot_id(), began_s=at_s, unknown=True
        )
        self._before: OdometryState | None = None

    def to_json(self) -> str:
        """The state for a restart."""
        with self._lock:
            return self._odometry_state.model_dump_json()

    def velocity(self, velocity: Velocity, at_s: float) -> None:
        """Add a measured velocity."""
        with self._lock:
            course = math.radians(velocity.course_deg or 0.0)
            now = velocity.speed_m_s * math.sin(course), velocity.speed_m_s * math.cos(course)
            without_course = velocity.course_deg is None
            if self._odometry_state.speed_m_s is None:  # there was a gap before the first one, too
                self._odometry_state.speed_m_s, self._odometry_state.heard_s = (
                    now,
                    self._odometry_state.began_s,
                )
            self._add(now, at_s, without_course or self._odometry_state.without_course)
            self._odometry_state.speed_m_s, self._odometry_state.heard_s, self._odometry_state.fed = (
                now,
                at_s,
                True,
            )
            self._odometry_state.without_course = without_course

    def leg(self, leg: Movement | None, at_s: float) -> None:
        """Add a leg since the last one; None: an unknown one."""
        with self._lock:
            self._odometry_state.fed, self._odometry_state.leg_heard_s = True, at_s
            if leg is None:
                self._odometry_state.unknown = True
                return
            east, north = self._odometry_state.legs_step_m
            self._odometry_state.legs_step_m = east + float(leg.step_m[0]), north + float(leg.step_m[1])
            c = np.array(self._odometry_state.legs_m2) + leg.covariance_m2
            self._odometry_state.legs_m2 = (float(c[0, 0]), float(c[0, 1])), (float(c[1, 0]), float(c[1, 1]))

    def mark_unknown(self) -> None:
        """Mark the motion as unknown up to the next capture."""
        with self._lock:
            self._odometry_state.unknown = True

    def movement(self, at_s: float) -> Movement | None:
        """The motion since the last ``begin``; None if it is unknown."""
        with self._lock:
            if self._odometry_state.speed_m_s is not None and at_s - self._odometry_state.heard_s > GAP_S:
                self._add(self._odometry_state.speed_m_s, at_s, self._odometry_state.without_course)
                self._odometry_state.heard_s = at_s
            if self._odometry_state.unknown or not self._odometry_state.fed:
                return None
            section, step_m = self._section, np.array(self._odometry_state.step_m)
            aside_m = np.array([step_m[1], -step_m[0]]) * math.radians(section.heading_sigma_deg)
            along_m = step_m * section.speed_sigma_share
            covariance_m2 = (
                np.outer(along_m, along_m)
                + np.outer(aside_m, aside_m)
                + np.eye(2)
                * (self._odometry_state.random_m2 + FLOOR_M**2 + self._odometry_state.aimless_m**2 / 2.0)
                + np.array(self._odometry_state.legs_m2)
            )
            return Movement(step_m + np.array(self._odometry_state.legs_step_m), covariance_m2)

    def begin(self, at_s: float) -> Movement | None:
        """Return ``movement`` and start a new leg at a capture; input continues meanwhile.

        ``keep`` or ``undo_capture`` must follow.
        """
        movement = self.movement(at_s)
        with self._lock:
            before = self._before = self._odometry_state
            self._odometry_state = OdometryState(
                boot=before.boot,
                began_s=at_s,
                leg_heard_s=before.leg_heard_s,
                fed=before.fed,
                speed_m_s=before.speed_m_s,
                heard_s=before.heard_s,
                without_course=before.without_course,
            )
        return movement

    def keep(self) -> None:
        """The capture produced a bundle."""
        with self._lock:
            self._before = None

    def undo_capture(self) -> None:
        """The capture failed: continue from the one before. Without a begun capture nothing changes."""
        with self._lock:
            before, now = self._before, self._odometry_state
            if before is None:
                return
            legs_m2 = np.array(before.legs_m2) + np.array(now.legs_m2)
            self._odometry_state = now.model_copy(
                update={
                    "began_s": before.began_s,
                    "unknown": before.unknown or now.unknown,
                    "fed": before.fed or now.fed,
                    "step_m": _sum(before.step_m, now.step_m),
                    "random_m2": before.random_m2 + now.random_m2,
                    "aimless_m": before.aimless_m + now.aimless_m,
                    "legs_step_m": _sum(before.legs_step_m, now.legs_step_m),
                    "legs_m2": (tuple(legs_m2[0].tolist()), tuple(legs_m2[1].tolist())),
                }
            )
            self._before = None

    def _add(self, now_m_s: tuple[float, float], at_s: float, aimless: bool) -> None:
        """Add the distance since the last speed, at the mean of both; in an unknown direction if ``aimless``."""
        way, section = self._odometry_state, self._section
        assert way.speed_m_s is not None
        seconds = max(0.0, at_s - way.heard_s)
        mean = (np.array(way.speed_m_s) + np.array(now_m_s)) / 2.0
        if seconds > MAX_GAP_S:
            way.unknown = True
            return
        if seconds > GAP_S:
            fastest = max(math.hypot(*way.speed_m_s), math.hypot(*now_m_s), GAP_SPEED_M_S)
            way.random_m2 += (fastest * seconds) ** 2
        if aimless:
            way.aimless_m += (math.hypot(*way.speed_m_s) + math.hypot(*now_m_s)) / 2.0 * seconds
            return
        step_m = mean * seconds
        share = max(section.speed_sigma_share, math.radians(section.heading_sigma_deg))
        way.random_m2 += share**2 * float(np.hypot(*step_m)) * INDEPENDENT_M
        way.step_m = way.step_m[0] + float(step_m[0]), way.step_m[1] + float(step_m[1])


def _way_after_restart(state: str | None, at_s: float) -> OdometryState | None:
    """The restored state; None if it cannot be used.

    Speeds show the gap by their times. Legs do not: those sent during the gap are missing.
    """
    if state is None:
        return None
    try:
        way = OdometryState.model_validate_json(state)
    except ValidationError:  # of another version
        return None
    if way.boot != boot_id():
        return None
    if way.leg_heard_s is not None or way.speed_m_s is None:
        unseen_s = at_s - (way.began_s if way.leg_heard_s is None else way.leg_heard_s)
        way.unknown = way.unknown or unseen_s > MAX_GAP_S
        way.random_m2 += (MISSED_LEGS_M_S * unseen_s) ** 2
    return way


def _sum(first: tuple[float, float], second: tuple[float, float]) -> tuple[float, float]:
    return first[0] + second[0], first[1] + second[1]


class OdometryListener:
    """Receives datagrams of NMEA 0183 or JSON lines until stopped."""

    def __init__(
        self, section: OdometryInput, odometer: Odometer, moving: Callable[[], None] = lambda: None
    ) -> None:
        """``moving`` is called at each speed above standstill. ``RigError`` if the address cannot be bound."""
        self._socket = bound_udp(section.listen, "[run.odometry] listen")
        self._odometer = odometer
        self._moving = moving
        self._bad = 0
        self._without_course = False
        self._section = section
        self._clock = StaleClock()

    @property
    def address(self) -> tuple[str, int]:
        """The bound address."""
        host, port = self._socket.getsockname()[:2]
        return host, port

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def run(self, beat: Callable[[], None], stop: threading.Event) -> None:
        """Listen until ``stop``."""
        self._socket.settimeout(0.5)
        while not stop.is_set():
            beat()
            try:
                datagram = self._socket.recv(LARGEST_DATAGRAM)
            except TimeoutError:
                continue
            for line in datagram.splitlines():
                if line.strip():
                    self._take(line.strip(), timebase.monotonic_s())

    def _take(self, line: bytes, at_s: float) -> None:
        try:
            if line.startswith(b"{"):
                self._odometer.leg(parse_leg(line), at_s)
            elif velocity := self._velocity_in(line, at_s):
                self._odometer.velocity(velocity, at_s)
                self._note_course(velocity)
                if velocity.speed_m_s > STATIONARY_M_S:
                    self._moving()
        except (MessageError, ValueError) as error:
            self._bad += 1
            if (
                self._bad & (self._bad - 1) == 0
            ):  # logged for counts 1, 2, 4, 8, ...: a faulty talker must not flood the log
                _log.warning("odometry not understood", problem=str(error), so_far=self._bad)

    def _velocity_in(self, line: bytes, at_s: float) -> Velocity | None:
        sentence = parse_sentence(line, require_checksum=self._section.require_checksum)
        if self._clock.is_stale(sentence, at_s):
            raise MessageError(f"{sentence.address} repeats the time {sentence.field(0)}: an old reading")
        return velocity_in(sentence, accept_estimated=self._section.accept_estimated)

    def _note_course(self, velocity: Velocity) -> None:
        """Log a missing course once while it lasts; not at rest, where it means nothing."""
        if velocity.speed_m_s <= STATIONARY_M_S or self._without_course == (velocity.course_deg is None):
            return
        self._without_course = velocity.course_deg is None
        if self._without_course:
            _log.warning("odometry says no course", way="counted in any direction")
        else:
            _log.info("odometry says its course again")
