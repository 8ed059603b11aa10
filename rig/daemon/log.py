"""The daemon's log: one line an event on standard error, values as ``key=value``; repeated lines are rate-limited.

Under systemd (``JOURNAL_STREAM`` is standard error) each line begins with its priority, ``<6>`` and the like, and the
journal adds the time; elsewhere it begins with the time. Messages of other modules get the same form.
"""

import logging
import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import partial

import structlog
from structlog.typing import EventDict, WrappedLogger

from rig.clock import utc_now
from rig.daemon.log_rate_limit import RateLimitHandler
from rig.daemon.state import DaemonState

PRIORITIES = {"critical": 2, "error": 3, "warning": 4, "info": 6, "debug": 7}
"""Priorities of syslog(3), as sd-daemon(3) puts them before a line."""


@contextmanager
def logging_to(daemon_state: DaemonState, environment: Mapping[str, str] = os.environ) -> Iterator[None]:
    """Log to standard error while the context lasts; subscribers of the daemon state receive the same lines as events
    ``log``.
    """
    before: list[structlog.typing.Processor] = [
        structlog.stdlib.add_log_level,
        structlog.processors.format_exc_info,
    ]
    structlog.configure(
        processors=[*before, structlog.stdlib.ProcessorFormatter.wrap_for_formatter],
        logger_factory=structlog.stdlib.LoggerFactory(),
        wrapper_class=structlog.make_filtering_bound_logger(logging.INFO),
        cache_logger_on_first_use=True,
    )
    begin = _priority if goes_to_the_journal(environment) else _time
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(_formatter([begin, _line]))
    rate_limit = RateLimitHandler(
        handler, _ToDaemonState(daemon_state), on_suppressed=partial(daemon_state.count, "log lines left out")
    )
    root = logging.getLogger()
    old, root.handlers = root.handlers, [rate_limit]
    root.setLevel(logging.INFO)
    # Recovered faults are in the bundle; a bad contact would flood the log with them.
    logging.getLogger("rig.fault_notes").setLevel(logging.WARNING)
    try:
        yield
    finally:
        rate_limit.close()
        root.handlers = old


def goes_to_the_journal(environment: Mapping[str, str]) -> bool:
    """Whether standard error is connected to the journal (systemd.exec(5), ``JOURNAL_STREAM``)."""
    stream = environment.get("JOURNAL_STREAM")
    if not stream:
        return False
    status = os.fstat(sys.stderr.fileno())
    return stream == f"{status.st_dev}:{status.st_ino}"


class _ToDaemonState(logging.Handler):
    """Passes log lines on as events."""

    def __init__(self, daemon_state: DaemonState) -> None:
        super().__init__(logging.INFO)
        self._state = daemon_state
        self.setFormatter(_formatter([_line]))

    def emit(self, record: logging.LogRecord) -> None:
        self._state.emit("log", level=record.levelname.lower(), text=self.format(record))


def _formatter(last: list[structlog.typing.Processor]) -> logging.Formatter:
    return structlog.stdlib.ProcessorFormatter(
        foreign_pre_chain=[structlog.stdlib.add_log_level, structlog.processors.format_exc_info],
        processors=[structlog.stdlib.ProcessorFormatter.remove_processors_meta, *last],
    )


_LOGFMT = structlog.processors.LogfmtRenderer(bool_as_flag=False)


def _text(event: EventDict) -> str:
    """``capture done bundle=20261126T043151Z-3f9a seconds=21.4``; a traceback follows in the same line, escaped."""
    what = event.pop("event", "")
    values = _LOGFMT(None, "", event)
    return " ".join(part for part in (str(what), str(values)) if part).replace("\n", "\\n")


def _line(_: WrappedLogger, __: str, event: EventDict) -> str:
    begin, level = event.pop("begin", ""), event.pop("level", "info")
    return f"{begin}{'' if level == 'info' else level + ': '}{_text(event)}"


def _priority(_: WrappedLogger, __: str, event: EventDict) -> EventDict:
    event["begin"] = f"<{PRIORITIES.get(event.get('level', 'info'), 6)}>"
    return event


def _time(_: WrappedLogger, __: str, event: EventDict) -> EventDict:
    event["begin"] = f"{utc_now():%Y-%m-%dT%H:%M:%SZ} "
    return event
