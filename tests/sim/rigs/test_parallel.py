"""Work in several processes: every result is handed over, and nothing is left behind by an early end."""

import os
import signal
import subprocess
import tempfile
import time
from contextlib import closing
from pathlib import Path

import pytest

from localizer.errors import SkyfixError
from sim.launch.child_command import find_command, search_path
from sim.rigs.parallel import run_in_parallel

PATIENCE_S = 240.0
ENDS_WITHIN_S = 20.0


def process_of(item: int) -> tuple[int, int]:
    if item == 13:
        raise SkyfixError("13 is a bad number")
    if item == 14:
        os._exit(7)
    return item, os.getpid()


def linger(folder: str) -> None:
    with tempfile.TemporaryDirectory(dir=folder):
        time.sleep(1000.0)


def test_each_item_has_a_process_of_its_own() -> None:
    done = dict(run_in_parallel(process_of, range(5), 2))
    assert sorted(done) == list(range(5))
    assert len({*done.values(), os.getpid()}) == 6


def test_an_expected_failure_there_is_one_here() -> None:
    with pytest.raises(SkyfixError, match="13 is a bad number"):
        list(run_in_parallel(process_of, [1, 13], 1))


def test_a_process_without_a_result_is_a_defect() -> None:
    with pytest.raises(RuntimeError, match="ended with status 7 and no result"):
        list(run_in_parallel(process_of, [14], 1))


def test_an_early_end_ends_what_runs_through_its_clean_up(tmp_path: Path) -> None:
    def interrupt(number: int, frame: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGALRM, interrupt)
    signal.setitimer(signal.ITIMER_REAL, 1.0)
    try:
        with (
            pytest.raises(KeyboardInterrupt),
            closing(run_in_parallel(linger, [str(tmp_path)] * 3, 2)) as done,
        ):
            list(done)
    finally:
        signal.signal(signal.SIGALRM, before)
    assert list(tmp_path.iterdir()) == []


def descendants(pid: int) -> dict[int, str]:
    """All processes below one, with their command lines."""
    found: dict[int, str] = {}
    try:
        for task in Path(f"/proc/{pid}/task").iterdir():
            for child in map(int, (task / "children").read_text().split()):
                found[child] = Path(f"/proc/{child}/cmdline").read_text().replace("\0", " ")
                found |= descendants(child)
    except (FileNotFoundError, ProcessLookupError):  # it has ended meanwhile
        pass
    return found


@pytest.mark.timeout(600)
def test_a_polite_end_of_sim_rigs_leaves_neither_process_nor_folder(tmp_path: Path) -> None:
    with subprocess.Popen(
        [find_command("sim"), "rigs", "--rigs", "3", "--jobs", "2"],
        env={**os.environ, "PATH": search_path(), "TMPDIR": str(tmp_path)},
        stderr=subprocess.PIPE,
        text=True,
    ) as rigs:
        deadline_s = time.monotonic() + PATIENCE_S
        below: dict[int, str] = {}
        while sum("rig calibrate camera" in command for command in below.values()) < 2:
            assert rigs.poll() is None
            assert time.monotonic() < deadline_s, below
            time.sleep(0.1)
            below = descendants(rigs.pid)
        time.sleep(1.0)
        assert len(list(tmp_path.iterdir())) >= 4
        begun_s = time.monotonic()
        rigs.terminate()
        assert rigs.wait(PATIENCE_S) == 128 + signal.SIGTERM
        assert time.monotonic() - begun_s < ENDS_WITHIN_S
        assert rigs.stderr
        assert "Traceback" not in rigs.stderr.read()
    assert [command for pid, command in below.items() if Path(f"/proc/{pid}").exists()] == []
    assert list(tmp_path.iterdir()) == []
