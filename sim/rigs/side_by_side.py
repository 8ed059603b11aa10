"""Work for several processes, none of which outlives whoever started it."""

import multiprocessing
import signal
import sys
from collections.abc import Callable, Generator, Sequence
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from types import FrameType
from typing import Any, TypeVar

from localizer.errors import SkyfixError

ENDS_WITHIN_S = 30.0
"""A process that is told to end cleans up; one that takes longer is killed."""

_PROCESSES = multiprocessing.get_context("fork")
"""Python 3.14 no longer forks unless it is told to; what else there is hands ``one`` over by its name only."""

Item = TypeVar("Item")
Result = TypeVar("Result")


def side_by_side(one: Callable[[Item], Result], items: Sequence[Item], jobs: int) -> Generator[Result]:
    """What ``one`` makes of each item in a process of its own, ``jobs`` at a time, as they are done.

    A ``SkyfixError`` there is raised here. Where the iteration ends early (close it), whatever ends it, the processes that
    run are told to by SIGTERM, on which ``one`` is left by ``SystemExit``, and waited for.
    """
    waiting = list(reversed(items))
    running: dict[Connection, BaseProcess] = {}
    try:
        while waiting or running:
            while waiting and len(running) < jobs:
                heard, told = multiprocessing.Pipe(duplex=False)
                process = _PROCESSES.Process(target=_work, args=(one, waiting.pop(), told), daemon=True)
                process.start()
                running[heard] = process
                told.close()
            for result in wait(list(running)):
                assert isinstance(result, Connection)
                done, error = _received(result, running[result])
                running.pop(result).join()
                if error is not None:
                    raise error
                yield done
    finally:
        for each in running.values():
            each.terminate()
        for each in running.values():
            each.join(ENDS_WITHIN_S)
            if each.exitcode is None:
                each.kill()
                each.join()


def _received(result: Connection, process: BaseProcess) -> Any:
    """What ``_work`` tells: the result, or the error."""
    with result:
        try:
            return result.recv()
        except EOFError:
            process.join()
            raise RuntimeError(f"a process ended with status {process.exitcode} and no result") from None


def _work(one: Callable[[Item], Result], item: Item, told: Connection) -> None:
    # Ctrl-C reaches the whole process group: the parent decides.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _end)
    try:
        told.send((one(item), None))
    except SkyfixError as error:
        told.send((None, error))


def _end(number: int, frame: FrameType | None) -> None:
    """Once: a second signal must not disturb the cleaning up."""
    signal.signal(number, signal.SIG_IGN)
    sys.exit(128 + number)
