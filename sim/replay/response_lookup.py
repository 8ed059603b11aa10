"""Finds the recorded answer to a request of a repeated program run.

A repeated run does not send exactly the same requests: polls, samples, retries and openings differ. So an answer is
found by the request and the preceding commands, not by its position in the log: the reading after a SET pulse is one
that followed a SET pulse.
"""

from bisect import bisect_right
from collections import defaultdict, deque
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

CONTEXT = 2
"""Number of preceding commands that select the answer: a pulse and the measurement after it are two."""

LAST_OF_A_STOP = 40
"""Readings at the end of a head stop that are repeated if more are needed: about half a second of a chip's."""

Answer = TypeVar("Answer")


@dataclass(frozen=True)
class RecordedExchange(Generic[Answer]):
    """One exchange. A command changes the device's state, other requests do not.

    ``epoch`` is the number of goals given to the head before: constant during one stop.
    """

    request: Hashable
    answer: Answer
    is_command: bool
    epoch: int = 0


class ResponseLookup(Generic[Answer]):
    """The exchanges with one device, in order. ``epoch`` returns the program's present stop of the head.

    A repeated request is a poll: it gets the recorded answers in order, then the last one. Other requests get the
    answer after the same commands; of several one of the same stop, and of these the next in the log, which wraps
    around.
    """

    def __init__(
        self,
        exchanges: Sequence[RecordedExchange[Answer]],
        epoch: Callable[[], int] = lambda: 0,
        *,
        cut_polls_go_on: bool = False,
    ) -> None:
        """``cut_polls_go_on``: a poll cut off by the end of the log continues with a complete one elsewhere."""
        self._exchanges = exchanges
        self._cut_polls_go_on = cut_polls_go_on
        self._epoch = epoch
        self._at: int | None = None
        self._before: deque[Hashable] = deque(maxlen=CONTEXT)
        self._ran_out = False
        self._starts: dict[Hashable, list[int]] = defaultdict(list)
        self._contexts: dict[int, tuple[Hashable, ...]] = {}
        recent: deque[Hashable] = deque(maxlen=CONTEXT)
        for number, exchange in enumerate(exchanges):
            if number and exchanges[number - 1].request == exchange.request:
                continue
            self._starts[exchange.request].append(number)
            self._contexts[number] = tuple(recent)
            if exchange.is_command:
                recent.append(exchange.request)

    @property
    def requests(self) -> Iterable[Hashable]:
        """All recorded requests."""
        return self._starts.keys()

    @property
    def at(self) -> RecordedExchange[Answer] | None:
        """The exchange repeated last."""
        return None if self._at is None else self._exchanges[self._at]

    @property
    def ran_out(self) -> bool:
        """Whether more was requested than recorded, so that the log wrapped around."""
        return self._ran_out

    def answer(self, request: Hashable) -> Answer | None:
        """The recorded answer to ``request``; None if it was never made."""
        if self._at is not None and self._exchanges[self._at].request == request:
            after = self._at + 1
            if after < len(self._exchanges) and self._exchanges[after].request == request:
                self._at = after
            self._ran_out |= after == len(self._exchanges)
            others = self._starts[request][:-1]
            if after < len(self._exchanges) or not self._cut_polls_go_on or not others:
                return self._exchanges[self._at].answer
            self._at = self._best(others)
            return self._exchanges[self._at].answer
        starts = self._starts.get(request)
        if not starts:
            return None
        best = self._best(starts)
        self._ran_out |= self._at is not None and best < self._at
        self._at = best
        if self._exchanges[best].is_command:
            self._before.append(request)
        return self._exchanges[best].answer

    def _best(self, starts: Sequence[int]) -> int:
        """The best position for a request: after the same commands, at this stop, next in the log."""
        after = -1 if self._at is None else self._at
        following = starts[bisect_right(starts, after) % len(starts)]
        now = self._epoch()
        if (
            self._matching_commands(following) == len(self._before)
            and self._exchanges[following].epoch == now
        ):
            return following  # the usual case; checking all positions is slow for long logs
        most = max(self._matching_commands(number) for number in starts)
        alike = [number for number in starts if self._matching_commands(number) == most]
        heard = recorded_epoch(sorted({self._exchanges[number].epoch for number in alike}), now)
        here = [number for number in alike if self._exchanges[number].epoch == heard]
        next_here = bisect_right(here, after)
        if len(here) < len(alike) and (heard != now or next_here == len(here)):
            here = here[-LAST_OF_A_STOP:]  # earlier the head may have been moving or swinging
            next_here = bisect_right(here, after)
        return here[next_here % len(here)]

    def _matching_commands(self, number: int) -> int:
        """Number of commands before this position that match the present ones, counted backwards."""
        count = 0
        for now, then in zip(reversed(self._before), reversed(self._contexts[number]), strict=False):
            if now != then:
                break
            count += 1
        return count


def recorded_epoch(epochs: Sequence[int], now: int) -> int:
    """The recorded epoch (of the ascending ones) that stands for ``now``: the last before it, or the first."""
    return epochs[max(0, bisect_right(epochs, now) - 1)]
