"""Messages for errors of the operating system: its own words, and what to do."""

import difflib
import errno
import os
from pathlib import Path

_READING = {
    errno.ENOENT: "correct the name",
    errno.ENOTDIR: "correct the name: a part of the path is a file",
    errno.EISDIR: "name a file, not a folder",
    errno.EACCES: "change who may read it, or run as its owner",
    errno.EPERM: "change who may read it, or run as its owner",
    errno.ELOOP: "correct the link: it leads to itself",
    errno.ENAMETOOLONG: "correct the name",
    errno.EMFILE: "raise the limit of open files (ulimit -n)",
    errno.EIO: "look at the disk (dmesg)",
    errno.ESTALE: "mount the network drive again",
    errno.ENXIO: "name a file: it is a socket or a device",
}
_WRITING = {
    errno.ENOSPC: "{elsewhere}, or make room: the disk is full, or out of inodes (df -i)",
    errno.EDQUOT: "{elsewhere}, or make room: the user's disk quota is used up",
    errno.EFBIG: "{elsewhere}: the file system, or a limit (ulimit -f), takes no file so large",
    errno.EROFS: "{elsewhere}, or mount the file system writable",
    errno.ENOENT: "{elsewhere}, or make the folder first",
    errno.ENOTDIR: "{elsewhere}: a part of the path is a file",
    errno.EISDIR: "{elsewhere}: it is a folder",
    errno.EEXIST: "{elsewhere}, or remove what is there",
    errno.EACCES: "{elsewhere}, or change who may write there",
    errno.EPERM: "{elsewhere}, or change who may write there",
    errno.EMFILE: "raise the limit of open files (ulimit -n)",
    errno.EIO: "{elsewhere}, and look at the disk (dmesg)",
    errno.ESTALE: "{elsewhere}, or mount the network drive again",
}


def why_not_read(error: OSError, path: Path | None = None) -> str:
    """That a file cannot be read, why, and what to do; to follow the file's name and a colon.

    With ``path`` a name that is not there is told with the one that was most likely meant.
    """
    remedy = _READING.get(error.errno or 0, "look at the name and the disk")
    if error.errno == errno.ENOENT and path is not None:
        remedy += meant_instead(path)
    return f"cannot be read: {_reason(error)}; {remedy}"


def why_not_written(error: OSError, elsewhere: str = "write elsewhere") -> str:
    """That a file or folder cannot be written, why, and what to do; to follow its name and a colon.

    ``elsewhere`` says how another place is named.
    """
    remedy = _WRITING.get(error.errno or 0, "{elsewhere}").replace("{elsewhere}", elsewhere)
    return f"cannot be written: {_reason(error)}; {remedy}"


def meant_instead(path: Path) -> str:
    """A hint for a missing path, to follow a sentence: its first missing part, or a similar name that exists."""
    missing = path
    while not missing.parent.exists() and missing.parent != missing:
        missing = missing.parent
    try:
        names = [each.name for each in missing.parent.iterdir()]
    except OSError:
        return ""
    alike = difflib.get_close_matches(missing.name, names, n=1, cutoff=0.7)
    if alike:
        return f"; did you mean {missing.parent / alike[0]}?"
    return f"; there is no {missing}" if missing != path else ""


def _reason(error: OSError) -> str:
    return error.strerror or (os.strerror(error.errno) if error.errno else str(error))
