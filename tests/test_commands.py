"""All commands of the three programs: help with an example, JSON wherever data are printed, completion by the shell."""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path

import click
import pytest
from click.shell_completion import ShellComplete
from click.testing import CliRunner

from localizer.commands.cli import localizer
from rig.commands.cli import rig
from sim.commands.cli import sim

PROGRAMS = {"rig": rig, "localizer": localizer, "sim": sim}

WITHOUT_JSON = {
    # what they print is the output of the command that they run
    "rig record",
    "sim run",
    "sim replay",
    # a service: what it knows is had from rig status and over HTTP
    "rig run",
    # they say what they do to the machine, for whoever does it
    "rig service install",
    "rig service uninstall",
    # a script for the shell
    "rig completion",
    "localizer completion",
    "sim completion",
}


def commands_of(command: click.Command, name: str) -> Iterator[tuple[str, click.Command]]:
    yield name, command
    if isinstance(command, click.Group):
        for word, each in command.commands.items():
            yield from commands_of(each, f"{name} {word}")


COMMANDS = {
    name: command for program, group in PROGRAMS.items() for name, command in commands_of(group, program)
}
LEAVES = sorted(name for name, command in COMMANDS.items() if not isinstance(command, click.Group))


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_help_has_an_example_of_this_very_command(name: str) -> None:
    program, *words = name.split()
    result = CliRunner().invoke(PROGRAMS[program], [*words, "--help"], prog_name=program)
    assert result.exit_code == 0
    _, example, rest = result.output.partition("Example")
    assert example, f"{name} --help shows no example"
    assert name in " ".join(rest.split()), f"the example of {name} is of another command"


@pytest.mark.parametrize("program", sorted(PROGRAMS))
def test_each_program_says_its_version_in_one_line(program: str) -> None:
    result = CliRunner().invoke(PROGRAMS[program], ["--version"], prog_name=program)
    assert result.exit_code == 0
    assert result.stdout == f"{program} {metadata.version('skyfix')}\n"
    assert result.stderr == ""


@pytest.mark.parametrize("name", LEAVES)
def test_every_option_is_explained_or_explains_itself(name: str) -> None:
    for parameter in COMMANDS[name].params:
        if isinstance(parameter, click.Option):
            explained = parameter.help or parameter.show_default or isinstance(parameter.type, click.Choice)
            assert explained, f"{name} {parameter.opts[0]} has no help"


@pytest.mark.parametrize("name", sorted({*LEAVES} - WITHOUT_JSON))
def test_a_command_that_prints_data_prints_json(name: str) -> None:
    options = [option for parameter in COMMANDS[name].params for option in parameter.opts]
    assert "--json" in options


@pytest.mark.parametrize("name", LEAVES)
def test_no_number_within_limits_may_be_nan(name: str) -> None:
    """NaN lies within the limits of click's own range."""
    for parameter in COMMANDS[name].params:
        if isinstance(parameter.type, click.FloatRange):
            with pytest.raises(click.BadParameter, match="not a finite number"):
                parameter.type.convert("nan", parameter, None)


def test_the_exceptions_are_commands_without_json() -> None:
    for name in WITHOUT_JSON:
        assert "--json" not in [option for parameter in COMMANDS[name].params for option in parameter.opts]


def completed(program: str, *words: str) -> list[tuple[str, str]]:
    """What the shell is offered for the last word, and of what kind."""
    complete = ShellComplete(PROGRAMS[program], {}, program, f"_{program.upper()}_COMPLETE")
    return [(item.value, item.type) for item in complete.get_completions(list(words[:-1]), words[-1])]


def test_what_is_completed() -> None:
    assert [name for name, _ in completed("rig", "wa")] == ["watch"]
    assert [name for name, _ in completed("rig", "watch", "--device", "c")] == ["compass", "camera"]
    assert completed("rig", "bundle", "show", "bun") == [("bun", "dir")]
    assert completed("localizer", "locate", "bun") == [("bun", "dir")]
    assert completed("rig", "capture", "--config", "veh") == [("veh", "file")]
    assert [name for name, _ in completed("sim", "evaluate", "--level", "")] == ["contour", "image"]


@pytest.mark.parametrize("program", sorted(PROGRAMS))
@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_script_for_a_shell(program: str, shell: str) -> None:
    result = CliRunner().invoke(PROGRAMS[program], ["completion", shell])
    assert result.exit_code == 0
    assert f"_{program.upper()}_COMPLETE={shell}_complete" in result.output


@pytest.mark.skipif(shutil.which("bash") is None, reason="there is no bash")
def test_bash_completes_with_what_was_installed(tmp_path: Path) -> None:
    environment = {
        **os.environ,
        "HOME": str(tmp_path),
        "XDG_DATA_HOME": str(tmp_path / "share"),
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
    }
    environment.pop("BASH_COMPLETION_USER_DIR", None)
    installed = subprocess.run(
        ["sim", "completion", "bash", "--install"],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    script = tmp_path / "share" / "bash-completion" / "completions" / "sim"
    assert installed.stdout.strip() == str(script)
    ask = (
        f'source "{script}"; COMP_WORDS=(sim re); COMP_CWORD=1; _sim_completion sim; echo "${{COMPREPLY[*]}}"'
    )
    answer = subprocess.run(["bash", "-c", ask], env=environment, capture_output=True, text=True, check=True)
    assert set(answer.stdout.split()) == {"render", "replay"}


def test_zsh_is_told_where_to_look(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    result = CliRunner().invoke(rig, ["completion", "zsh", "--install"])
    assert result.stdout == f"{tmp_path / '.zfunc' / '_rig'}\n"
    assert "fpath" in result.stderr


def test_a_service_that_is_not_installed_as_json(tmp_path: Path) -> None:
    result = CliRunner().invoke(
        rig, ["service", "status", "--root", str(tmp_path), "--json"], standalone_mode=False
    )
    found = json.loads(result.output)
    assert result.return_value == 1
    assert not found["good"]
    assert set(found["files"].values()) == {"absent"}


def test_no_folder_to_write_into_has_an_empty_name() -> None:
    """An unset variable of a script would have the files strewn over the current folder."""
    targets = {
        f"{name} {option.opts[0]}": option
        for name in LEAVES
        for option in COMMANDS[name].params
        if isinstance(option, click.Option) and option.metavar == "DIR" and option.opts[0] != "--photos"
    }
    assert {"rig capture --out", "rig service install --root", "localizer locate --report"} <= targets.keys()
    for option in targets.values():
        with pytest.raises(click.BadParameter, match="empty"):
            option.type.convert("", option, None)
