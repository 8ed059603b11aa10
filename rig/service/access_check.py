"""Checks whether the service's user can execute a program."""

import stat
import sys
from pathlib import Path

HOMES = Path("/home"), Path("/root"), Path("/run/user")
"""Hidden from the service by systemd's ProtectHome."""


def access_problem(rig: Path) -> str | None:
    """Why the service could not run ``rig`` (it, its Python or this code is in a home directory or an inaccessible
    folder); else None.
    """
    import rig as package

    base = Path(sys.base_prefix)
    assert package.__file__ is not None
    for path in (rig, Path(sys.executable).resolve(), base, Path(package.__file__).resolve()):
        if any(path.is_relative_to(home) for home in HOMES):
            return f"{path}: the service may not see homes"
        for folder in (path, *path.parents):
            if not folder.stat().st_mode & stat.S_IXOTH and not (folder == path and path.suffix == ".py"):
                return f"{folder}: the user skyfix may not enter it"
    return None
