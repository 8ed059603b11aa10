"""Capture requests: each is answered at once and counted; at most one is carried out at a time."""

import threading
from collections.abc import Callable

import structlog

from rig.daemon.state import DaemonState, TriggerAnswer, TriggerSource

_log = structlog.get_logger(__name__)


class Triggers:
    """Takes requests from any thread (not from a signal handler: it locks) and passes them to the capturing thread.

    ``why_not_ready`` returns why no capture is possible now, or None.
    """

    def __init__(
        self,
        daemon_state: DaemonState,
        why_not_ready: Callable[[], str | None],
        start: Callable[[TriggerSource], None],
    ):
        self._state = daemon_state
        self._why_not_ready = why_not_ready
        self._start = start
        self._lock = threading.Lock()
        self._busy = False
        self._stopping = False

    def trigger(self, source: TriggerSource) -> TriggerAnswer:
        """Request a capture; answered at once, nothing is queued."""
        why_not_ready = self._why_not_ready()
        with self._lock:
            answer: TriggerAnswer = (
                "stopping"
                if self._stopping
                else "busy"
                if self._busy
                else "not ready"
                if why_not_ready
                else "started"
            )
            self._state.count("triggers")
            self._state.count(f"triggers {answer}")
            self._state.emit("trigger", source=source, answer=answer, why=why_not_ready)
            _log.info(
                "trigger", source=source, answer=answer, **({"why": why_not_ready} if why_not_ready else {})
            )
            if answer == "started":  # passed on before ``stop`` can be called
                self._busy = True
                self._start(source)
        return answer

    def done(self) -> None:
        """The started capture has ended, with or without success."""
        with self._lock:
            self._busy = False

    def stop(self) -> None:
        """Answer every further request with ``stopping``."""
        with self._lock:
            self._stopping = True
