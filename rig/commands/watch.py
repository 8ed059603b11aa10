"""The command ``rig watch``."""

import json
import math
import sys
from collections.abc import Callable
from pathlib import Path

import click

from localizer.commands.command_line import FiniteRange
from rig import timebase
from rig.commands.options import config_option
from rig.commands.signals import stopping_cleanly
from rig.config.load import config_path, load_config

DEVICES = ("head", "inclinometer", "compass", "altimeter", "camera")
FIRST_READINGS_S = 15.0
"""An absent camera or port has failed by then."""


@click.command()
@config_option
@click.option(
    "--once", is_flag=True, help="Print once, as soon as every device has been heard or has failed."
)
@click.option(
    "--for", "for_s", metavar="SECONDS", type=FiniteRange(0.0, min_open=True), help="End by itself."
)
@click.option(
    "--every",
    "every_s",
    metavar="SECONDS",
    type=FiniteRange(0.1),
    default=1.0,
    show_default=True,
    help="Between two lines, where standard output is no terminal.",
)
@click.option(
    "--device",
    "names",
    type=click.Choice(DEVICES),
    multiple=True,
    help="Watch only this one; repeat it for several.",
)
@click.option("--json", "as_json", is_flag=True, help="Print a JSON object a line.")
def watch(
    config_file: Path | None,
    once: bool,
    for_s: float | None,
    every_s: float,
    names: tuple[str, ...],
    as_json: bool,
) -> int:
    """Show live readings of all devices with their ages, the vehicle's attitude, and faults.

    Nothing moves, and the torque stays as it is. A failed device is retried until it returns. On a terminal a live
    table, else one line a second. Ends with Ctrl-C, with status 1 if a device has a fault then. No other command may
    use the rig meanwhile.

    \b
    Examples:
      rig watch --config vehicle.toml
      rig watch --once --json
      rig watch --json --for 3600 --every 10 > health.jsonl
    """
    config = load_config(config_path(config_file))

    from rich.console import Console, RenderableType
    from rich.live import Live

    from rig.fault_notes import collecting
    from rig.watch import text
    from rig.watch.attitudes import attitudes
    from rig.watch.sources import sources_of
    from rig.watch.watcher import Watcher

    openers = {name: opener for name, opener in sources_of(config).items() if not names or name in names}
    if not openers:
        raise click.UsageError(f"--device: the configuration has no {' and no '.join(names)}.")
    console = Console()
    table = console.is_terminal and not as_json
    say = console.print if table else click.echo
    end_s = math.inf if for_s is None else timebase.monotonic_s() + for_s
    with stopping_cleanly(), collecting() as faults, Watcher(openers) as watcher:

        def show() -> RenderableType:
            statuses = watcher.statuses()
            found = attitudes(config, statuses)
            if as_json:
                return json.dumps(text.as_json(config.rig.name, statuses, found, faults.all()))
            if table:
                return text.table(config.rig.name, statuses, found, faults.all())
            return text.line(statuses, found)

        try:
            if once or not table:
                watcher.wait_first_readings(min(FIRST_READINGS_S, end_s - timebase.monotonic_s()))
            if once:
                say(show())
            elif table:
                with Live(console=console, refresh_per_second=4, get_renderable=show):
                    _repeat(lambda: None, every_s, end_s)
            else:
                _repeat(lambda: say(show()), every_s, end_s)
        except KeyboardInterrupt:  # the ordinary end of a watch
            pass
        return 0 if all(status.state == "ok" for status in watcher.statuses()) else 1


def _repeat(act: Callable[[], None], every_s: float, end_s: float) -> None:
    due_s = timebase.monotonic_s()
    while due_s < end_s:
        act()
        sys.stdout.flush()
        due_s += every_s
        timebase.sleep(max(0.0, min(due_s, end_s) - timebase.monotonic_s()))
