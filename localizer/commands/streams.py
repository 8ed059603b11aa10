"""Robust standard output and standard error: closed pipes and limited encodings."""

import codecs
import io
import os
import select
import sys
from contextlib import suppress
from typing import Any


def is_closed_pipe(stream: Any) -> bool:
    """Whether a stream is a pipe whose reader has closed it."""
    try:
        poll = select.poll()
        poll.register(stream.fileno(), 0)
        return any(event & select.POLLERR for _, event in poll.poll(0))
    except (AttributeError, OSError, ValueError):
        return False


def discard_output() -> None:
    """Discard further standard output if it cannot be written."""
    with suppress(OSError, ValueError, AttributeError):
        with suppress(OSError):
            sys.stdout.flush()
            return
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def replace_unencodable_characters() -> None:
    """Replace characters that standard output or standard error cannot encode, instead of failing.

    That is so with PYTHONIOENCODING=ascii, with LANG=C on some systems, and for file names that are no text.
    """
    codecs.register_error("skyfix-plain", _plain)
    codecs.register(_ascii)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            is_ascii = codecs.lookup(stream.encoding).name == "ascii"
            stream.reconfigure(encoding=ASCII if is_ascii else None, errors="skyfix-plain")
    if isinstance(sys.stdin, io.TextIOWrapper):
        sys.stdin.reconfigure(errors="replace")


ASCII = "skyfix-ascii"
"""ASCII under another name: click writes UTF-8 to a stream that says it is ASCII."""


def _ascii(name: str) -> codecs.CodecInfo | None:
    if name.replace("_", "-") != ASCII:
        return None
    same = codecs.lookup("ascii")
    return codecs.CodecInfo(
        same.encode,
        same.decode,
        same.streamreader,
        same.streamwriter,
        same.incrementalencoder,
        same.incrementaldecoder,
        name=ASCII,
    )


_PLAIN = str.maketrans(
    {
        "°": "deg ",
        "µ": "u",
        "μ": "u",
        "±": "+-",
        "²": "^2",
        "\N{EN DASH}": "-",
        "\N{EM DASH}": "-",
        "\N{MINUS SIGN}": "-",
        "…": "...",
        "→": "->",
        "\N{MULTIPLICATION SIGN}": "x",
        "•": "*",
    }
)


def _plain(error: UnicodeError) -> tuple[str, int]:
    """An error handler of ``codecs`` that replaces characters by ASCII."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    text = error.object[error.start : error.end].translate(_PLAIN)
    return text.encode("ascii", "backslashreplace").decode("ascii"), error.end
