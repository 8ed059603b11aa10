"""What one device was asked and answered, and what it answers when it is asked again.

A program that is run again does not ask exactly as before: it polls more or less often, takes more or fewer samples, tries
again what failed, opens the device twice. So an answer is found by what is asked and by what the device was told to do
before, not by its place in the log: the reading after a SET pulse is one that followed a SET pulse then.
"""

from bisect import bisect_right
from collections import defaultdict, deque
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

CONTEXT = 2
"""Commands before a request that decide which of its answers fits: a pulse and the measurement after it are two."""

LAST_OF_A_STOP = 40
"""Readings at the end of a stop of the head that are said again where more are wanted: some half a second of a chip's."""

Answer = TypeVar("Answer")


@dataclass(frozen=True)
class Asked(Generic[Answer]):
    """One exchange. A command changes what the device does, a request that is none only asks.

    ``epoch`` counts the goals that the head had been given: what was read at one of its stops has the same.
    """

    request: Hashable
    answer: Answer
    is_command: bool
    epoch: int = 0


class Recorded(Generic[Answer]):
    """The exchanges with one device, in order. ``epoch`` tells at which stop of the head the program is now.

    The same request several times in a row is a poll: it gets the answers of then in their order, and the last one for as
    long as it goes on. Any other request gets the answer that came after the same commands; of several such one of this stop of
    the head, and of these the next in the log, which begins anew where it ends.
    """

    def __init__(
        self,
        exchanges: Sequence[Asked[Answer]],
        epoch: Callable[[], int] = lambda: 0,
        *,
        cut_polls_go_on: bool = False,
    ) -> None:
        """``cut_polls_go_on``: a poll that the end of the log cuts off is answered from another place, where it ends."""
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
        """Everything that was ever asked."""
        return self._starts.keys()

    @property
    def at(self) -> Asked[Answer] | None:
        """The exchange that was repeated last."""
        return None if self._at is None else self._exchanges[self._at]

    @property
    def ran_out(self) -> bool:
        """Whether more was asked than then, so that the log had to begin anew."""
        return self._ran_out

    def answer(self, request: Hashable) -> Answer | None:
        """What was answered to ``request``; None where it was never made."""
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
        """Of the places where a request was made, the one after the same commands, at this stop, next in the log."""
        after = -1 if self._at is None else self._at
        following = starts[bisect_right(starts, after) % len(starts)]
        now = self._epoch()
        if self._alike(following) == len(self._before) and self._exchanges[following].epoch == now:
            return following  # as a rule; to look at all takes long in a log of hours
        most = max(self._alike(number) for number in starts)
        alike = [number for number in starts if self._alike(number) == most]
        heard = epoch_heard(sorted({self._exchanges[number].epoch for number in alike}), now)
        here = [number for number in alike if self._exchanges[number].epoch == heard]
        next_here = bisect_right(here, after)
        if len(here) < len(alike) and (heard != now or next_here == len(here)):
            here = here[-LAST_OF_A_STOP:]  # before these the head may have been under way, or swinging
            next_here = bisect_right(here, after)
        return here[next_here % len(here)]

    def _alike(self, number: int) -> int:
        """How many commands before this place of the log are those of now, counted back."""
        count = 0
        for now, then in zip(reversed(self._before), reversed(self._contexts[number]), strict=False):
            if now != then:
                break
            count += 1
        return count


def epoch_heard(epochs: Sequence[int], now: int) -> int:
    """Of the epochs at which a device was asked (ascending), the one that stands for ``now``: the last before, or the first."""
    return epochs[max(0, bisect_right(epochs, now) - 1)]
