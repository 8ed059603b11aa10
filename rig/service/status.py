"""Status of the service: its files, systemd's state, and its own status line."""

import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

from rig.errors import RigError
from rig.service.files import service_files

PROPERTIES = "LoadState", "UnitFileState", "ActiveState", "SubState", "StatusText", "NRestarts"
COMMAND_TIMEOUT_S = 30.0


@dataclass(frozen=True)
class ServiceStatus:
    """States of the files by path, and systemd's properties of the service; None if systemd was not asked."""

    files: dict[str, str]
    properties: dict[str, str] | None
    good: bool


def service_status(root: Path) -> ServiceStatus:
    """The status of the service. Raises ``RigError`` if it cannot be determined."""
    files: dict[str, str] = {}
    for file in service_files():
        try:
            state = file.state(root)
        except OSError as error:
            raise RigError(
                f"{file.at(root)}: cannot be read: {error.strerror}; run this as root (sudo)"
            ) from error
        files[str(file.at(root))] = state
    good = all(state == "installed" for state in files.values())
    if root != Path("/"):
        return ServiceStatus(files, None, good)
    if shutil.which("systemctl") is None:
        return ServiceStatus(files, None, good=False)
    found = _properties()
    return ServiceStatus(files, found, good and found["ActiveState"] == "active")


def status_text(root: Path, status: ServiceStatus) -> str:
    """The status as text."""
    lines = [f"{place}: {state}" for place, state in status.files.items()]
    found = status.properties
    if found is not None:
        lines.append(
            f"service: {found['UnitFileState'] or found['LoadState']}, {found['ActiveState']} ({found['SubState']}), "
            f"{found['NRestarts']} restarts"
        )
        lines.append(f"says: {found['StatusText'] or 'nothing'}")
    elif root == Path("/"):
        lines.append("service: there is no systemctl here")
    return "\n".join(lines)


def _properties() -> dict[str, str]:
    command = ["systemctl", "show", "skyfix.service", "--property", ",".join(PROPERTIES)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=COMMAND_TIMEOUT_S, check=False)
    if done.returncode:
        raise RigError(f"systemctl show: {' '.join(done.stderr.split())}; is this machine run by systemd?")
    return dict(line.partition("=")[::2] for line in done.stdout.splitlines())
