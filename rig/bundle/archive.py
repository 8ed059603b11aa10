"""Writes bundles into one archive file: under a temporary name, read back, then renamed.

The archive is a .tar (pictures are already compressed), .tar.gz or .zip. It has a folder for each bundle, named by its
id, ``index.csv`` with a row for each frame, and ``SHA256SUMS`` of all files, so that ``sha256sum -c SHA256SUMS`` checks
it without this program.
"""

import csv
import hashlib
import io
import os
import secrets
import shutil
import tarfile
import time
import zipfile
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path, PurePosixPath
from typing import IO, Protocol

from localizer.bundle import FILE_NAME, Bundle
from rig.atomic import make_folder, sync
from rig.bundle.limits import ArchiveError
from rig.bundle.summary import TABLE_COLUMNS, table_rows
from rig.bundle.unpack import SUMS_NAME, bundles_of_archive, unpack_archive
from rig.bundle.writer import MIN_FREE_BYTES, existing_part

__all__ = ["ArchiveError", "bundles_of_archive", "is_archive", "unpack_archive", "write_archive"]

INDEX_NAME = "index.csv"
SUFFIXES = (".tar", ".tar.gz", ".tgz", ".zip")


class _Writer(Protocol):
    def add(self, name: str, content: bytes) -> None: ...

    def close(self) -> None: ...


def is_archive(path: Path) -> bool:
    """Whether a path is an archive: a file with an archive's suffix."""
    return path.name.lower().endswith(SUFFIXES) and not path.is_dir()


def write_archive(path: Path, bundles: Sequence[Bundle]) -> None:
    """Write bundles into a new archive, then read it back to the last byte and compare.

    ``ArchiveError`` if the name has no known suffix or exists, two bundles have the same id, the disk refuses, or the
    archive read back differs. Nothing is left behind then.
    """
    if not path.name.lower().endswith(SUFFIXES):
        raise ArchiveError(f"{path}: no archive format; name it {', '.join(SUFFIXES)}")
    if path.exists():
        raise ArchiveError(f"{path}: is there already; choose another name")
    ids = [bundle.id for bundle in bundles]
    twice = sorted({each for each in ids if ids.count(each) > 1})
    if twice:
        raise ArchiveError(f"{path}: bundle {twice[0]} is among them twice; leave one out")
    partial = path.with_name(f".{secrets.token_hex(4)}.partial-{path.name}")
    try:
        _require_space(path, bundles)
        make_folder(path.parent)
        with partial.open("xb") as file:
            sums = _write(file, path.name.lower(), bundles)
            file.flush()
            os.fsync(file.fileno())
            os.posix_fadvise(
                file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED
            )  # drop the page cache, so that the check reads the disk
        for _ in bundles_of_archive(partial, sums):
            pass
        partial.rename(path)
        sync(path.parent)
    except OSError as error:
        raise ArchiveError(
            f"{path}: cannot be written: {error.strerror or error}; choose another --out"
        ) from error
    finally:
        partial.unlink(missing_ok=True)


def _write(file: IO[bytes], name: str, bundles: Sequence[Bundle]) -> dict[str, str]:
    """Write all members; their checksums by name."""
    sums: dict[str, str] = {}
    writer: _Writer
    writer = (
        _ZipWriter(file)
        if name.endswith(".zip")
        else _TarWriter(file, "w" if name.endswith(".tar") else "w:gz")
    )
    with closing(writer):

        def add(member: str, content: bytes) -> None:
            sums[member] = hashlib.sha256(content).hexdigest()
            writer.add(member, content)

        index = io.StringIO()
        table = csv.DictWriter(index, TABLE_COLUMNS, lineterminator="\n")
        table.writeheader()
        for bundle in bundles:
            table.writerows(table_rows(bundle))
            files = dict.fromkeys(str(PurePosixPath(frame.file)) for frame in bundle.frames)  # once if shared
            for member in (FILE_NAME, *files):
                add(f"{bundle.id}/{member}", (bundle.directory / member).read_bytes())
        add(INDEX_NAME, index.getvalue().encode())
        writer.add(SUMS_NAME, "".join(f"{digest}  {member}\n" for member, digest in sums.items()).encode())
    return sums


class _TarWriter:
    def __init__(self, file: IO[bytes], mode: str) -> None:
        self._tar = tarfile.open(fileobj=file, mode=mode)  # type: ignore[call-overload]  # noqa: SIM115 - see close

    def add(self, name: str, content: bytes) -> None:
        member = tarfile.TarInfo(name)
        member.size = len(content)
        member.mtime = int(time.time())
        self._tar.addfile(member, io.BytesIO(content))

    def close(self) -> None:
        self._tar.close()


class _ZipWriter:
    def __init__(self, file: IO[bytes]) -> None:
        self._zip = zipfile.ZipFile(file, "w", zipfile.ZIP_STORED)

    def add(self, name: str, content: bytes) -> None:
        self._zip.writestr(name, content)

    def close(self) -> None:
        self._zip.close()


def _require_space(path: Path, bundles: Sequence[Bundle]) -> None:
    files = [
        bundle.directory / name
        for bundle in bundles
        for name in (FILE_NAME, *(f.file for f in bundle.frames))
    ]
    needed = sum(file.stat().st_size + 1024 for file in files) + MIN_FREE_BYTES
    free = shutil.disk_usage(existing_part(path.parent)).free
    if free < needed:
        raise ArchiveError(
            f"{path}: needs {needed / 1e6:.0f} MB, {free / 1e6:.0f} MB are free; make room, or choose another --out"
        )
