"""What happens in a session, for whoever records it: readings, states, frames and steps, as the objects that they are.

Whoever has one calls ``publish``; it costs next to nothing where nobody listens.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

Listener = Callable[[object], None]

_listeners: list[Listener] = []


@dataclass(frozen=True)
class Step:
    """A step of a session that has begun or is done, or a fault, in a sentence."""

    level: Literal["info", "warning", "error"]
    source: str
    text: str


def subscribe(listener: Listener) -> None:
    """Have ``listener`` called with each object, in the thread that publishes it: it must be quick."""
    _listeners.append(listener)


def unsubscribe(listener: Listener) -> None:
    """End that."""
    _listeners.remove(listener)


def publish(item: object) -> None:
    """Tell the listeners."""
    for listener in list(_listeners):
        listener(item)
