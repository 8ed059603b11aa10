"""Bundles in one archive file, to carry home and to hand on: written beside its name, read back, and renamed.

A .tar (pictures are compressed already), .tar.gz or .zip with a folder for each bundle, named by its id, ``index.csv`` with a
row for each frame, and ``SHA256SUMS`` of every file, so that ``sha256sum -c SHA256SUMS`` checks it without this program.
"""

import csv
import hashlib
import io
import os
import secrets
import shutil
import tarfile
import tempfile
import time
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import closing
from pathlib import Path, PurePosixPath
from typing import IO, Protocol

from localizer.bundle import FILE_NAME, Bundle, load_bundle
from rig.atomic import sync
from rig.bundle.facts import TABLE_COLUMNS, table_rows
from rig.bundle.writer import LEAST_FREE_BYTES, existing_part
from rig.errors import RigError

INDEX_NAME = "index.csv"
SUMS_NAME = "SHA256SUMS"
SUFFIXES = (".tar", ".tar.gz", ".tgz", ".zip")


class ArchiveError(RigError):
    """An archive cannot be written, or is damaged."""


class _Writer(Protocol):
    def add(self, name: str, content: bytes) -> None: ...

    def close(self) -> None: ...


def is_archive(path: Path) -> bool:
    """Whether a path is to be taken for an archive: a file, named as one."""
    return path.name.lower().endswith(SUFFIXES) and not path.is_dir()


def write_archive(path: Path, bundles: Sequence[Bundle]) -> None:
    """Write whole bundles into a new archive and check what has been written, to the last byte.

    ``ArchiveError`` where the name says no format or is taken, two bundles have one id, the disk refuses, or what can be read
    back is not what went in; nothing is left behind then.
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
        path.parent.mkdir(parents=True, exist_ok=True)
        with partial.open("xb") as file:
            sums = _write(file, path.name.lower(), bundles)
            file.flush()
            os.fsync(file.fileno())
            os.posix_fadvise(
                file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED
            )  # read the disk, not the memory, below
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


def bundles_of_archive(path: Path, expected: dict[str, str] | None = None) -> Iterator[Bundle]:
    """The bundles of an archive, each unpacked into a folder that lasts until the next, and checked.

    Every file is held against ``expected`` (checksums by name), by default against those in the archive.

    ``ArchiveError`` where it is no archive, is cut off, or a checksum is wrong; ``BundleError`` for a bundle that is not valid.
    """
    sums: dict[str, str] | None = None
    seen: dict[str, str] = {}
    with tempfile.TemporaryDirectory(prefix="skyfix-archive-") as folder:
        current: str | None = None
        for name, content in _members(path):
            seen[name] = hashlib.sha256(content).hexdigest()
            top = PurePosixPath(name).parts[0]
            if current is not None and top != current:
                yield load_bundle(Path(folder, current))
                shutil.rmtree(Path(folder, current))
                current = None
            if name == SUMS_NAME:
                sums = _parsed_sums(path, content)
            elif name != top:
                current = top
                file = Path(folder, name)
                file.parent.mkdir(parents=True, exist_ok=True)
                file.write_bytes(content)
        if current is not None:
            yield load_bundle(Path(folder, current))
    if sums is None:
        raise ArchiveError(f"{path}: has no {SUMS_NAME}: it is cut off, or no archive of rig bundle export")
    del seen[SUMS_NAME]
    sums = sums if expected is None else expected
    wrong = sorted(name for name in {*sums, *seen} if sums.get(name) != seen.get(name))
    if wrong:
        raise ArchiveError(f"{path}: {wrong[0]} is missing, was added or has changed ({len(wrong)} files)")


def unpack_archive(path: Path, out_dir: Path) -> Iterator[tuple[Path, bool]]:
    """Put an archive's bundles into a folder: where each is, and whether it came now or was there already, the same.

    Each is complete or absent, as a captured one. ``ArchiveError`` where another bundle has its name.
    """
    for bundle in bundles_of_archive(path):
        place = out_dir / bundle.id
        if place.exists():
            if load_bundle(place).to_json() != bundle.to_json():
                raise ArchiveError(f"{place}: is another bundle than the archive's; choose another --out")
            yield place, False
            continue
        partial = out_dir / f".{bundle.id}.partial"
        try:
            shutil.rmtree(partial, ignore_errors=True)
            shutil.copytree(bundle.directory, partial)
            for each in (*partial.rglob("*"), partial):
                sync(each)
            load_bundle(partial)
            partial.rename(place)
            sync(out_dir)
        except OSError as error:
            raise ArchiveError(f"{place}: cannot be written: {error.strerror or error}") from error
        finally:
            shutil.rmtree(partial, ignore_errors=True)
        yield place, True


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
            for member in (FILE_NAME, *(frame.file for frame in bundle.frames)):
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


def _members(path: Path) -> Iterator[tuple[str, bytes]]:
    """Names and contents of an archive's files, in order."""
    if path.exists() and not path.is_file():  # a pipe would be waited for
        raise ArchiveError(f"{path}: is not a file but a directory or a pipe")
    try:
        if zipfile.is_zipfile(path):
            with zipfile.ZipFile(path) as archive:
                for info in archive.infolist():
                    if not info.is_dir():
                        yield _inside(path, info.filename), archive.read(info)
            return
        with tarfile.open(path, "r:*") as tar:
            for member in tar:
                if member.isdir():
                    continue
                content = tar.extractfile(member) if member.isfile() else None
                if content is None:
                    raise ArchiveError(f"{path}: {member.name} is no plain file")
                yield _inside(path, member.name), content.read()
    except OSError as error:
        raise ArchiveError(f"{path}: cannot be read: {error.strerror or error}") from error
    except (tarfile.TarError, zipfile.BadZipFile, EOFError) as error:
        raise ArchiveError(f"{path}: is damaged or no archive: {error}") from error


def _inside(path: Path, name: str) -> str:
    parts = PurePosixPath(name).parts
    if not parts or name.startswith("/") or ".." in parts or "\\" in name or "\0" in name:
        raise ArchiveError(f"{path}: its file {name!r} leads outside")
    return str(PurePosixPath(name))


def _parsed_sums(path: Path, content: bytes) -> dict[str, str]:
    try:
        pairs = [line.split("  ", 1) for line in content.decode().splitlines()]
        return {name: digest for digest, name in pairs}
    except ValueError as error:
        raise ArchiveError(f"{path}: {SUMS_NAME} is damaged") from error


def _require_space(path: Path, bundles: Sequence[Bundle]) -> None:
    files = [
        bundle.directory / name
        for bundle in bundles
        for name in (FILE_NAME, *(f.file for f in bundle.frames))
    ]
    needed = sum(file.stat().st_size + 1024 for file in files) + LEAST_FREE_BYTES
    free = shutil.disk_usage(existing_part(path.parent)).free
    if free < needed:
        raise ArchiveError(
            f"{path}: needs {needed / 1e6:.0f} MB, {free / 1e6:.0f} MB are free; make room, or choose another --out"
        )
