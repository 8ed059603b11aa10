"""Running the command ``rig`` in this process, on a fake rig."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from fakes.command import Run
from fakes.whole_rig import FakeRig, RunningRig, running_rig

from rig.commands.cli import main


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> Run:
    """Runs ``rig`` with arguments in this process: exit status, standard output, standard error."""
    monkeypatch.delenv("SKYFIX_CONFIG", raising=False)
    monkeypatch.chdir(tmp_path)

    def rig(*arguments: str | Path) -> tuple[int, str, str]:
        monkeypatch.setattr("sys.argv", ["rig", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main()
        printed = capsys.readouterr()
        assert isinstance(ended.value.code, int)
        return ended.value.code, printed.out, printed.err

    return rig


@pytest.fixture
def running(monkeypatch: pytest.MonkeyPatch) -> Iterator[RunningRig]:
    with running_rig(monkeypatch, FakeRig()) as rig:
        yield rig
