"""Event bus of a session: readings, states, frames and steps, published as the objects that they are.

``publish`` costs next to nothing without subscribers.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

Listener = Callable[[object], None]

_listeners: list[Listener] = []


@dataclass(frozen=True)
class Step:
    """A step of a session that began or ended, or a fault, in one sentence."""

    level: Literal["info", "warning", "error"]
    source: str
    text: str


def subscribe(listener: Listener) -> None:
    """Call ``listener`` with each published object, in the publishing thread: it must return quickly."""
    _listeners.append(listener)


def unsubscribe(listener: Listener) -> None:
    """Undo ``subscribe``."""
    _listeners.remove(listener)


def publish(item: object) -> None:
    """Call all subscribers."""
    for listener in list(_listeners):
        listener(item)
