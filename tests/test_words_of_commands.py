"""Commands on plain terminals, in pipes that close early, on a full disk, and with numbers below zero."""

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
import pytest
from click.testing import CliRunner

from localizer.commands.cli import localizer
from localizer.commands.command_line import NumbersCommand, run, take_negative_numbers
from localizer.commands.streams import replace_unencodable_characters
from rig.commands.cli import rig
from sim.commands.cli import sim

PROGRAMS = {"rig": rig, "localizer": localizer, "sim": sim}
ROOT = Path(__file__).parents[1]
TERRAIN = ROOT / "sim" / "terrain" / "santa_cruz_srtm_1s.tif"
PLAIN = {
    "PYTHONIOENCODING": "ascii",
    "LANG": "C",
    "LC_ALL": "C",
    "PYTHONCOERCECLOCALE": "0",
    "PYTHONUTF8": "0",
}


def names(command: click.Command, name: str) -> Iterator[str]:
    """Of all commands below one."""
    yield name
    if isinstance(command, click.Group):
        for word, each in command.commands.items():
            yield from names(each, f"{name} {word}")


def ran(*words: str, shell: str = "", **environment: str) -> subprocess.CompletedProcess[str]:
    """A command of the programs, by a shell where ``shell`` says what becomes of its output."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    command: Any = words if not shell else ["bash", "-c", f"set -o pipefail; {' '.join(words)} {shell}"]
    return subprocess.run(
        command, env={**os.environ, "PATH": path, **environment}, capture_output=True, text=True, check=False
    )


@pytest.mark.parametrize("name", [n for program, group in PROGRAMS.items() for n in names(group, program)])
def test_every_help_is_written_in_ascii_where_nothing_else_can_be(name: str) -> None:
    replace_unencodable_characters()  # registers the way
    program, *words = name.split()
    result = CliRunner().invoke(PROGRAMS[program], [*words, "--help"], prog_name=program)
    plain = result.output.encode("ascii", "skyfix-plain").decode("ascii")
    assert "\\x" not in plain
    assert "\\u" not in plain


def test_what_cannot_be_encoded_is_written_in_another_way() -> None:
    replace_unencodable_characters()
    assert "4 °C ± 2 µT…".encode("ascii", "skyfix-plain") == b"4 deg C +- 2 uT..."
    assert "Höhe".encode("ascii", "skyfix-plain") == b"H\\xf6he"
    assert os.fsdecode(b"a\xff").encode("utf-8", "skyfix-plain") == b"a\\udcff"  # a file name that is no text


@pytest.mark.parametrize(
    "words",
    [
        ("localizer", "dem", "info", str(TERRAIN)),
        ("localizer", "locate", "Höhe", "--dem", "é.tif"),
        ("rig", "check", "--config", "Höhe.toml"),
    ],
)
def test_no_traceback_with_an_ascii_terminal(words: tuple[str, ...]) -> None:
    done = ran(*words, **PLAIN)
    assert "Traceback" not in done.stderr
    assert done.returncode == (0 if "info" in words else 2)
    assert len(done.stderr.splitlines()) == (0 if "info" in words else 1)
    assert (done.stdout + done.stderr).isascii()


def test_a_reader_that_has_enough_is_no_error() -> None:
    many = "import click, sys\nfrom localizer.commands.command_line import run\n"
    many += "run(click.Command('many', callback=lambda: [click.echo('x' * 9000) for _ in range(99)] and None), 'many')"
    for shell in ("| head -1", "2>&1 | head -1"):
        done = ran(sys.executable, "-c", f'"{many}"', shell=shell)
        assert done.stderr == ""
        assert done.returncode in (0, 141)
    few = ran("rig", "--help", shell="| true", PYTHONUNBUFFERED="1")
    assert few.stderr == ""


def test_a_question_that_nobody_answers_is_no_interruption() -> None:
    ask = "import click\nfrom localizer.commands.command_line import run\n"
    ask += "run(click.Command('ask', callback=lambda: click.confirm('Sure?')), 'ask')"
    done = subprocess.run(
        [sys.executable, "-c", ask], stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1].startswith(
        "ask: a question was not answered: standard input has ended"
    )


def test_a_full_disk_under_standard_output_is_said() -> None:
    done = ran("localizer", "dem", "info", str(TERRAIN), shell="> /dev/full")
    assert done.returncode == 2
    assert done.stderr == "localizer: the disk is full; make room, or write elsewhere\n"
    assert ran("localizer", "dem", "info", str(TERRAIN), shell=">&-").returncode == 0


def parsed(command: click.Command, *words: str) -> dict[str, Any]:
    found: dict[str, Any] = command.make_context(command.name, list(words)).params
    return found


@pytest.mark.parametrize(
    "words", [("-33.1", "-151.2"), ("--", "-33.1", "-151.2"), ("-33.1", "--json", "-151.2")]
)
def test_a_drive_south_and_west_needs_no_dashes(words: tuple[str, ...]) -> None:
    found = parsed(sim.commands["drive"], *words)
    assert (found["lat_deg"], found["lon_deg"]) == (-33.1, -151.2)


def test_numbers_below_zero_are_numbers() -> None:
    move = rig.commands["move"]
    assert [parsed(move, "-10", "5")[key] for key in ("pan_deg", "tilt_deg")] == [-10.0, 5.0]
    assert [parsed(move, "--json", "-.5", "-1e1")[key] for key in ("pan_deg", "tilt_deg")] == [-0.5, -10.0]
    assert parsed(sim.commands["drive"], "1", "-2", "--heading", "-90")["heading_deg"] == -90.0
    with pytest.raises(click.NoSuchOption, match="--prk"):
        parsed(move, "--prk")


def test_a_place_in_two_words_is_understood_as_one(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    words = ["localizer", "predict", "--dem", "x.tif", "--at", "37.2", "-122.1"]
    monkeypatch.setattr(sys, "argv", words)
    with pytest.raises(SystemExit):
        run(PROGRAMS["localizer"], "localizer")
    assert "a place is one word with a comma and no blank: LAT,LON" in capsys.readouterr().err


def test_every_command_takes_numbers_below_zero_for_numbers() -> None:
    @click.group()
    def group() -> None:
        pass

    @group.command()
    @click.argument("number", type=float)
    def inner(number: float) -> None:
        pass

    take_negative_numbers(group)
    assert isinstance(inner, NumbersCommand)
    assert parsed(inner, "-4")["number"] == -4.0
