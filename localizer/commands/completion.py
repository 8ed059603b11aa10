"""The command ``completion`` that each program has, and what completes arguments that are folders."""

import os
from pathlib import Path

import click
from click.shell_completion import CompletionItem, get_completion_class

from localizer.errors import SkyfixError

SHELLS = ("bash", "zsh", "fish")


def folders(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Have the shell complete folders, which is what bundles are."""
    return [CompletionItem(incomplete, type="dir")]


def completion_command(program: str) -> click.Command:
    """``PROGRAM completion SHELL``, to be added to the program's group."""

    @click.command(
        help=f"""Print what makes a shell complete commands, options and files of {program}, or install it for this user.

        \b
        Examples:
          source <({program} completion bash)
          {program} completion zsh --install
        """,
        short_help=f"Have the shell complete {program}.",
    )
    @click.argument("shell", type=click.Choice(SHELLS))
    @click.option(
        "--install", is_flag=True, help="Write it where the shell looks for it, and print that file."
    )
    @click.pass_context
    def completion(context: click.Context, shell: str, install: bool) -> None:
        kind = get_completion_class(shell)
        assert kind is not None
        script = kind(context.find_root().command, {}, program, f"_{program.upper()}_COMPLETE").source()
        if not install:
            click.echo(script)
            return
        path = script_path(shell, program)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(script, encoding="utf-8")
        except OSError as error:
            raise SkyfixError(f"{path}: cannot be written: {error.strerror}; print it instead") from error
        click.echo(path)
        if shell == "zsh":
            click.echo(
                f"add to ~/.zshrc, where it is not there yet: fpath+={path.parent}; autoload -Uz compinit && compinit",
                err=True,
            )

    return completion


def script_path(shell: str, program: str) -> Path:
    """Where a shell looks for completions of this user; zsh only where ``fpath`` names the folder."""
    home = Path.home()
    if shell == "bash":
        data = Path(os.environ.get("XDG_DATA_HOME") or home / ".local" / "share")
        folder = Path(os.environ.get("BASH_COMPLETION_USER_DIR") or data / "bash-completion")
        return folder / "completions" / program
    if shell == "fish":
        config = Path(os.environ.get("XDG_CONFIG_HOME") or home / ".config")
        return config / "fish" / "completions" / f"{program}.fish"
    return home / ".zfunc" / f"_{program}"
