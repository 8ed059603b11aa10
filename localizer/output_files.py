"""Output files of a command: checked for writability before the work starts."""

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from localizer.errors import SkyfixError
from localizer.os_errors import why_not_written

PICTURE_SUFFIXES = (".png", ".jpg", ".svg", ".pdf")


def prepare_folder(option: str, folder: Path) -> None:
    """Create the folder unless it is there, and make sure that files can be written: before the work, not after it.

    Raises ``SkyfixError``.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except FileExistsError:
        raise SkyfixError(f"{option}: {folder}: is a file; name a folder") from None
    except OSError as error:
        raise SkyfixError(f"{option}: {folder}: {why_not_written(error, 'name another folder')}") from None


def check_picture_path(option: str, path: Path) -> None:
    """Check that a picture can be written to ``path``, before the work starts. Raises ``SkyfixError``."""
    if path.suffix.lower() not in PICTURE_SUFFIXES:
        raise SkyfixError(f"{option}: {path}: no picture format; name it {', '.join(PICTURE_SUFFIXES)}")
    if not path.parent.is_dir():
        raise SkyfixError(f"{option}: {path}: no such folder: {path.parent}")
    if path.is_dir():
        raise SkyfixError(f"{option}: {path}: is a folder; name a file")
    prepare_folder(option, path.parent)


@contextmanager
def writing(option: str, path: Path) -> Iterator[None]:
    """Context for writing a file: turns an ``OSError``, as on a full disk, into a ``SkyfixError``."""
    try:
        yield
    except OSError as error:
        raise SkyfixError(f"{option}: {path}: cannot be written: {error.strerror}") from None
