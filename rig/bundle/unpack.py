"""Reads archives of bundles: streamed, within limits, and checked to the last byte before anything is moved into place.

An archive is untrusted input. It must not decide where files go, nor how much memory, disk and time they take: names
are checked before use, only files that a bundle lists are kept, and links are not followed.
"""

import fcntl
import gzip
import hashlib
import os
import shutil
import stat
import struct
import tarfile
import tempfile
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path, PurePosixPath
from typing import IO, Any, cast

from localizer.bundle import FILE_NAME, MOST_FRAMES, Bundle, BundleError, load_bundle
from rig.atomic import make_folder, sync
from rig.bundle.limits import ArchiveError, Slices, Tally, checked_name, is_plain
from rig.bundle.writer import MIN_FREE_BYTES

SUMS_NAME = "SHA256SUMS"
MAX_SUMS_BYTES = 8_000_000
CHUNK_BYTES = 1 << 18
MAX_IN_FOLDER = 2 * MOST_FRAMES
STAGING = ".import-"

_DAMAGED = (
    tarfile.TarError,
    zipfile.BadZipFile,
    zlib.error,
    gzip.BadGzipFile,
    EOFError,
    struct.error,
    ValueError,  # an undecodable name or an invalid number
    OverflowError,
    NotImplementedError,
    RecursionError,  # of headers that announce headers
)
"""Exceptions of the libraries on malformed content."""


def bundles_of_archive(
    path: Path,
    expected: dict[str, str] | None = None,
    *,
    folder: Path | None = None,
    on_unlisted: Callable[[str], None] = lambda name: None,
) -> Iterator[Bundle]:
    """The bundles of an archive, each unpacked and checked: into ``folder``, by default a temporary one that is removed
    before the next.

    Every file is compared with ``expected`` (checksums by name), by default with those in the archive. That comparison
    completes after the last bundle: only then all are known to be intact. ``on_unlisted`` is called with files that no
    bundle lists; they are not kept.

    ``ArchiveError`` if it is no archive, truncated, beyond a limit, or a checksum is wrong; ``BundleError`` for an
    invalid bundle.
    """
    with ExitStack() as stack:
        stays = folder is not None
        if folder is None:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="skyfix-archive-")))
        try:
            yield from _bundles(path, expected, folder, stays, on_unlisted)
        except ArchiveError as error:
            raise ArchiveError(f"{path}: {error}") from error
        except BundleError as error:
            # The folder no longer exists when the message is read.
            raise BundleError(f"{path}: {str(error).removeprefix(f'{folder}/')}") from error


def _bundles(
    path: Path, expected: dict[str, str] | None, folder: Path, stays: bool, on_unlisted: Callable[[str], None]
) -> Iterator[Bundle]:
    sums: dict[str, str] | None = None
    seen: dict[str, str] = {}
    tops: set[str] = set()
    current: str | None = None
    in_folder = 0
    for name, stream, size in _members(path):
        top = PurePosixPath(name).parts[0]
        if current is not None and top != current:
            yield _whole(folder / current, on_unlisted)
            if not stays:
                shutil.rmtree(folder / current)
            current = None
        if name == SUMS_NAME:
            content = _copied(stream, None, min(size, MAX_SUMS_BYTES + 1))[1]
            sums = _parsed_sums(content)
        elif name == top:
            seen[name] = _copied(stream, None, 0)[0]
        else:
            if current is None and top in tops:
                raise ArchiveError(f"its files of {top} do not stand together")
            if top != current:
                current, in_folder = top, 0
                tops.add(top)
            in_folder += 1
            if in_folder > MAX_IN_FOLDER:
                raise ArchiveError(f"its folder {top} holds more files than any bundle")
            seen[name] = _written(folder, name, stream, size)
    if current is not None:
        yield _whole(folder / current, on_unlisted)
    if sums is None:
        raise ArchiveError(f"has no {SUMS_NAME}: it is cut off, or no archive of rig bundle export")
    sums = sums if expected is None else expected
    wrong = sorted(name for name in {*sums, *seen} if sums.get(name) != seen.get(name))
    if wrong:
        raise ArchiveError(f"{wrong[0]} is missing, was added or has changed ({len(wrong)} files)")


