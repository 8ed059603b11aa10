"""Bundle folders in the spool: capture time, size, removal."""

import shutil
from datetime import UTC, datetime
from pathlib import Path

from localizer.bundle import MOST_BYTES, BundleError, parse_bundle
from localizer.documents import DocumentError, read_file


def remove(path: Path) -> None:
    """Remove a folder with its content; of a link or another kind of entry only itself."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink()


def captured_at(file: Path) -> datetime:
    """Time of a bundle's last frame; of an unreadable one, its file time."""
    try:
        bundle = parse_bundle(read_file(file, MOST_BYTES), str(file))
        return max(frame.time for frame in bundle.frames)
    except (BundleError, DocumentError):
        return datetime.fromtimestamp(file.stat().st_mtime, UTC)


def size_bytes_of(folder: Path) -> int:
    """Total size of its files; 0 if it is gone."""
    try:
        return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    except FileNotFoundError:  # somebody deletes at this moment
        return 0
