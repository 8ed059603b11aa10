"""Limits for archives. Reading stops at the first one exceeded, before it costs memory, disk or time."""

import os
import re
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import PurePosixPath
from typing import IO

from localizer.bundle import is_bundle_id
from rig.errors import RigError

MAX_MEMBERS = 20_000
MAX_MEMBER_BYTES = 512_000_000
MAX_TOTAL_BYTES = 20_000_000_000
MAX_RATIO = 100
"""Compression ratio: pictures are already compressed, and the rest is small."""
RATIO_FROM_BYTES = 20_000_000
"""Below this size the ratio is not checked: a few small, similar bundles compress well."""
MAX_AT_ONCE_BYTES = 4_000_000
"""Largest single read of a header. A larger one (a tar's extended header, a zip's directory) is not from us."""
MAX_HEADER_BYTES = 65_536
"""All headers before one file of a tar: names and times take some hundred bytes."""
MAX_EXTENDED_BYTES = 2_000_000
"""All extended tar headers together; ``rig bundle export`` writes hardly any."""
LONGEST_NUMBER = 255
"""Digits in a row in a header. ``tarfile`` of Python 3.11 parses times in time quadratic in their length
(CVE-2024-6232), and no file name may be longer.
"""
LONGEST_NAME = 1200

_LONG_NUMBER = re.compile(rb"[0-9]{%d}" % (LONGEST_NUMBER + 1))


class ArchiveError(RigError):
    """An archive cannot be written, or is damaged or too large."""


class Tally:
    """Counts members and bytes of one archive. Each method raises ``ArchiveError`` beyond a limit."""

    def __init__(self, packed_bytes: int) -> None:
        self.most_bytes = min(MAX_TOTAL_BYTES, max(RATIO_FROM_BYTES, MAX_RATIO * packed_bytes))
        self._members = 0
        self._bytes = 0
        self._names: set[str] = set()

    def folder(self) -> None:
        """One more folder."""
        self._members += 1
        if self._members > MAX_MEMBERS:
            raise ArchiveError(f"holds more than {MAX_MEMBERS} files")

    def file(self, name: str, size: int) -> None:
        """One more file, of the size in its header; no more than that is read."""
        self.folder()
        if size < 0:  # possible in a tar header, and would decrease the count
            raise ArchiveError(f"its file {name} has {size} bytes")
        if size > MAX_MEMBER_BYTES:
            raise ArchiveError(
                f"its file {name} has {size / 1e6:.0f} MB; {MAX_MEMBER_BYTES / 1e6:.0f} is the most"
            )
        self._bytes += size
        if self._bytes > self.most_bytes:
            raise ArchiveError(compression_problem(self.most_bytes))
        key = name.casefold()  # on a case-insensitive file system the second would overwrite the first
        if key in self._names:
            raise ArchiveError(f"holds {name} twice, or two names that differ in case only")
        self._names.add(key)


def compression_problem(most_bytes: int) -> str:
    """The message for an archive with too high a compression ratio."""
    return f"unpacks to more than {most_bytes / 1e6:.0f} MB, far more than its size explains"


class Slices:
    """A file object for libraries that trust every size in an archive: it limits each read and the total.

    Reading more raises ``ArchiveError``.
    """

    def __init__(self, file: IO[bytes], most_bytes: int) -> None:
        self._file = file
        self._most_bytes = most_bytes
        self._header_left: int | None = None
        self._extended_left = MAX_EXTENDED_BYTES

    @contextmanager
    def header(self) -> Iterator[None]:
        """Apply the limits of tar headers while the context lasts: per file and in total."""
        self._header_left = MAX_HEADER_BYTES
        try:
            yield
        finally:
            self._header_left = None

    def _check_header(self, content: bytes) -> None:
        assert self._header_left is not None
        is_plain_block = self._header_left == MAX_HEADER_BYTES
        self._header_left -= len(content)
        self._extended_left -= 0 if is_plain_block else len(content)
        if min(self._header_left, self._extended_left) < 0 or _LONG_NUMBER.search(content):
            raise ArchiveError("is damaged or no archive: its headers are longer than any")

    def read(self, size: int = -1) -> bytes:
        """As for files; reading to the end only if little is left."""
        if size > MAX_AT_ONCE_BYTES:
            raise ArchiveError("is damaged or no archive: its headers ask for megabytes")
        content = self._file.read(size if size >= 0 else MAX_AT_ONCE_BYTES)
        if self._file.tell() > self._most_bytes:
            raise ArchiveError(compression_problem(self._most_bytes))
        if self._header_left is not None:
            self._check_header(content)
        return content

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """As files have it."""
        if whence == os.SEEK_SET and offset > self._most_bytes:
            raise ArchiveError(compression_problem(self._most_bytes))
        return self._file.seek(offset, whence)

    def tell(self) -> int:
        """As files have it."""
        return self._file.tell()

    def seekable(self) -> bool:
        """It is."""
        return True


def checked_name(name: str) -> str:
    """The checked name of an archive member: ``FILE`` at top level, or ``BUNDLE/PATH``; relative and inside on every
    system.

    Raises ``ArchiveError``.
    """
    path = PurePosixPath(name)
    if (
        not path.parts
        or path.is_absolute()
        or ".." in path.parts
        or "\\" in name
        or ":" in name
        or not name.isprintable()
        or len(name) > LONGEST_NAME
    ):
        raise ArchiveError(
            f"its file {name[:200]!r} leads outside, or has a name that files here cannot have"
        )
    if len(path.parts) > 1 and not is_bundle_id(path.parts[0]):
        raise ArchiveError(f"its folder {path.parts[0][:200]!r} is no bundle's: no bundle can have that id")
    return str(path)


def is_plain(mode: int) -> bool:
    """Whether a zip member is a regular file, by its Unix mode (0 if another system wrote it)."""
    return stat.S_IFMT(mode) in (0, stat.S_IFREG)