def _whole(folder: Path, on_unlisted: Callable[[str], None]) -> Bundle:
    """The bundle in a folder of ours, after removing files that it does not list."""
    bundle = load_bundle(folder)
    if bundle.id != folder.name:
        raise ArchiveError(f"its folder {folder.name} holds the bundle {bundle.id}; both must have one name")
    listed = {folder / name for name in (FILE_NAME, *(frame.file for frame in bundle.frames))}
    for path in sorted(folder.rglob("*"), reverse=True):  # content before its folder
        if path.is_dir():
            if not any(path.iterdir()):
                path.rmdir()
        elif path not in listed:
            on_unlisted(f"{folder.name}/{path.relative_to(folder)}")
            path.unlink()
    return bundle


def unpack_archive(
    path: Path, out_dir: Path, on_unlisted: Callable[[str], None] = lambda name: None
) -> list[tuple[Path, bool]]:
    """Import an archive's bundles into a folder; for each its directory, and whether it is new or was already there,
    identical.

    All or none: everything is unpacked to a staging folder, checked and fsynced before the first rename.
    ``ArchiveError`` if a different bundle, or a link, has one of the names.
    """
    try:
        with _made(out_dir), _staging(out_dir) as staging:
            bundles = list(bundles_of_archive(path, folder=staging, on_unlisted=on_unlisted))
            found = [(out_dir / bundle.id, _is_free(out_dir / bundle.id, bundle)) for bundle in bundles]
            new = [place for place, is_new in found if is_new]
            for place in new:
                for each in ((staging / place.name).rglob("*"), [staging / place.name]):
                    for file in each:
                        sync(file)
            _put(staging, new)
            sync(out_dir)
            return found
    except OSError as error:
        raise ArchiveError(f"{out_dir}: cannot be written: {error.strerror or error}") from error


def _is_free(place: Path, bundle: Bundle) -> bool:
    """Whether the destination is free; False if the identical bundle is already there."""
    if place.is_symlink():
        raise ArchiveError(
            f"{place}: is a link, which is not followed; take it away, or choose another --out"
        )
    if not place.exists():
        return True
    if load_bundle(place).to_json() != bundle.to_json():
        raise ArchiveError(f"{place}: is another bundle than the archive's; choose another --out")
    return False


def _put(staging: Path, places: list[Path]) -> None:
    """Rename all into place; if that is interrupted, rename all back."""
    done: list[Path] = []
    try:
        for place in places:
            done.append(place)
            (staging / place.name).rename(place)
    except BaseException:
        for place in done:
            if not (staging / place.name).exists():
                place.rename(staging / place.name)
        raise


@contextmanager
def _made(folder: Path) -> Iterator[None]:
    """The folder, made if missing; if the context fails, what was made is removed."""
    new: list[Path] = []
    path = folder
    while not path.exists():
        new.append(path)
        path = path.parent
    try:
        make_folder(folder)
        yield
    except BaseException:
        for each in new:
            if each.is_dir() and not any(each.iterdir()):
                each.rmdir()
        raise


@contextmanager
def _staging(out_dir: Path) -> Iterator[Path]:
    """A new staging folder beside the bundles, locked while in use. Unlocked ones, left by a crash, are removed."""
    for left in out_dir.glob(f"{STAGING}*"):
        if left.is_dir() and not left.is_symlink():
            with _locked(left) as is_ours:
                if is_ours:
                    shutil.rmtree(left, ignore_errors=True)
    staging = Path(tempfile.mkdtemp(prefix=STAGING, dir=out_dir))
    try:
        with _locked(staging):
            yield staging
    finally:
        shutil.rmtree(staging, ignore_errors=True)


