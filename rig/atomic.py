"""Atomic file writes: after a crash or a power cut a file is complete or absent."""

import secrets
from pathlib import Path

from localizer.durable import make_folder, sync, write_synced

__all__ = ["make_folder", "sync", "write_atomically", "write_synced"]


def write_atomically(path: Path, content: bytes) -> None:
    """Write to a temporary name in the same folder, fsync and rename. Makes missing folders. Raises ``OSError``."""
    make_folder(path.parent)
    partial = path.with_name(f".{path.name}.{secrets.token_hex(4)}.partial")
    try:
        write_synced(partial, content)
        partial.replace(path)
        sync(path.parent)
    finally:
        partial.unlink(missing_ok=True)
