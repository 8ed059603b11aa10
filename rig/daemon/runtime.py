"""The daemon with one configuration: all that runs side by side, and what it is composed of."""

import queue
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import structlog

from rig.config.model import RigConfig
from rig.daemon.captures import Captures
from rig.daemon.control import ControlSocket
from rig.daemon.device_monitor import DeviceWatch, Hardware, obstacle
from rig.daemon.heartbeat import Loops
from rig.daemon.main_loop import Inbox, MainLoop, keep_odometer, run_of, start_worker
from rig.daemon.notify import Notifier
from rig.daemon.odometry.receiver import Odometer, OdometryListener
from rig.daemon.publishers import publish
from rig.daemon.search.locate_loop import Search, restore
from rig.daemon.search.process import SearchProcess
from rig.daemon.signals import Signals
from rig.daemon.spool.store import ODOMETER, Spool
from rig.daemon.state import Board
from rig.daemon.stationary_trigger import RestWatch
from rig.daemon.triggers import Triggers

_log = structlog.get_logger(__name__)

END_S = 3.0
"""Loops that have not ended by then when the daemon ends, end with the process."""
RELOAD_END_S = 30.0
WISH_POLL_S = 0.25
STORAGE_EVERY_S = 10.0
USUAL_BEAT_S, SLOW_BEAT_S, CAPTURE_BEAT_S = 30.0, 120.0, 300.0
"""From one sign of life to the next: of a loop that only waits; of one that opens devices; of captures, where levelling and
heading are one step, of several moves, repetitions and recoveries, on a computer that may be busy."""

Run = Callable[[Callable[[], None], threading.Event], None]


@dataclass
class Shared:
    """What outlives one configuration. ``worker`` is a search process that has read the DEM of the next session."""

    path: Path
    board: Board
    signals: Signals
    notifier: Notifier
    loops: Loops = field(default_factory=Loops)
    inbox: Inbox = field(default_factory=queue.SimpleQueue)
    worker: SearchProcess | None = None


def session(config: RigConfig, shared: Shared, started: Callable[[], None]) -> RigConfig:
    """Run with a configuration until another one is asked for, which is returned.

    ``started`` is called when everything runs and every device has been tried; a ``SkyfixError`` before that says what cannot.
    ``StopRequestedError`` ends it.
    """
    run, board = run_of(config, shared.path), shared.board
    with ExitStack() as stack:
        spool = stack.enter_context(Spool(run.spool.dir, run.spool.quota_mb, board.set_waiting))
        search = Search(spool, board, partial(start_worker, run), shared.worker or start_worker(run))
        shared.worker = None
        stack.callback(search.close)
        restore(board, spool)
        stop = threading.Event()
        inbox = shared.inbox
        hardware = Hardware()
        triggers = Triggers(board, partial(_obstacle, board, spool), inbox.put)
        watch = DeviceWatch(config, board, hardware, besides=("inclinometer",) if run.rest else ())
        control = ControlSocket(run.control or run.spool.dir / "control.sock", board, triggers)
        stack.callback(control.close)
        loops: list[tuple[str, Run, float]] = [
            ("control", control.run, USUAL_BEAT_S),
            ("devices", watch.run, SLOW_BEAT_S),
            ("search", search.run, USUAL_BEAT_S),
            ("storage", partial(_watch_storage, board, spool), SLOW_BEAT_S),
            ("signals", partial(_take_wishes, shared.signals, triggers, inbox), USUAL_BEAT_S),
        ]
        if run.rest:
            rest = RestWatch(config, board, hardware, partial(_at_rest, board, triggers))
            loops.append(("rest", rest.run, SLOW_BEAT_S))
        odometer = None
        if run.odometry:
            odometer = Odometer(run.odometry, time.monotonic(), spool.recall(ODOMETER))
            stack.callback(keep_odometer, spool, odometer)
            stack.callback(odometer.take_back)  # a capture that the end interrupts
            listener = OdometryListener(run.odometry, odometer, board.set_moving)
            stack.callback(listener.close)
            _log.info("odometry", udp="{}:{}".format(*listener.address))
            loops.append(("odometry", listener.run, USUAL_BEAT_S))
        publish(stack, run, board, triggers, spool, shared.loops)
        captures = Captures(config, board, spool, shared.signals, hardware, watch, odometer)
        main_loop = MainLoop(
            run, shared.path, board, shared.notifier, triggers, captures, search, spool, odometer, inbox
        )
        with _running(loops, shared, stop, inbox), shared.loops.watched("captures", CAPTURE_BEAT_S):
            try:
                following = main_loop.run(partial(shared.loops.beat, "captures"), started)
            finally:
                triggers.stop()
                if shared.signals.stopping:
                    main_loop.give_up()
                    board.set_activity("stopping")
                    shared.notifier.stopping("ending on request")
        shared.worker = following.worker or search.hand_over()
        return following.config


def _obstacle(board: Board, spool: Spool) -> str | None:
    """Why no capture is possible, the room in the spool looked at now: the next answer is ``started`` only where it will be."""
    _look_at_storage(board, spool)
    return obstacle(board)


def _watch_storage(board: Board, spool: Spool, beat: Callable[[], None], stop: threading.Event) -> None:
    """A disk is filled by others, and emptied by whoever has read why nothing is captured."""
    while not stop.is_set():
        beat()
        _look_at_storage(board, spool)
        stop.wait(STORAGE_EVERY_S)


def _look_at_storage(board: Board, spool: Spool) -> None:
    problem, before = spool.obstacle(), board.snapshot().storage
    board.set_storage(problem)
    if problem is not None and before is None:
        board.count("spool full")
        _log.error("no room for another bundle", problem=problem)
    elif problem is None and before is not None:
        _log.info("there is room for bundles again")


def _at_rest(board: Board, triggers: Triggers) -> bool:
    return obstacle(board) is None and triggers.trigger("rest") == "started"


def _take_wishes(
    signals: Signals, triggers: Triggers, inbox: Inbox, beat: Callable[[], None], stop: threading.Event
) -> None:
    """A loop of its own: the main thread, which gets the signals, may be in the middle of a capture."""
    while not stop.is_set():
        beat()
        try:
            wish = signals.wishes.get(timeout=WISH_POLL_S)
        except queue.Empty:
            continue
        if wish == "trigger":
            triggers.trigger("signal")
        else:
            inbox.put(wish)


@contextmanager
def _running(
    loops: Sequence[tuple[str, Run, float]],
    shared: Shared,
    stop: threading.Event,
    inbox: Inbox,
) -> Iterator[None]:
    """A thread for each loop while the context lasts. One that ends with an error puts that into the inbox."""

    def run(name: str, loop: Run, longest_s: float) -> None:
        try:
            with shared.loops.watched(name, longest_s):
                loop(lambda: shared.loops.beat(name), stop)
        except BaseException as error:  # noqa: BLE001 - the main thread raises it
            inbox.put(error)

    threads = [threading.Thread(target=run, args=loop, name=loop[0], daemon=True) for loop in loops]
    for thread in threads:
        thread.start()
    try:
        yield
    finally:
        stop.set()
        deadline_s = time.monotonic() + (END_S if shared.signals.stopping else RELOAD_END_S)
        for thread in threads:
            thread.join(max(0.0, deadline_s - time.monotonic()))
