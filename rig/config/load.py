"""Reads a configuration file and the calibrations that it names."""

import errno
import os
from collections.abc import Mapping
from pathlib import Path

from pydantic import ValidationError

from localizer.documents import DocumentError, read_toml
from localizer.os_errors import meant_instead
from rig.config.calibration_files import CALIBRATION_ORDER, read_calibration
from rig.config.model import RigConfig, with_calibrations
from rig.config.problems import joined, wrong_keys, wrong_value
from rig.errors import ConfigError

ENVIRONMENT_VARIABLE = "SKYFIX_CONFIG"
EXAMPLE = Path(__file__).parents[1] / "service" / "vehicle.toml"
"""Explains each key. In the repository a link to ``configs/vehicle.toml``, where it is edited."""


def config_path(given: Path | None, environment: Mapping[str, str] = os.environ) -> Path:
    """The file of ``--config``, else that of SKYFIX_CONFIG. ``ConfigError`` if neither is given."""
    if given is not None:
        return given
    if environment.get(ENVIRONMENT_VARIABLE):
        return Path(environment[ENVIRONMENT_VARIABLE])
    raise ConfigError(
        f"no configuration: give --config FILE or set {ENVIRONMENT_VARIABLE} (example: {EXAMPLE})"
    )


def load_config(path: Path | str) -> RigConfig:
    """Read and check a rig's configuration file, with the calibrations that it names.

    Parameters
    ----------
    path : path
        A TOML file; ``configs/vehicle.toml`` explains every key. Paths in it count from its folder.

    Returns
    -------
    RigConfig
        Its sections are attributes: ``config.pan_tilt``, ``config.inclinometer``, ``config.camera`` and so on.

    Raises
    ------
    ConfigError
        The message, one line, names the file, the section and the key, and for a misspelt key the likely one.

    Examples
    --------
    >>> import rig
    >>> config = rig.load_config(config_file)  # config_file = "vehicle.toml"
    >>> config.inclinometer.chip, config.camera.width_px
    ('adxl355', 160)
    """
    path = Path(path)
    try:
        tables = read_toml(path)
    except OSError as error:
        raise ConfigError(
            f"{path}: cannot be read: {error.strerror}; check --config or {ENVIRONMENT_VARIABLE}"
            + (meant_instead(path) if error.errno == errno.ENOENT else "")
        ) from error
    except DocumentError as error:
        raise ConfigError(f"{path}: {error}") from error
    problems = list(wrong_keys(tables, RigConfig))
    if problems:
        raise ConfigError(f"{path}: {joined(problems)}")
    try:
        config = RigConfig.model_validate(tables)
    except ValidationError as error:
        raise ConfigError(
            f"{path}: {joined([wrong_value(each, tables) for each in error.errors()])}"
        ) from error
    rig = config.rig.resolved_against(path.parent)
    run = config.run.resolved_against(path.parent) if config.run else None
    config = config.model_copy(update={"rig": rig, "run": run})
    files = [
        (kind, path.parent / file)
        for kind in CALIBRATION_ORDER
        if (file := getattr(config.calibration, kind)) is not None
    ]
    return with_calibrations(config, [read_calibration(file, kind) for kind, file in files])
