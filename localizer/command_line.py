"""What commands share: how they end (one clear line for an expected failure, the contract's exit status), common options."""

import errno
import math
import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NoReturn, TypeVar

import click

from localizer.errors import SkyfixError

F = TypeVar("F", bound=Callable[..., object])

INTERRUPTED = 130  # 128 + SIGINT, as shells have it
PICTURE_SUFFIXES = (".png", ".jpg", ".svg", ".pdf")


def run(command: click.Command, program: str) -> NoReturn:
    """Run ``command`` with the process's arguments and exit.

    Bad usage and every ``SkyfixError`` become one line on standard error, ``program: message``; the exit status is the
    error's own (2 for bad input). Any other exception is a defect of the program and shows its traceback.
    """
    try:
        status = command.main(prog_name=program, standalone_mode=False)
    except click.exceptions.NoArgsIsHelpError as error:  # its message is the whole help
        where, group = error.ctx.command_path, error.ctx.command
        names = group.list_commands(error.ctx) if isinstance(group, click.Group) else []
        _fail(where, f"Name a command: {', '.join(names)}. See {where} --help.", 2)
    except click.UsageError as error:
        where = error.ctx.command_path if error.ctx else program
        _fail(where, f"{error.format_message().rstrip('.')}. See {where} --help.", 2)
    except click.ClickException as error:
        _fail(program, error.format_message(), 2)
    except SkyfixError as error:
        _fail(program, str(error), error.exit_status)
    except (click.Abort, KeyboardInterrupt):
        _fail(program, "interrupted", INTERRUPTED)
    except SystemError as error:
        if not isinstance(
            error.__cause__ or error.__context__, KeyboardInterrupt
        ):  # as compiled code passes it on
            raise
        _fail(program, "interrupted", INTERRUPTED)
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        if error.errno == errno.ENOSPC:
            _fail(program, f"{where}the disk is full; make room, or write elsewhere", 2)
        if isinstance(error, PermissionError) and where:  # even to ask whether a path exists may be forbidden
            _fail(program, f"{where}permission denied; check who may read and write there", 2)
        raise
    sys.exit(status if isinstance(status, int) else 0)


class FiniteRange(click.FloatRange):
    """A number within limits. Without this NaN lies within all of them, and infinity within half of them."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        number: float = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value!r} is not a finite number.", param, ctx)
        return number


class OutputFolder(click.Path):
    """Where files are put. An empty name, as an unset variable of a script leaves it, would be the current folder."""

    def __init__(self) -> None:
        super().__init__(path_type=Path)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if value == "":
            self.fail("the name of the folder is empty; for the current one say a dot.", param, ctx)
        folder = Path(os.fsdecode(super().convert(value, param, ctx)))
        with suppress(OSError):  # a name that cannot even be looked at is told by whoever writes there
            if folder.is_file():
                self.fail(f"{folder}: is a file; name a folder", param, ctx)
        return folder


def dem_files_option(meaning: str, *, required: bool = False) -> Callable[[F], F]:
    """``--dem FILE``, as often as wanted; ``meaning`` is its help."""
    return click.option(
        "--dem",
        "dem_paths",
        metavar="FILE",
        type=click.Path(path_type=Path),
        required=required,
        multiple=True,
        help=meaning,
    )


def prepare_folder(option: str, folder: Path) -> None:
    """Create the folder unless it is there, and make sure that files can be written: before the work, not after it.

    Raises ``SkyfixError``.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except FileExistsError:
        raise SkyfixError(f"{option}: {folder}: is a file; name a folder") from None
    except OSError as error:
        raise SkyfixError(
            f"{option}: {folder}: cannot be written: {error.strerror}; name another folder"
        ) from None


def check_picture_path(option: str, path: Path) -> None:
    """Before the work rather than after it. Raises ``SkyfixError``."""
    if path.suffix.lower() not in PICTURE_SUFFIXES:
        raise SkyfixError(f"{option}: {path}: no picture format; name it {', '.join(PICTURE_SUFFIXES)}")
    if not path.parent.is_dir():
        raise SkyfixError(f"{option}: {path}: no such folder: {path.parent}")
    if path.is_dir():
        raise SkyfixError(f"{option}: {path}: is a folder; name a file")
    prepare_folder(option, path.parent)


@contextmanager
def writing(option: str, path: Path) -> Iterator[None]:
    """While a file is written. Raises ``SkyfixError`` where the operating system refuses, say on a full disk."""
    try:
        yield
    except OSError as error:
        raise SkyfixError(f"{option}: {path}: cannot be written: {error.strerror}") from None


def _fail(program: str, message: str, status: int) -> NoReturn:
    print(f"{program}: {' '.join(message.split())}", file=sys.stderr)
    sys.exit(status)
