"""Tables and text as Markdown."""

import re
from collections.abc import Iterable, Sequence

GENERATED = "<!-- Made by `make reference` from the code. Change it there. -->\n"


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table; a bar in a cell is escaped."""
    lines = [list(header), ["---"] * len(header), *rows]
    return "".join("| " + " | ".join(_cell(text) for text in line) + " |\n" for line in lines)


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", r"\|")


def escaped(text: str) -> str:
    """Plain text, so that nothing in it is taken for markup but code between backticks."""
    parts = re.split(r"(`[^`]*`)", text)
    return "".join(
        part if part.startswith("`") else re.sub(r"([\\*<\[\]$]|\b_|_\b)", r"\\\1", part) for part in parts
    )


def from_docstring(text: str) -> str:
    """A docstring's text: its ``code`` becomes `code`."""
    return escaped(" ".join(text.split()).replace("``", "`"))


def code(text: str) -> str:
    """Text as code, in a line."""
    return f"`{text}`" if text else ""
