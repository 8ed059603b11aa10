"""Runs the daemon with one configuration: creates all parts and their threads."""

import queue
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import structlog

from rig import timebase
from rig.config.model import RigConfig
from rig.daemon.captures import Captures
from rig.daemon.control import ControlSocket
from rig.daemon.device_locks import DeviceLocks
from rig.daemon.device_monitor import DeviceMonitor
from rig.daemon.heartbeat import Heartbeats
from rig.daemon.main_loop import MainLoop, RequestQueue, run_of, save_odometer, start_worker
from rig.daemon.notify import Notifier
from rig.daemon.odometry.receiver import Odometer, OdometryListener
from rig.daemon.publishers import publish
from rig.daemon.readiness import why_not_ready
from rig.daemon.search.answers import restore
from rig.daemon.search.locate_loop import LocateLoop
from rig.daemon.search.process import SearchProcess
from rig.daemon.signals import Signals
from rig.daemon.spool.store import ODOMETER, Spool
from rig.daemon.state import DaemonState
from rig.daemon.stationary_trigger import StationaryMonitor
from rig.daemon.triggers import Triggers

_log = structlog.get_logger(__name__)

END_S = 3.0
"""Loops still running after this at the end of the daemon end with the process."""
RELOAD_END_S = 30.0
REQUEST_POLL_S = 0.25
STORAGE_EVERY_S = 10.0
USUAL_BEAT_S, SLOW_BEAT_S, CAPTURE_BEAT_S = 30.0, 120.0, 300.0
"""Heartbeat limits: of a loop that only waits; of one that opens devices; of captures, where level and heading are one
step of several moves and retries, on a busy computer.
"""

Run = Callable[[Callable[[], None], threading.Event], None]


@dataclass
class DaemonContext:
    """What outlives one configuration. ``worker`` is a search process with the next configuration's DEM loaded."""

    path: Path
    daemon_state: DaemonState
    signals: Signals
    notifier: Notifier
    heartbeats: Heartbeats = field(default_factory=Heartbeats)
    requests: RequestQueue = field(default_factory=queue.SimpleQueue)
    worker: SearchProcess | None = None


def run_configuration(config: RigConfig, shared: DaemonContext, started: Callable[[], None]) -> RigConfig:
    """Run with a configuration until a reload; returns the next configuration.

    ``started`` is called when everything runs and all devices have been probed; a ``SkyfixError`` before that says what
    failed. ``StopRequestedError`` ends it.
    """
    run, daemon_state = run_of(config, shared.path), shared.daemon_state
    with ExitStack() as stack:
        spool = stack.enter_context(Spool(run.spool.dir, run.spool.quota_mb, daemon_state.set_waiting))
        search = LocateLoop(
            spool, daemon_state, partial(start_worker, run), shared.worker or start_worker(run)
        )
        shared.worker = None
        stack.callback(search.close)
        restore(daemon_state, spool)
        stop = threading.Event()
        requests = shared.requests
        device_locks = DeviceLocks()
        triggers = Triggers(daemon_state, partial(_why_not_ready, daemon_state, spool), requests.put)
        watch = DeviceMonitor(
            config, daemon_state, device_locks, excluded=("inclinometer",) if run.rest else ()
        )
        control = ControlSocket(run.control or run.spool.dir / "control.sock", daemon_state, triggers)
        stack.callback(control.close)
        heartbeats: list[tuple[str, Run, float]] = [
            ("control", control.run, USUAL_BEAT_S),
            ("devices", watch.run, SLOW_BEAT_S),
            ("search", search.run, USUAL_BEAT_S),
            ("storage", partial(_watch_storage, daemon_state, spool), SLOW_BEAT_S),
            ("signals", partial(_forward_signal_requests, shared.signals, triggers, requests), USUAL_BEAT_S),
        ]
        if run.rest:
            rest = StationaryMonitor(
                config, daemon_state, device_locks, partial(_at_rest, daemon_state, triggers)
            )
            heartbeats.append(("rest", rest.run, SLOW_BEAT_S))
        odometer = None
        if run.odometry:
            odometer = Odometer(run.odometry, timebase.monotonic_s(), spool.recall(ODOMETER))
            stack.callback(save_odometer, spool, odometer)
            stack.callback(odometer.undo_capture)  # for a capture interrupted by the end
            listener = OdometryListener(run.odometry, odometer, daemon_state.set_moving)
            stack.callback(listener.close)
            _log.info("odometry", udp="{}:{}".format(*listener.address))
            heartbeats.append(("odometry", listener.run, USUAL_BEAT_S))
        publish(stack, run, daemon_state, triggers, spool, shared.heartbeats)
        captures = Captures(config, daemon_state, spool, shared.signals, device_locks, watch, odometer)
        main_loop = MainLoop(
            run,
            shared.path,
            daemon_state,
            shared.notifier,
            triggers,
            captures,
            search,
            spool,
            odometer,
            requests,
        )
        with (
            _running(heartbeats, shared, stop, requests),
            shared.heartbeats.watched("captures", CAPTURE_BEAT_S),
        ):
            try:
                following = main_loop.run(partial(shared.heartbeats.beat, "captures"), started)
            finally:
                triggers.stop()
                if shared.signals.stopping:
                    main_loop.on_shutdown()
                    daemon_state.set_activity("stopping")
                    shared.notifier.stopping("ending on request")
        shared.worker = following.worker or search.release_worker()
        return following.config