@contextmanager
def _locked(folder: Path) -> Iterator[bool]:
    """Lock a folder; False if another process holds the lock, or the file system has no locks (NFS, FUSE)."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            is_ours = True
        except OSError:
            is_ours = False
        yield is_ours
    finally:
        os.close(descriptor)


def _written(folder: Path, name: str, stream: IO[bytes], size: int) -> str:
    """Write a member and return its checksum."""
    if shutil.disk_usage(folder).free < size + MIN_FREE_BYTES:
        raise ArchiveError(f"there is no room in {folder.parent} to unpack it; make some")
    file = folder / name
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with file.open("xb") as out:
            return _copied(stream, out, 0)[0]
    except OSError as error:
        raise ArchiveError(f"{name} cannot be unpacked: {error.strerror or error}") from error


def _copied(stream: IO[bytes], out: IO[bytes] | None, kept_bytes: int) -> tuple[str, bytes]:
    """Read a member to its end, into ``out`` if given; its checksum and its first ``kept_bytes``."""
    digest, kept = hashlib.sha256(), b""
    while chunk := _chunk(stream):
        digest.update(chunk)
        if out is not None:
            out.write(chunk)
        if len(kept) < kept_bytes:
            kept += chunk[: kept_bytes - len(kept)]
    return digest.hexdigest(), kept


def _chunk(stream: IO[bytes]) -> bytes:
    with _damage_named():
        return stream.read(CHUNK_BYTES)


@contextmanager
def _damage_named() -> Iterator[None]:
    """Convert the libraries' exceptions to ``ArchiveError`` while an archive is read."""
    try:
        yield
    except _DAMAGED as error:
        raise ArchiveError(f"is damaged or no archive: {error}") from error
    except OSError as error:
        raise ArchiveError(f"cannot be read: {error.strerror or error}") from error


def _parsed_sums(content: bytes) -> dict[str, str]:
    if len(content) > MAX_SUMS_BYTES:
        raise ArchiveError(f"its {SUMS_NAME} is larger than {MAX_SUMS_BYTES / 1e6:g} MB")
    try:
        pairs = [line.split("  ", 1) for line in content.decode().splitlines()]
        return {name: digest for digest, name in pairs}
    except ValueError as error:
        raise ArchiveError(f"its {SUMS_NAME} is damaged") from error


def _members(path: Path) -> Iterator[tuple[str, IO[bytes], int]]:
    """Names, contents and sizes of an archive's files, in order; each content must be read before the next is
    requested.
    """
    with (
        _damage_named(),
        os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb") as file,
    ):
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            raise ArchiveError("is not a file but a directory or a pipe")
        tally = Tally(os.fstat(file.fileno()).st_size)
        head = file.read(4)
        file.seek(0)
        if head[:2] == b"PK":
            yield from _zip_members(file, tally)
        elif head[:2] == b"\x1f\x8b":
            with gzip.GzipFile(fileobj=file) as unpacked:
                yield from _tar_members(cast(IO[bytes], unpacked), tally)
        else:
            yield from _tar_members(file, tally)


def _tar_members(file: IO[bytes], tally: Tally) -> Iterator[tuple[str, IO[bytes], int]]:
    slices: Any = Slices(file, 2 * tally.most_bytes)  # headers and padding come on top of the contents
    with slices.header():
        tar = tarfile.open(fileobj=slices, mode="r:")  # noqa: SIM115 - see below; it reads the first header
    with tar:
        while True:
            with slices.header():
                member = tar.next()
            if member is None:
                break
            tar.members = []  # type: ignore[attr-defined]  # it keeps them all
            if member.isdir():
                tally.folder()
                continue
            name = checked_name(member.name)
            content = tar.extractfile(member) if member.isfile() and not member.issparse() else None
            if content is None:
                raise ArchiveError(f"{name} is no plain file")
            tally.file(name, member.size)
            yield name, content, member.size


def _zip_members(file: IO[bytes], tally: Tally) -> Iterator[tuple[str, IO[bytes], int]]:
    slices: Any = Slices(file, os.fstat(file.fileno()).st_size)
    with zipfile.ZipFile(slices) as archive:
        for info in archive.infolist():
            if info.is_dir():
                tally.folder()
                continue
            name = checked_name(info.filename)
            if not is_plain(info.external_attr >> 16):
                raise ArchiveError(f"{name} is no plain file")
            if info.flag_bits & 1:
                raise ArchiveError(f"{name} is encrypted")
            if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                raise ArchiveError(f"{name} is packed in a way that is not read here")
            tally.file(name, info.file_size)
            with archive.open(info) as content:
                yield name, content, info.file_size
