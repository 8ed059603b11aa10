"""Error handling of the simulator's commands."""

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

from localizer.errors import SkyfixError
from sim.errors import SimulationError

P = ParamSpec("P")
T = TypeVar("T")


def one_line_failures(function: Callable[P, T]) -> Callable[P, T]:
    """Convert the simulator's errors into those that end a command with one line and status 2."""

    @wraps(function)
    def wrapped(*args: P.args, **kwargs: P.kwargs) -> T:
        try:
            return function(*args, **kwargs)
        except SimulationError as error:
            raise SkyfixError(str(error)) from error

    return wrapped
