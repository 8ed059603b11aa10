"""Rate limit for log lines: the first few of a kind are written, the others counted.

External causes (refused clients, line noise, a flapping link) can occur many times a second and would flush everything
else out of the journal. A kind is the logger, the level and the text before its values are inserted; values that
identify the subject of an event (``device``, ``bundle``) belong to its kind, too.
"""

import logging
import re
import threading
from collections.abc import Callable
from dataclasses import dataclass

from rig import timebase

FIRST, EVERY_S = 10, 60.0
"""Burst of warnings and errors per kind, then one per this interval, with the number suppressed."""
FIRST_NOTES, EVERY_NOTE_S = 60, 2.0
"""The same for informational lines."""
MAX_KINDS = 256
WHOSE = ("device", "name", "bundle", "source", "trigger", "answer", "step")
PLACEHOLDER = re.compile(r"%[-#0 +]*\d*(?:\.\d+)?[a-zA-Z%]")

Kind = tuple[str, int, str]


@dataclass
class _Budget:
    left: float
    at_s: float
    suppressed: int = 0


class RateLimitHandler(logging.Handler):
    """Handler that passes records on to other handlers, rate-limited by kind."""

    def __init__(
        self, *handlers: logging.Handler, on_suppressed: Callable[[int], None] = lambda count: None
    ) -> None:
        """``on_suppressed`` is called with the number of suppressed lines."""
        super().__init__()
        self._handlers = handlers
        self._on_suppressed = on_suppressed
        self._budgets: dict[Kind, _Budget] = {}
        self._budgets_lock = threading.Lock()

    def emit(self, record: logging.LogRecord) -> None:
        """Pass a record on, or count it. Counts are written before the next record of any kind, once due."""
        now_s = timebase.monotonic_s()
        with self._budgets_lock:
            passed, due = self._spent(kind_of(record), now_s), self._due(now_s)
        for kind, count in due:
            self._pass_on(_summary(kind, count))
        if passed:
            self._pass_on(record)
        else:
            self._on_suppressed(1)

    def close(self) -> None:
        """Write the remaining counts."""
        with self._budgets_lock:
            rest = [(kind, budget.suppressed) for kind, budget in self._budgets.items() if budget.suppressed]
            self._budgets.clear()
        for kind, count in rest:
            self._pass_on(_summary(kind, count))
        super().close()

    def _pass_on(self, record: logging.LogRecord) -> None:
        for handler in self._handlers:
            handler.handle(record)

    def _spent(self, kind: Kind, now_s: float) -> bool:
        first, every_s = _rate(kind)
        budget = self._budgets.get(kind)
        if budget is None:
            if len(self._budgets) >= MAX_KINDS:
                oldest = min(self._budgets, key=lambda each: self._budgets[each].at_s)
                del self._budgets[oldest]
            budget = self._budgets[kind] = _Budget(first, now_s)
        budget.left = min(first, budget.left + (now_s - budget.at_s) / every_s)
        budget.at_s = now_s
        if budget.left < 1.0:
            budget.suppressed += 1
            return False
        budget.left -= 1.0
        return True

    def _due(self, now_s: float) -> list[tuple[Kind, int]]:
        """Kinds with suppressed lines that may be written again."""
        due = []
        for kind, budget in self._budgets.items():
            if budget.suppressed and budget.left + (now_s - budget.at_s) / _rate(kind)[1] >= 1.0:
                due.append((kind, budget.suppressed))
                budget.suppressed = 0
                budget.left -= 1.0
        return due


def kind_of(record: logging.LogRecord) -> Kind:
    """The kind of a record."""
    message = record.msg
    if isinstance(message, dict):  # structlog's events
        whose = " ".join(f"{key}={message[key]}" for key in WHOSE if key in message)
        return record.name, record.levelno, f"{message.get('event', '')} {whose}".strip()
    text = str(message)
    if not any(letter.isalpha() for letter in PLACEHOLDER.sub("", text)):  # all of it is values
        text = record.getMessage()
    return record.name, record.levelno, text


def _rate(kind: Kind) -> tuple[float, float]:
    """Burst and interval of a kind."""
    return (FIRST, EVERY_S) if kind[1] >= logging.WARNING else (FIRST_NOTES, EVERY_NOTE_S)


def _summary(kind: Kind, count: int) -> logging.LogRecord:
    name, level, text = kind
    lines = "line" if count == 1 else "lines"
    return logging.LogRecord(
        name, level, __file__, 0, "%d more %s like this left out: %s", (count, lines, text), None
    )
