"""How every command of skyfix ends: one clear line for an expected failure, and the exit status of the contract."""

import sys
from typing import NoReturn

import click

from localizer.errors import SkyfixError

INTERRUPTED = 130  # 128 + SIGINT, as shells have it


def run(command: click.Command, program: str) -> NoReturn:
    """Run ``command`` with the process's arguments and exit.

    Bad usage and every ``SkyfixError`` become one line on standard error, ``program: message``; the exit status is the
    error's own (2 for bad input). Any other exception is a defect of the program and shows its traceback.
    """
    try:
        status = command.main(prog_name=program, standalone_mode=False)
    except click.UsageError as error:
        where = error.ctx.command_path if error.ctx else program
        _fail(where, f"{error.format_message()} See {where} --help.", 2)
    except click.ClickException as error:
        _fail(program, error.format_message(), 2)
    except SkyfixError as error:
        _fail(program, str(error), error.exit_status)
    except (click.Abort, KeyboardInterrupt):
        _fail(program, "interrupted", INTERRUPTED)
    sys.exit(status if isinstance(status, int) else 0)


def _fail(program: str, message: str, status: int) -> NoReturn:
    print(f"{program}: {' '.join(message.split())}", file=sys.stderr)
    sys.exit(status)
