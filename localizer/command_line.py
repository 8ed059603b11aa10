"""What commands share: how they end (one clear line for an expected failure, the contract's exit status), common options."""

import sys
from pathlib import Path
from typing import NoReturn

import click

from localizer.errors import SkyfixError

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
    sys.exit(status if isinstance(status, int) else 0)


def check_picture_path(option: str, path: Path) -> None:
    """Before the work rather than after it. Raises ``SkyfixError``."""
    if path.suffix.lower() not in PICTURE_SUFFIXES:
        raise SkyfixError(f"{option}: {path}: no picture format; name it {', '.join(PICTURE_SUFFIXES)}")
    if not path.parent.is_dir():
        raise SkyfixError(f"{option}: {path}: no such folder: {path.parent}")


def _fail(program: str, message: str, status: int) -> NoReturn:
    print(f"{program}: {' '.join(message.split())}", file=sys.stderr)
    sys.exit(status)
