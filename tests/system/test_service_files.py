"""The service's files as systemd's and udev's own tools see them, from this installation and from a built wheel."""

import os
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

pytestmark = pytest.mark.system

Program = Callable[[str], Path]
PROJECT = Path(__file__).parents[2]
MAX_EXPOSED = 2.0
"""systemd's own scale, 0 to 10."""


def run(*command: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A root with the service installed."""
    root = tmp_path_factory.mktemp("root")
    done = run(Path(sys.prefix) / "bin/rig", "service", "install", "--root", root)
    assert done.returncode == 0, done.stderr
    return root


def unit(root: Path) -> Path:
    return root / "etc/systemd/system/skyfix.service"


def test_systemd_understands_every_line_of_the_unit(installed: Path, program: Program) -> None:
    done = run(program("systemd-analyze"), "verify", unit(installed))
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("WatchdogSeconds=60", "'WatchdogSeconds' in section"),
        ("Type=notfy", "Failed to parse service type"),
    ],
)
def test_an_unknown_line_would_be_reported(
    installed: Path, program: Program, tmp_path: Path, line: str, said: str
) -> None:
    changed = tmp_path / "skyfix.service"
    changed.write_text(unit(installed).read_text().replace("[Service]\n", f"[Service]\n{line}\n"))
    assert said in run(program("systemd-analyze"), "verify", changed).stderr


def test_the_sandbox_leaves_little_open(installed: Path, program: Program) -> None:
    threshold = f"--threshold={MAX_EXPOSED * 10:.0f}"
    done = run(program("systemd-analyze"), "security", "--offline=true", threshold, unit(installed))
    assert done.returncode == 0, done.stdout
    assert done.stderr == ""


def test_the_user_comes_with_the_groups_of_the_devices(
    installed: Path, program: Program, tmp_path: Path
) -> None:
    conf = installed / "etc/sysusers.d/skyfix.conf"
    done = run(program("systemd-sysusers"), f"--root={tmp_path}", "--dry-run", conf)
    assert done.returncode == 0, done.stderr
    assert not list(tmp_path.rglob("passwd"))
    (tmp_path / "etc").mkdir()
    done = run(program("systemd-sysusers"), f"--root={tmp_path}", conf)
    assert done.returncode == 0, done.stderr
    (user,) = (tmp_path / "etc/passwd").read_text().splitlines()
    assert user.split(":")[0] == "skyfix"
    assert user.split(":")[5:] == ["/var/lib/skyfix", "/usr/sbin/nologin"]
    members = {
        line.split(":")[0]: line.split(":")[3] for line in (tmp_path / "etc/group").read_text().splitlines()
    }
    assert members == {"skyfix": "", "dialout": "skyfix", "i2c": "skyfix", "video": "skyfix"}


@pytest.mark.skipif(os.geteuid() != 0, reason="folders of other owners are made by root only")
def test_the_folders(installed: Path, program: Program, tmp_path: Path) -> None:
    (tmp_path / "etc").mkdir()
    run(program("systemd-sysusers"), f"--root={tmp_path}", installed / "etc/sysusers.d/skyfix.conf")
    done = run(
        program("systemd-tmpfiles"),
        "--create",
        f"--root={tmp_path}",
        installed / "etc/tmpfiles.d/skyfix.conf",
    )
    assert (done.returncode, done.stderr) == (0, "")
    group = next(
        line.split(":")[2]
        for line in (tmp_path / "etc/group").read_text().splitlines()
        if line.startswith("skyfix:")
    )
    folder = (tmp_path / "etc/skyfix/calibration").stat()
    assert (oct(folder.st_mode & 0o7777), folder.st_gid) == ("0o2775", int(group))


def udev_says(rules: Path, udevadm: Path) -> str:
    """What udev says of a file of rules. Elder ones have no ``verify``, but say it before they test a device."""
    if run(udevadm, "verify", "--help").returncode == 0:
        return run(udevadm, "verify", "--resolve-names=never", rules).stderr
    # In a mount namespace of its own, where only these rules are at the place from which udev reads.
    script = """
        mkdir -p /run/udev && mount -t tmpfs none /run/udev && mkdir /run/udev/rules.d
        cp "$0" /run/udev/rules.d/
        { cat /etc/group; echo i2c:x:60123:; } >/run/udev/group # of the service's sysusers
        mount --bind /run/udev/group /etc/group
        exec "$1" test /sys/class/net/lo
    """
    done = run("unshare", "--mount", "sh", "-ec", script, rules, udevadm)
    if "Reading rules file: /run/udev/rules.d" not in done.stderr:
        pytest.skip(f"udevadm verify is not there, nor a mount namespace to do without: {done.stderr}")
    return "\n".join(
        line for line in done.stderr.splitlines() if line.startswith(f"/run/udev/rules.d/{rules.name}")
    )


def test_udev_understands_every_rule(installed: Path, program: Program, tmp_path: Path) -> None:
    rules = installed / "etc/udev/rules.d/70-skyfix.rules"
    assert udev_says(rules, program("udevadm")) == ""
    wrong = tmp_path / "70-skyfix.rules"
    wrong.write_text(rules.read_text().replace("SUBSYSTEMS==", "SUBSYTEMS=="))
    assert "SUBSYTEMS" in udev_says(wrong, program("udevadm"))


def test_a_wheel_brings_the_same_files(installed: Path, tmp_path: Path) -> None:
    source = tmp_path / "source"
    others = shutil.ignore_patterns(".*", "build", "*.egg-info", "demo", "evaluation", "spool", "__pycache__")
    shutil.copytree(PROJECT, source, symlinks=True, ignore=others)
    built = run(sys.executable, "-m", "pip", "wheel", "--no-deps", "--quiet", "--wheel-dir", tmp_path, source)
    assert built.returncode == 0, built.stderr
    (wheel,) = tmp_path.glob("skyfix-*.whl")
    site = tmp_path / "site"
    with zipfile.ZipFile(wheel) as packed:
        packed.extractall(site)
    root = tmp_path / "root"
    # From the wheel's content, with the libraries of this environment.
    rig = """
import sys
sys.path.insert(0, sys.argv.pop(1))
from rig.commands import cli
assert cli.__file__.startswith(sys.path[0])
cli.main()
"""
    done = run(sys.executable, "-I", "-c", rig, site, "service", "install", "--root", root)
    assert done.returncode == 0, done.stderr
    files = {path.relative_to(root) for path in root.rglob("*") if path.is_file()}
    assert len(files) == 5
    for path in files:
        assert (root / path).read_bytes() == (installed / path).read_bytes()
