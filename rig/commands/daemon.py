"""The commands ``rig run``, ``rig trigger`` and ``rig status``."""

import json
from pathlib import Path
from typing import Any

import click

from rig.commands.options import config_option
from rig.config.calibration_files import CalibrationError
from rig.config.load import config_path, load_config
from rig.config.run import control_socket_of_invalid_config
from rig.errors import ConfigError

EXIT_STATUS = {"started": 0, "busy": 3, "not ready": 4, "stopping": 5}
"""Exit statuses of ``rig trigger``, by the daemon's answer."""


@click.command()
@config_option
def run(config_file: Path | None) -> None:
    """Capture, locate and publish as the vehicle's service, until stopped.

    [run] of the configuration sets the triggers and publishers. SIGTERM or Ctrl-C stops it with the torque off, SIGHUP
    reloads the configuration (an invalid one is refused as a whole), SIGUSR1 takes a capture.

    \b
    Examples:
      rig run --config vehicle.toml
      sim run --seed 3 -- rig run
    """
    from rig.daemon.service import serve  # slow to import

    serve(config_path(config_file))


@click.command()
@config_option
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def trigger(config_file: Path | None, as_json: bool) -> int:
    """Request a capture from the running daemon, and print its answer; the capture itself takes longer.

    Ends with status 0 if it was started, 3 busy, 4 not ready (with the reason), 5 stopping; 2 if no rig run of this
    configuration is running.

    Example: rig trigger --config vehicle.toml
    """
    answer = _answer(config_file, "trigger")
    said = f"{answer['answer']}: {answer['why']}" if "why" in answer else answer["answer"]
    click.echo(json.dumps(answer) if as_json else said)
    return EXIT_STATUS[answer["answer"]]


@click.command()
@config_option
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def status(config_file: Path | None, as_json: bool) -> None:
    """Show the status of the running daemon: devices, last answer, event counts.

    Example: rig status --config vehicle.toml
    """
    from rig.daemon.status import status_text

    answer = _answer(config_file, "status")
    click.echo(json.dumps(answer) if as_json else status_text(answer))


def _answer(config_file: Path | None, request: str) -> dict[str, Any]:
    """The daemon's answer. A daemon that still runs with an earlier version of a now invalid configuration is found
    too.
    """
    from rig.daemon.control import ControlError, send_request
    from rig.daemon.main_loop import run_of

    path = config_path(config_file)
    try:
        run = run_of(load_config(path), path)
    except (ConfigError, CalibrationError) as error:
        control = control_socket_of_invalid_config(path)
        try:
            answer = send_request(control, request) if control else None
        except ControlError:
            answer = None
        if answer is None:
            raise
        click.echo(f"rig: {error}; the daemon goes on with what it has read before, and answers", err=True)
        return answer
    assert run.control  # filled in when the file was read
    return send_request(run.control, request)
