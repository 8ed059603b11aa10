"""How the service is: its files, what systemd says of it, and what it says itself."""

import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

from rig.errors import RigError
from rig.service.files import service_files

PROPERTIES = "LoadState", "UnitFileState", "ActiveState", "SubState", "StatusText", "NRestarts"
COMMAND_TIMEOUT_S = 30.0


def status(root: Path, say: Callable[[str], None]) -> bool:
    """Say it; whether all is as it should be. Raises ``RigError`` where it cannot be found out."""
    good = True
    for file in service_files():
        try:
            state = file.state(root)
        except OSError as error:
            raise RigError(
                f"{file.at(root)}: cannot be read: {error.strerror}; run this as root (sudo)"
            ) from error
        say(f"{file.at(root)}: {state}")
        good = good and state == "installed"
    if root != Path("/"):
        return good
    if shutil.which("systemctl") is None:
        say("service: there is no systemctl here")
        return False
    found = _properties()
    say(
        f"service: {found['UnitFileState'] or found['LoadState']}, {found['ActiveState']} ({found['SubState']}), "
        f"{found['NRestarts']} restarts"
    )
    say(f"says: {found['StatusText'] or 'nothing'}")
    return good and found["ActiveState"] == "active"


def _properties() -> dict[str, str]:
    command = ["systemctl", "show", "skyfix.service", "--property", ",".join(PROPERTIES)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=COMMAND_TIMEOUT_S, check=False)
    if done.returncode:
        raise RigError(f"systemctl show: {' '.join(done.stderr.split())}; is this machine run by systemd?")
    return dict(line.partition("=")[::2] for line in done.stdout.splitlines())
