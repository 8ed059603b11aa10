"""Shared by all commands: error lines, exit statuses of the contract, and common options."""

import errno
import math
import os
import re
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, NoReturn, TypeVar

import click

from localizer.commands.streams import discard_output, is_closed_pipe, replace_unencodable_characters
from localizer.errors import SkyfixError
from localizer.os_errors import why_not_written

F = TypeVar("F", bound=Callable[..., object])

INTERRUPTED = 130  # 128 + SIGINT, as shells have it
PIPE_CLOSED = 141  # 128 + SIGPIPE


def run(command: click.Command, program: str) -> NoReturn:
    """Run ``command`` with the process's arguments and exit.

    Bad usage and every ``SkyfixError`` become one line on standard error, ``program: message``; the exit status is the
    error's own (2 for bad input). If the reader of a pipe closes it (``| head``), the program ends silently. Any other
    exception is a defect of the program and shows its traceback.
    """
    replace_unencodable_characters()
    take_negative_numbers(command)
    output = sys.stdout
    try:
        status = command.main(prog_name=program, standalone_mode=False)
    except click.exceptions.NoArgsIsHelpError as error:  # its message is the whole help
        where, group = error.ctx.command_path, error.ctx.command
        names = group.list_commands(error.ctx) if isinstance(group, click.Group) else []
        _fail(where, f"Name a command: {', '.join(names)}. See {where} --help.", 2)
    except click.UsageError as error:
        where = error.ctx.command_path if error.ctx else program
        _fail(where, f"{_usage(error)} See {where} --help.", 2)
    except click.ClickException as error:
        _fail(program, error.format_message(), 2)
    except SkyfixError as error:
        _fail(program, str(error), error.exit_status)
    except (click.Abort, KeyboardInterrupt) as error:
        if isinstance(error.__context__, EOFError) or isinstance(error.__cause__, EOFError):
            _fail(
                program,
                "a question was not answered: standard input has ended; answer it, or see --help for options",
                2,
            )
        _fail(program, "interrupted", INTERRUPTED)
    except SystemError as error:
        if not isinstance(
            error.__cause__ or error.__context__, KeyboardInterrupt
        ):  # as compiled code passes it on
            raise
        _fail(program, "interrupted", INTERRUPTED)
    except BrokenPipeError:
        _end(PIPE_CLOSED)
    except SystemExit as ended:
        # click ends with status 1 after any broken pipe, rich after one of standard output
        if isinstance(ended.__context__, BrokenPipeError) or is_closed_pipe(output):
            _end(PIPE_CLOSED)
        if sys.stdout is not output:
            sys.stdout = output
            _fail(program, "a connection was closed by the other side; try again", 1)
        _end(ended.code if isinstance(ended.code, int) else 1)
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        if error.errno in _OF_THE_DISK:
            discard_output()
            _fail(program, f"{where}{_why(error)}", 2)
        if isinstance(error, PermissionError) and where:  # even to ask whether a path exists may be forbidden
            _fail(program, f"{where}permission denied; check who may read and write there", 2)
        raise
    _end(status if isinstance(status, int) else 0, program)


_OF_THE_DISK = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS)


def _end(status: int, program: str = "") -> NoReturn:
    """Flush and exit: a failing flush at Python's own exit would print a traceback."""
    try:
        if sys.stdout is not None:
            sys.stdout.flush()
    except BrokenPipeError:
        discard_output()
    except OSError as error:
        discard_output()
        _fail(program, _why(error), 2)
    sys.exit(status)


def _why(error: OSError) -> str:
    if error.errno == errno.ENOSPC:
        return "the disk is full; make room, or write elsewhere"
    return why_not_written(error).removeprefix("cannot be written: ")


class NumbersCommand(click.Command):
    """A command that parses ``-12.5`` as a number, not as options."""

    def make_parser(self, ctx: click.Context) -> Any:
        parser = super().make_parser(ctx)
        of_an_option = parser._process_opts

        def process(arg: str, state: Any) -> None:
            if _NEGATIVE.fullmatch(arg):
                state.largs.append(arg)
            else:
                of_an_option(arg, state)

        parser._process_opts = process  # type: ignore[method-assign]
        return parser


_NEGATIVE = re.compile(r"-(\d|\.\d|inf|nan)[\w.,+-]*", re.IGNORECASE)


def take_negative_numbers(command: click.Command) -> None:
    """Make a command and its subcommands parse negative numbers as numbers, as ``NumbersCommand`` does."""
    if isinstance(command, click.Group):
        for each in command.commands.values():
            take_negative_numbers(each)
    elif type(command) is click.Command and not command.context_settings.get("ignore_unknown_options"):
        command.__class__ = NumbersCommand


def _usage(error: click.UsageError) -> str:
    """The message for a usage error."""
    message = error.format_message().rstrip(".")
    extra = re.fullmatch(r"Got unexpected extra arguments? \((-?[\d.]+)[^)]*\)", message)
    takes_a_place = error.ctx is not None and any(
        parameter.metavar == "LAT,LON" for parameter in error.ctx.command.params
    )
    if extra and takes_a_place:
        message += "; a place is one word with a comma and no blank: LAT,LON"
    return message if message.endswith("?") else f"{message}."


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


def version_option(program: str) -> Callable[[F], F]:
    """``--version``: one line, the program's name and the version of skyfix that is installed."""

    def show(context: click.Context, _parameter: click.Parameter, asked: bool) -> None:
        if asked and not context.resilient_parsing:
            from localizer.version import __version__  # slow to import, and seldom asked for

            click.echo(f"{program} {__version__}")
            context.exit()

    return click.option(
        "--version",
        is_flag=True,
        is_eager=True,
        expose_value=False,
        callback=show,
        help="Say which version this is, and end.",
    )


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


def _fail(program: str, message: str, status: int) -> NoReturn:
    with suppress(OSError):  # there may be nobody left who reads it
        print(f"{program}: {' '.join(message.split())}", file=sys.stderr)
    with suppress(OSError):
        if sys.stdout is not None:
            sys.stdout.flush()
    sys.exit(status)
