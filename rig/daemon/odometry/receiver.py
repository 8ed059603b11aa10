"""How the vehicle moved between captures, from what is fed over UDP: speeds and courses (NMEA VTG, RMC), or legs (JSON)."""

import math
import threading
import time
from collections.abc import Callable

import numpy as np
import structlog
from pydantic import BaseModel, ConfigDict, ValidationError

from localizer.track.odometry import Movement, parse_leg
from rig.config.run import OdometryInput
from rig.daemon.boot import boot_id
from rig.daemon.odometry.velocity import StaleClock, Velocity, velocity_in
from rig.daemon.sockets import bound_udp
from rig.devices.sensors.nmea import parse_sentence
from rig.errors import MessageError

_log = structlog.get_logger(__name__)

GAP_S = 3.0
"""Speeds further apart than this say nothing of what was between them ..."""
MAX_GAP_S = 60.0
"""... but that it was not far, up to here; beyond it the way is unknown."""
GAP_SPEED_M_S = 1.0
"""At least so much is uncertain in each second of a gap; the speed beside it where that is more."""
MISSED_LEGS_M_S = 15.0
"""So much is uncertain in each second in which legs may have been missed: nothing tells how fast it was."""
INDEPENDENT_M = 50.0
"""Slip and steering after so much way are independent of those before."""
FLOOR_M = 0.5
STATIONARY_M_S = 0.3
"""Up to here it may be the noise of a vehicle that stands."""
LARGEST_DATAGRAM = 4096


class OdometryState(BaseModel):
    """The way since the last capture; JSON both ways, so that a restart goes on with it.

    ``step_m`` (east, north); ``random_m2`` the variance in each direction of what is independent along the way;
    ``aimless_m`` how far it went in directions that nobody told; ``legs_m2`` the covariance that legs brought with them;
    ``unknown`` once part of the way is.
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
    """When the latest leg was heard of, of this way or one before."""
    speed_m_s: tuple[float, float] | None = None
    """East and north, when last heard of; of one without a course only the size counts. At that monotonic time:"""
    heard_s: float = 0.0
    without_course: bool = False


class Odometer:
    """Adds up the way. Used from several threads; times are monotonic."""

    def __init__(self, section: OdometryInput, at_s: float, state: str | None = None) -> None:
        """``state`` is what ``to_json`` gave before a restart, which ends at ``at_s``.

        Without one, or with one of another run of the computer, nothing is known of the way up to the next capture.
        """
        self._section = section
        self._lock = threading.Lock()
        self._odometry_state = _way_after_restart(state, at_s) or OdometryState(
            boot=boot_id(), began_s=at_s, unknown=True
        )
        self._before: OdometryState | None = None

    def to_json(self) -> str:
        """For a restart."""
        with self._lock:
            return self._odometry_state.model_dump_json()

    def velocity(self, velocity: Velocity, at_s: float) -> None:
        """The vehicle moves so at this moment."""
        with self._lock:
            course = math.radians(velocity.course_deg or 0.0)
            now = velocity.speed_m_s * math.sin(course), velocity.speed_m_s * math.cos(course)
            without_course = velocity.course_deg is None
            if self._odometry_state.speed_m_s is None:  # before the first one there was a silence, too
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
        """The vehicle has moved by so much since the last one; None: anywhere."""
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
        """Nobody knows where the way began: it is unknown up to the next capture."""
        with self._lock:
            self._odometry_state.unknown = True

    def movement(self, at_s: float) -> Movement | None:
        """From the last ``restart`` to this moment; None where it is unknown."""
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
        """``movement``, and the way begins anew: a capture is taken here. What is fed goes on.

        ``keep`` or ``undo_capture`` follows.
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
        """The capture has its bundle."""
        with self._lock:
            self._before = None

    def undo_capture(self) -> None:
        """The capture came to nothing: the way since the one before goes on. Where none has begun, nothing changes."""
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
        """The way since the last speed, at the mean of both; in any direction where ``aimless``."""
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
    """The way that goes on; None where nothing is left of it.

    Speeds show by themselves how long nobody listened. Legs do not: each that came meanwhile, or that was heard but not
    kept any more, is missing, and went on from the latest that is known.
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
    """Hears datagrams, each of them lines of NMEA 0183 or of JSON, until it is told to stop."""

    def __init__(
        self, section: OdometryInput, odometer: Odometer, moving: Callable[[], None] = lambda: None
    ) -> None:
        """``moving`` is called at each speed of a vehicle that moves. ``RigError`` where the address cannot be listened on."""
        self._socket = bound_udp(section.listen, "[run.odometry] listen")
        self._odometer = odometer
        self._moving = moving
        self._bad = 0
        self._without_course = False
        self._section = section
        self._clock = StaleClock()

    @property
    def address(self) -> tuple[str, int]:
        """Where it listens."""
        host, port = self._socket.getsockname()[:2]
        return host, port

    def close(self) -> None:
        """Give the port back."""
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
                    self._take(line.strip(), time.monotonic())

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
            ):  # 1, 2, 4, 8, ...: a talker that talks nonsense does not fill the log
                _log.warning("odometry not understood", problem=str(error), so_far=self._bad)

    def _velocity_in(self, line: bytes, at_s: float) -> Velocity | None:
        sentence = parse_sentence(line, require_checksum=self._section.require_checksum)
        if self._clock.is_stale(sentence, at_s):
            raise MessageError(f"{sentence.address} repeats the time {sentence.field(0)}: an old reading")
        return velocity_in(sentence, accept_estimated=self._section.accept_estimated)

    def _note_course(self, velocity: Velocity) -> None:
        """Said once for as long as it lasts; at rest there is nothing to be said."""
        if velocity.speed_m_s <= STATIONARY_M_S or self._without_course == (velocity.course_deg is None):
            return
        self._without_course = velocity.course_deg is None
        if self._without_course:
            _log.warning("odometry says no course", way="counted in any direction")
        else:
            _log.info("odometry says its course again")
