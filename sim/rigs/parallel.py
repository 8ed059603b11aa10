"""Runs work in several processes, none of which outlives the caller."""

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
"""Time for the clean-up of a terminated process before it is killed."""

_PROCESSES = multiprocessing.get_context("fork")
"""Python 3.14 no longer forks unless it is told to; what else there is hands ``one`` over by its name only."""

Item = TypeVar("Item")
Result = TypeVar("Result")


def run_in_parallel(one: Callable[[Item], Result], items: Sequence[Item], jobs: int) -> Generator[Result]:
    """Results of ``one`` for each item, each in its own process, ``jobs`` at a time, in order of completion.

    A ``SkyfixError`` there is raised here. If the iteration ends early (close it), running processes get SIGTERM, which
    raises ``SystemExit`` in ``one``, and are waited for.
    """
    waiting = list(reversed(items))
    running: dict[Connection, BaseProcess] = {}
    try:
        while waiting or running:
            while waiting and len(running) < jobs:
                heard, result_pipe = multiprocessing.Pipe(duplex=False)
                process = _PROCESSES.Process(
                    target=_work, args=(one, waiting.pop(), result_pipe), daemon=True
                )
                process.start()
                running[heard] = process
                result_pipe.close()
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
    """The result of ``_work``, or its error."""
    with result:
        try:
            return result.recv()
        except EOFError:
            process.join()
            raise RuntimeError(f"a process ended with status {process.exitcode} and no result") from None


def _work(one: Callable[[Item], Result], item: Item, result_pipe: Connection) -> None:
    # Ctrl-C reaches the whole process group: the parent decides.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _end)
    try:
        result_pipe.send((one(item), None))
    except SkyfixError as error:
        result_pipe.send((None, error))


def _end(number: int, frame: FrameType | None) -> None:
    """Only once: a second signal must not interrupt the clean-up."""
    signal.signal(number, signal.SIG_IGN)
    sys.exit(128 + number)
