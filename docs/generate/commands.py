"""The reference of the commands, from what ``--help`` is made of."""

import inspect
import re
from collections.abc import Iterator

import click

from generate.markdown import GENERATED, code, escaped, table
from localizer.commands.cli import localizer
from rig.commands.cli import rig
from sim.commands.cli import sim

PROGRAMS: dict[str, click.Group] = {"rig": rig, "localizer": localizer, "sim": sim}
_EXAMPLE = re.compile(r"Examples?:\s*")


def commands_page() -> str:
    """All commands of the three programs."""
    parts = [
        "# Commands\n",
        GENERATED,
        "What `--help` says of each command. All three programs print results on standard output and all else on standard"
        " error. They end with status 2 and one line on bad input. `-h` and `--help` work everywhere.\n",
    ]
    for program, group in PROGRAMS.items():
        parts += [_section(name, command, program) for name, command in commands_of(group, program)]
    return "\n".join(parts)


def commands_of(command: click.Command, name: str) -> Iterator[tuple[str, click.Command]]:
    """A command and all below it, by full name."""
    yield name, command
    if isinstance(command, click.Group):
        for word, each in sorted(command.commands.items()):
            yield from commands_of(each, f"{name} {word}")


def _section(name: str, command: click.Command, program: str) -> str:
    context = click.Context(command, info_name=name)
    parts = [f"{'##' if name == program else '###'} {name}\n"]
    if not isinstance(command, click.Group):
        parts.append(f"```\n{name} {' '.join(command.collect_usage_pieces(context))}\n```\n")
    parts.append(help_text(command.help or ""))
    if isinstance(command, click.Group):
        parts.append("Commands: " + ", ".join(code(word) for word in sorted(command.commands)) + ".\n")
    options = [each for each in command.params if isinstance(each, click.Option) and not each.hidden]
    if options:
        rows = [
            [option_names(o), escaped(_meaning(o)), option_range(o), option_default(o, context)]
            for o in options
        ]
        parts.append(table(["option", "meaning", "range", "default"], rows))
    return "\n".join(parts)


def help_text(text: str) -> str:
    """A command's help as Markdown: paragraphs; what click prints verbatim, and examples, as code."""
    parts = []
    for paragraph in re.split(r"\n\s*\n", inspect.cleandoc(text).strip()):
        lines = paragraph.split("\n")
        is_verbatim = lines[0].strip() == "\b"
        lines = lines[1:] if is_verbatim else lines
        example = _EXAMPLE.match(lines[0])
        if example:
            lines[0] = lines[0][example.end() :]
            parts.append("For example:\n")
        if example and not is_verbatim:
            lines = [" ".join(" ".join(lines).split())]
        if is_verbatim or example:
            shown = inspect.cleandoc("\n" + "\n".join(line for line in lines if line.strip()))
            parts.append(f"```\n{shown}\n```\n")
        else:
            parts.append(escaped(" ".join(" ".join(lines).split())) + "\n")
    return "\n".join(parts)


def option_names(option: click.Option) -> str:
    """``--cases N``; both names of a switch."""
    names = ", ".join([*option.opts, *option.secondary_opts])
    if option.is_flag or (isinstance(option.type, click.Choice) and not option.metavar):
        return code(names)
    value = option.metavar or _VALUES.get(option.type.name, option.type.name.upper())
    return code(f"{names} {value}")


_VALUES = {"float range": "NUMBER", "float": "NUMBER", "integer range": "INTEGER", "path": "FILE"}


def option_range(option: click.Option) -> str:
    """Between what limits a number may be, or what can be chosen."""
    kind = option.type
    if isinstance(kind, click.Choice):
        return ", ".join(code(str(choice)) for choice in kind.choices)
    if not isinstance(kind, click.IntRange | click.FloatRange):
        return ""
    if kind.min is not None and kind.max is not None and not (kind.min_open or kind.max_open):
        return f"{kind.min:g} to {kind.max:g}"
    least = [] if kind.min is None else [f"{'>' if kind.min_open else '≥'} {kind.min:g}"]
    most = [] if kind.max is None else [f"{'<' if kind.max_open else '≤'} {kind.max:g}"]
    return ", ".join([*least, *most])


def option_default(option: click.Option, context: click.Context) -> str:
    """What holds where the option is absent; empty where that is nothing."""
    default = option.get_default(context, call=False)
    if option.required:
        return "required"
    if isinstance(option.show_default, str):
        return escaped(option.show_default)
    if option.is_flag or not isinstance(default, str | int | float | tuple) or default == ():
        return ""
    return code(" ".join(map(str, default)) if isinstance(default, tuple) else str(default))


def _meaning(option: click.Option) -> str:
    text = option.help or ""
    if option.multiple and not re.search(r"repeat|several|once for each", text, re.IGNORECASE):
        text = f"{text} May be given several times.".strip()
    return text
