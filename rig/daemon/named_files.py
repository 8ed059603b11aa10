"""Checks the files and folders named in ``[run]`` when the configuration is read, before any device is used."""

import os
import stat
from pathlib import Path

from localizer.dem.names import is_gdal_name
from rig.bundle.writer import existing_part
from rig.config.run import RunSection
from rig.daemon.http.access_control import read_token
from rig.errors import ConfigError


def check_named_files(run: RunSection, config_path: Path) -> None:
    """``ConfigError`` names the configuration file, the key, the file and what to do."""
    check_dem(run, config_path)
    for key, folder in (
        ("[run.spool] dir", run.spool.dir),
        ("[run] control", (run.control or run.spool.dir).parent),
    ):
        there = existing_part(folder)
        if not there.is_dir():
            raise ConfigError(f"{config_path}: {key}: {there} is no folder; name another place")
        if not os.access(there, os.W_OK | os.X_OK):
            raise ConfigError(
                f"{config_path}: {key}: nothing can be written in {there}; give this user the right to, or name another place"
            )
    if run.http and run.http.token_file:
        try:
            read_token(run.http.token_file)
        except ConfigError as error:
            raise ConfigError(f"{config_path}: {error}") from error


def check_dem(run: RunSection, config_path: Path) -> None:
    """The same for the elevation files alone. Names inside archives or databases are left to GDAL."""
    for file in run.dem:
        if is_gdal_name(str(file)):
            continue
        try:
            found = file.stat()
            problem = None
            if not (stat.S_ISREG(found.st_mode) or stat.S_ISDIR(found.st_mode)):
                problem = "is neither a file nor a folder"  # a pipe would be waited for
            elif stat.S_ISREG(found.st_mode) and found.st_size == 0:
                problem = "is empty"
            if problem is None and not os.access(file, os.R_OK):
                problem = "may not be read by this user"
        except OSError as error:
            problem = (error.strerror or str(error)).lower()
        if problem is not None:
            raise ConfigError(
                f"{config_path}: [run] dem: {file}: {problem}; name the elevation files to search in, "
                "relative to this file (localizer dem info FILE says what one holds)"
            )