def _why_not_ready(daemon_state: DaemonState, spool: Spool) -> str | None:
    """Why no capture is possible, with the spool's space checked now, so that ``started`` is answered only if it is."""
    _look_at_storage(daemon_state, spool)
    return why_not_ready(daemon_state)


def _watch_storage(
    daemon_state: DaemonState, spool: Spool, beat: Callable[[], None], stop: threading.Event
) -> None:
    """Check the disk space regularly: other programs fill it, and operators free it."""
    while not stop.is_set():
        beat()
        _look_at_storage(daemon_state, spool)
        timebase.wait(stop, STORAGE_EVERY_S)


def _look_at_storage(daemon_state: DaemonState, spool: Spool) -> None:
    problem, before = spool.space_problem(), daemon_state.snapshot().storage
    daemon_state.set_storage(problem)
    if problem is not None and before is None:
        daemon_state.count("spool full")
        _log.error("no room for another bundle", problem=problem)
    elif problem is None and before is not None:
        _log.info("there is room for bundles again")


def _at_rest(daemon_state: DaemonState, triggers: Triggers) -> bool:
    return why_not_ready(daemon_state) is None and triggers.trigger("rest") == "started"


def _forward_signal_requests(
    signals: Signals,
    triggers: Triggers,
    requests: RequestQueue,
    beat: Callable[[], None],
    stop: threading.Event,
) -> None:
    """A separate loop: the main thread, which receives the signals, may be in a capture."""
    while not stop.is_set():
        beat()
        try:
            request = signals.requests.get(timeout=REQUEST_POLL_S)
        except queue.Empty:
            continue
        if request == "trigger":
            triggers.trigger("signal")
        else:
            requests.put(request)


@contextmanager
def _running(
    heartbeats: Sequence[tuple[str, Run, float]],
    shared: DaemonContext,
    stop: threading.Event,
    requests: RequestQueue,
) -> Iterator[None]:
    """A thread for each loop while the context lasts. An error of a loop is passed to the main thread's requests."""

    def run(name: str, loop: Run, max_interval_s: float) -> None:
        try:
            with shared.heartbeats.watched(name, max_interval_s):
                loop(lambda: shared.heartbeats.beat(name), stop)
        except BaseException as error:  # noqa: BLE001 - the main thread raises it
            requests.put(error)

    threads = [threading.Thread(target=run, args=loop, name=loop[0], daemon=True) for loop in heartbeats]
    for thread in threads:
        thread.start()
    try:
        yield
    finally:
        stop.set()
        deadline_s = time.monotonic() + (END_S if shared.signals.stopping else RELOAD_END_S)
        for thread in threads:
            thread.join(max(0.0, deadline_s - time.monotonic()))
