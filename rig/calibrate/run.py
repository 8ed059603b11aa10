"""Common part of all calibrations: configuration, output file, plot, and entry in the configuration."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

from localizer.os_errors import why_not_written
from rig import clock
from rig.calibrate.config_edit import name_in_config
from rig.calibrate.guide import Guide, TerminalGuide
from rig.config.calibration_files import (
    Calibration,
    CalibrationError,
    CalibrationKind,
    new_id,
    write_calibration,
)
from rig.config.load import config_path, load_config
from rig.config.model import RigConfig

FOLDER = "calibration"
PLAIN_WIDTH = 100


@dataclass(frozen=True)
class CalibrationRun:
    """A calibration in progress: configuration in force, its file, output folder, and the operator's guide."""

    config: RigConfig
    config_path: Path
    folder: Path
    guide: Guide
    as_json: bool = False

    @classmethod
    def open(
        cls, config_file: Path | None, out: Path | None, yes: bool, as_json: bool = False
    ) -> "CalibrationRun":
        """From a command's options. ``ConfigError`` for an invalid configuration."""
        path = config_path(config_file)
        return cls(load_config(path), path, out or path.parent / FOLDER, TerminalGuide(yes), as_json)

    def header(self, kind: CalibrationKind, device: str) -> dict[str, Any]:
        """The fields that all calibrations have."""
        created = clock.utc_now().replace(microsecond=0)
        return {
            "id": new_id(kind, created),
            "created": created,
            "rig": self.config.rig.name,
            "device": device,
            "based_on": {
                each.document.kind: each.document.id
                for each in self.config.calibrations
                if each.document.kind != kind
            },
        }

    def finish(self, document: Calibration, rows: Sequence[tuple[str, str, str]], figure: Figure) -> None:
        """Show the result, write file and plot, and enter the file in the configuration if the operator agrees.

        ``rows`` are name, value and sigma or remark. Prints the result and the file on standard output.
        """
        if not self.as_json:
            table = Table("", "value", "sigma")
            for row in rows:
                table.add_row(*row)
            console = Console()
            (console if console.is_terminal else Console(width=PLAIN_WIDTH)).print(table)
        path = write_calibration(document, self.folder)
        picture = path.with_suffix(".png")
        try:
            figure.savefig(picture)
        except OSError as error:
            raise CalibrationError(f"{picture}: {why_not_written(error)}") from error
        if self.as_json:
            found = {"file": str(path), "picture": str(picture), **document.model_dump(mode="json")}
            click.echo(json.dumps(found))
        else:
            click.echo(path)
        self.guide.say(f"picture: {picture}")
        question = f"Use it from now on, by naming it in {self.config_path}?"
        if self.guide.confirm(question):
            name_in_config(self.config_path, document.kind, path)
