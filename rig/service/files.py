"""The files of the service: content, destination, and comparison with the installed ones.

The first line of each file names its origin and holds the hash of the rest. It distinguishes an older version of ours,
which may be replaced or removed, from a file that was edited, which may not.
"""

import hashlib
import re
import sysconfig
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Literal

from rig.errors import RigError

FileState = Literal["absent", "installed", "another version", "changed by hand"]

SPOOL = "/var/lib/skyfix/spool"
"""A service writes below /var only."""
_HEAD = "# Put here by rig service install, which replaces it: make no changes here. sha256 of the rest: "


@dataclass(frozen=True)
class ServiceFile:
    """A file and its path below the root."""

    path: Path
    content: bytes

    def at(self, root: Path) -> Path:
        """Its path on this machine."""
        return root / self.path

    def state(self, root: Path) -> FileState:
        """State of the installed file. Raises ``OSError`` if it cannot be read."""
        try:
            found = self.at(root).read_bytes()
        except (FileNotFoundError, NotADirectoryError):
            return "absent"
        if found == self.content:
            return "installed"
        head, _, rest = found.partition(b"\n")
        return "another version" if head == _head(rest) else "changed by hand"


def service_files() -> list[ServiceFile]:
    """All files, for the installation that this program runs in."""
    units = resources.files("rig.service") / "units"
    unit = _with(
        r"ExecStart=\S+", f"ExecStart={program()}", (units / "skyfix.service").read_text(encoding="utf-8")
    )
    example = (resources.files("rig.service") / "vehicle.toml").read_text(encoding="utf-8")
    texts = {
        "etc/sysusers.d/skyfix.conf": (units / "skyfix.sysusers").read_text(encoding="utf-8"),
        "etc/tmpfiles.d/skyfix.conf": (units / "skyfix.tmpfiles").read_text(encoding="utf-8"),
        "etc/udev/rules.d/70-skyfix.rules": (units / "70-skyfix.rules").read_text(encoding="utf-8"),
        "etc/systemd/system/skyfix.service": unit,
        "etc/skyfix/vehicle.example.toml": _with(
            'dir = "spool".*', f'dir = "{SPOOL}"    # bundles and the index of their answers', example
        ),
    }
    return [ServiceFile(Path(path), _with_head(text.encode())) for path, text in texts.items()]


def program() -> Path:
    """Path of the program ``rig`` of this installation."""
    path = Path(sysconfig.get_path("scripts")) / "rig"
    if not path.is_file():
        raise RigError(f"{path}: there is no program rig in this installation; install skyfix with pip")
    if not re.fullmatch(r"[\w./+@:-]+", str(path), re.ASCII):
        raise RigError(f"{path}: a service cannot be started from a path like this; install into /opt/skyfix")
    return path


def _with(pattern: str, line: str, text: str) -> str:
    """The text with the line that matches ``pattern`` replaced."""
    changed, number = re.subn(f"(?m)^{pattern}", line, text)
    assert number == 1, pattern
    return changed


def _head(rest: bytes) -> bytes:
    return (_HEAD + hashlib.sha256(rest).hexdigest()).encode()


def _with_head(rest: bytes) -> bytes:
    return _head(rest) + b"\n" + rest
