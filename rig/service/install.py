"""Installs and removes the service's files."""

import os
import shutil
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path

from rig.atomic import write_atomically
from rig.errors import RigError
from rig.service.access_check import access_problem
from rig.service.files import FileState, ServiceFile, program, service_files

Say = Callable[[str], None]

CONFIGURATION = Path("/etc/skyfix/vehicle.toml")
COMMAND_TIMEOUT_S = 120.0
_DONE: dict[FileState, str] = {
    "absent": "written",
    "installed": "is there already",
    "another version": "brought up to date",
    "changed by hand": "replaced, with what somebody had changed in it",
}
_WOULD: dict[FileState, str] = {
    "absent": "would be written",
    "installed": "is there already",
    "another version": "would be brought up to date",
    "changed by hand": "would be replaced, with what somebody has changed in it",
}

# Commands that activate the files, each with a path whose existence shows that the command applies here.
_ACCOUNT = "/", ("systemd-sysusers", "skyfix.conf")
_FOLDERS = "/", ("systemd-tmpfiles", "--create", "skyfix.conf")
_RULES = "/run/udev/control", ("udevadm", "control", "--reload")
_SUBSYSTEMS = [f"--subsystem-match={name}" for name in ("tty", "i2c-dev", "video4linux")]
_DEVICES = "/run/udev/control", ("udevadm", "trigger", *_SUBSYSTEMS)
_UNITS = "/run/systemd/system", ("systemctl", "daemon-reload")
_STOP = "/run/systemd/system", ("systemctl", "disable", "--now", "skyfix.service")


def install(root: Path, *, dry_run: bool, force: bool, say: Say) -> None:
    """Install all files and, on the running system (root /), activate them.

    Raises ``RigError`` before any change: if the service could not start from this installation, permission is missing,
    or a file was edited and ``force`` is not given.
    """
    files = service_files()
    live = root == Path("/")
    hindrance = access_problem(program())
    if hindrance and live:
        raise RigError(
            f"{hindrance}; install skyfix into /opt/skyfix and run /opt/skyfix/bin/rig service install"
        )
    states = [(file, _state(file, root)) for file in files]
    for file, state in states:
        if state == "changed by hand" and not force:
            raise RigError(
                f"{file.at(root)}: somebody has changed it: move the changes into a drop-in (systemctl edit skyfix) or "
                f"a file of another name, then replace it with --force"
            )
    if not dry_run:
        _check_permission(files, root)

    for file, state in states:
        path = file.at(root)
        if not dry_run and state != "installed":
            _write(path, file.content)
        say(f"{path}: {(_WOULD if dry_run else _DONE)[state]}")
    if live:
        _run((_ACCOUNT, _FOLDERS, _RULES, _DEVICES, _UNITS), dry_run, say)
    say("")
    say("next:")
    if hindrance:
        say(f"  {hindrance} and could not be started from there; install skyfix into /opt/skyfix for that")
    if not (root / CONFIGURATION.relative_to("/")).exists():
        say(
            f"  cp /etc/skyfix/vehicle.example.toml {CONFIGURATION}    and adapt it; rig check --config {CONFIGURATION}"
        )
    say("  systemctl enable --now skyfix    starts it now and at each boot")
    say("  rig service status; journalctl -u skyfix")


def uninstall(root: Path, *, dry_run: bool, say: Say) -> bool:
    """Stop the service and remove the files of ``install``; True if none is left.

    Configuration, state, caches, the user and its groups stay, and so does an edited file.
    """
    files = service_files()
    states = [(file, _state(file, root)) for file in files]
    ours = [file for file, state in states if state in ("installed", "another version")]
    if not dry_run:
        _check_permission(ours, root)
    live = root == Path("/")
    if live and any(file.path.name == "skyfix.service" for file in ours):
        _run([_STOP], dry_run, say)
    for file, state in states:
        path = file.at(root)
        if state == "changed by hand":
            say(f"{path}: left, for somebody has changed it")
        elif state != "absent":
            if not dry_run:
                path.unlink()
            say(f"{path}: {'would be ' if dry_run else ''}removed")
    if not ours:
        say("nothing to remove")
    elif live:
        _run((_RULES, _UNITS), dry_run, say)
    say("left: /etc/skyfix, /var/lib/skyfix, /var/cache/skyfix, the user skyfix")
    return all(state != "changed by hand" for _, state in states)


def _state(file: ServiceFile, root: Path) -> FileState:
    try:
        return file.state(root)
    except OSError as error:
        raise RigError(
            f"{file.at(root)}: cannot be read: {error.strerror}; run this as root (sudo)"
        ) from error


def _check_permission(files: Sequence[ServiceFile], root: Path) -> None:
    """Checked for all files before the first is changed."""
    for file in files:
        folder = file.at(root).parent
        while not folder.exists():
            folder = folder.parent
        if not folder.is_dir():
            raise RigError(f"{folder}: is no folder; choose another --root")
        if not os.access(folder, os.W_OK | os.X_OK):
            raise RigError(
                f"{folder}: no permission to write here; run this as root (sudo), or look first with --dry-run"
            )


def _write(path: Path, content: bytes) -> None:
    try:
        write_atomically(path, content)
        path.chmod(0o644)
    except OSError as error:
        raise RigError(
            f"{path}: cannot be written: {error.strerror}; see to it and run this again"
        ) from error


def _run(steps: Sequence[tuple[str, tuple[str, ...]]], dry_run: bool, say: Say) -> None:
    for needs, command in steps:
        line = " ".join(command)
        if not Path(needs).exists() or shutil.which(command[0]) is None:
            say(f"{line}: not run, for {command[0]} has nothing to talk to here")
            continue
        if dry_run:
            say(f"{line}: would be run")
            continue
        try:
            done = subprocess.run(
                command, capture_output=True, text=True, timeout=COMMAND_TIMEOUT_S, check=False
            )
        except subprocess.TimeoutExpired as error:
            raise RigError(f"{line}: no end after {COMMAND_TIMEOUT_S:.0f} s; run it by hand") from error
        if done.returncode:
            said = " ".join((done.stderr or done.stdout).split())
            raise RigError(
                f"{line}: failed with status {done.returncode}: {said}; mend that and run this again"
            )
        say(f"{line}: done")
