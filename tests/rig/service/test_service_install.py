"""``rig service`` into a directory: the installed files and the messages."""

import os
import re
import stat
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

import rig.service.install  # noqa: F401 - it takes names from `files` when first imported, perhaps those of a test
from rig.commands.cli import main
from rig.config.load import load_config
from rig.errors import RigError
from rig.service import access_check, files

Run = Callable[..., tuple[int, str, str]]

PATHS = [
    "etc/skyfix/vehicle.example.toml",
    "etc/systemd/system/skyfix.service",
    "etc/sysusers.d/skyfix.conf",
    "etc/tmpfiles.d/skyfix.conf",
    "etc/udev/rules.d/70-skyfix.rules",
]
UNIT, RULES = PATHS[1], PATHS[4]


@pytest.fixture
def service(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> Run:
    """Runs ``rig service`` with --root: exit status, standard output without the root, standard error."""

    def run(command: str, *arguments: str, root: Path = tmp_path) -> tuple[int, str, str]:
        monkeypatch.setattr("sys.argv", ["rig", "service", command, "--root", str(root), *arguments])
        with pytest.raises(SystemExit) as ended:
            main()
        printed = capsys.readouterr()
        assert isinstance(ended.value.code, int)
        return ended.value.code, printed.out.replace(f"{root}/", ""), printed.err

    return run


def tree(root: Path) -> dict[str, bytes]:
    return {str(path.relative_to(root)): path.read_bytes() for path in root.rglob("*") if path.is_file()}


def test_what_is_installed(service: Run, tmp_path: Path) -> None:
    status, out, err = service("install")
    assert (status, err) == (0, "")
    assert sorted(tree(tmp_path)) == PATHS
    done, _, following = out.partition("\nnext:\n")
    assert sorted(done.splitlines()) == [f"{path}: written" for path in PATHS]
    assert "cp /etc/skyfix/vehicle.example.toml /etc/skyfix/vehicle.toml" in following
    assert "systemctl enable --now skyfix" in following
    assert all(stat.S_IMODE((tmp_path / path).stat().st_mode) == 0o644 for path in PATHS)


def test_the_service_starts_this_installation(service: Run, tmp_path: Path) -> None:
    service("install")
    started = re.findall("^ExecStart=(.*)$", (tmp_path / UNIT).read_text(), re.M)
    assert started == [f"{sys.prefix}/bin/rig run"]


def test_the_example_is_a_configuration_with_the_spool_where_a_service_may_write(
    service: Run, tmp_path: Path
) -> None:
    service("install")
    run = load_config(tmp_path / "etc/skyfix/vehicle.example.toml").run
    assert run is not None
    assert run.spool.dir == Path("/var/lib/skyfix/spool")


def test_installing_again_changes_nothing(service: Run, tmp_path: Path) -> None:
    service("install")
    before = {path: (tmp_path / path).stat().st_mtime_ns for path in PATHS}
    status, out, _ = service("install")
    assert status == 0
    assert out.count(": is there already\n") == len(PATHS)
    assert {path: (tmp_path / path).stat().st_mtime_ns for path in PATHS} == before


def test_a_dry_run_writes_nothing(service: Run, tmp_path: Path) -> None:
    status, out, _ = service("install", "--dry-run")
    assert status == 0
    assert out.count(": would be written\n") == len(PATHS)
    assert not list(tmp_path.iterdir())
    service("install")
    before = tree(tmp_path)
    assert service("uninstall", "--dry-run")[1].count(": would be removed\n") == len(PATHS)
    assert tree(tmp_path) == before


def test_another_version_is_brought_up_to_date(
    service: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as elsewhere:
        elsewhere.setattr(files, "program", lambda: Path("/opt/old/bin/rig"))
        service("install")
    assert "ExecStart=/opt/old/bin/rig run\n" in (tmp_path / UNIT).read_text()
    status, out, _ = service("status")
    assert (status, f"{UNIT}: another version" in out) == (1, True)
    assert f"{UNIT}: brought up to date" in service("install")[1]
    assert service("status")[0] == 0


def test_what_somebody_has_changed_is_neither_replaced_nor_removed(service: Run, tmp_path: Path) -> None:
    service("install")
    rules = tmp_path / RULES
    rules.write_text(rules.read_text() + 'SUBSYSTEM=="tty", KERNELS=="1-1.2", SYMLINK+="skyfix/compass"\n')
    changed = rules.read_text()
    before = tree(tmp_path)

    status, out, err = service("install")
    assert (status, out) == (2, "")
    assert err.startswith(f"rig: {rules}: somebody has changed it: move the changes into a drop-in")
    assert err.count("\n") == 1
    assert tree(tmp_path) == before

    status, out, _ = service("status")
    assert (status, f"{RULES}: changed by hand" in out) == (1, True)
    status, out, _ = service("uninstall")
    assert (status, f"{RULES}: left, for somebody has changed it" in out) == (1, True)
    assert rules.read_text() == changed

    status, out, _ = service("install", "--force")
    assert (status, f"{RULES}: replaced, with what somebody had changed in it" in out) == (0, True)
    assert service("status")[0] == 0


def test_a_file_of_another_origin_is_left(service: Run, tmp_path: Path) -> None:
    (tmp_path / UNIT).parent.mkdir(parents=True)
    (tmp_path / UNIT).write_text("[Service]\nExecStart=/bin/true\n")
    assert service("install")[0] == 2
    assert sorted(tree(tmp_path)) == [UNIT]


def test_uninstalling_leaves_configuration_state_and_what_others_have(service: Run, tmp_path: Path) -> None:
    theirs = {
        "etc/skyfix/vehicle.toml": b"mine",
        "var/lib/skyfix/spool/index.sqlite": b"fixes",
        "etc/udev/rules.d/60-other.rules": b"others",
    }
    for path, content in theirs.items():
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_bytes(content)
    _, out, _ = service("install")
    assert "vehicle.example.toml /etc" not in out
    status, out, _ = service("uninstall")
    assert status == 0
    assert out.count(": removed\n") == len(PATHS)
    assert tree(tmp_path) == theirs
    status, out, _ = service("uninstall")
    assert (status, "nothing to remove" in out) == (0, True)
    assert service("status")[0] == 1


def test_without_permission_nothing_is_touched(
    service: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    closed = tmp_path / "etc/udev/rules.d"
    closed.mkdir(parents=True)
    # What anybody but root would be told.
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path) != closed)
    status, out, err = service("install")
    assert (status, out) == (2, "")
    assert err == (
        f"rig: {closed}: no permission to write here; run this as root (sudo), or look first with --dry-run\n"
    )
    assert not tree(tmp_path)
    assert service("install", "--dry-run")[0] == 0


def test_a_root_that_is_a_file(service: Run, tmp_path: Path) -> None:
    (tmp_path / "etc").write_text("")
    status, _, err = service("install")
    assert (status, err) == (2, f"rig: {tmp_path / 'etc'}: is no folder; choose another --root\n")


def test_an_installation_in_a_home_is_reported(
    service: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rig.service.access_check.HOMES", (Path(sys.prefix),))
    assert (
        f"{sys.prefix}/bin/rig: the service may not see homes and could not be started"
        in service("install")[1]
    )


def test_an_installation_behind_a_closed_folder_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rig.service.access_check.HOMES", ())
    closed = tmp_path / "closed"
    (closed / "bin").mkdir(parents=True)
    (closed / "bin/rig").touch()
    (closed / "bin").chmod(0o755)
    (closed / "bin/rig").chmod(0o755)
    closed.chmod(0o750)
    assert access_check.access_problem(closed / "bin/rig") == f"{closed}: the user skyfix may not enter it"


@pytest.mark.parametrize(
    ("folder", "said"),
    [("my programs/bin", "a service cannot be started from a path like this"), ("absent", "no program rig")],
)
def test_an_installation_that_no_unit_can_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, folder: str, said: str
) -> None:
    (tmp_path / "my programs/bin").mkdir(parents=True)
    (tmp_path / "my programs/bin/rig").touch()
    monkeypatch.setattr("sysconfig.get_path", lambda name: str(tmp_path / folder))
    with pytest.raises(RigError, match=said):
        files.program()
