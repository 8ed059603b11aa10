"""Files and folders brought to the disk: only then they survive a power cut. All functions raise ``OSError``."""

import os
from pathlib import Path


def sync(path: Path) -> None:
    """fsync a file, or a folder after a name in it was made, changed or removed."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def write_synced(path: Path, content: bytes) -> None:
    """Write a new file and fsync it. Its name is on the disk only after ``sync`` of its folder."""
    with path.open("xb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())


def make_folder(folder: Path) -> None:
    """Make a folder and its missing parents, and bring their names to the disk.

    fsync of a new folder alone does not keep the folder's own name: that is part of its parent.
    """
    missing = []
    path = folder
    while not path.exists() and path != path.parent:
        missing.append(path)
        path = path.parent
    folder.mkdir(parents=True, exist_ok=True)
    for made in missing:
        sync(made.parent)
