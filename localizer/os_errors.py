"""What the operating system refuses, in words, with what to do about it."""

import errno
import os

_READING = {
    errno.ENOENT: "there is no such file; correct the name",
    errno.ENOTDIR: "a part of the path is a file, not a folder; correct the name",
    errno.EISDIR: "it is a folder; name a file in it",
    errno.EACCES: "permission denied; change who may read it, or run as its owner",
    errno.EPERM: "not permitted; change who may read it, or run as its owner",
    errno.ELOOP: "it is a link that leads to itself; correct the link",
    errno.ENAMETOOLONG: "the name is too long; correct it",
    errno.EMFILE: "too many files are open; raise the limit (ulimit -n)",
    errno.EIO: "the disk does not give it; look at the disk (dmesg)",
    errno.ESTALE: "the network drive has gone away; mount it again",
    errno.ENXIO: "it is a socket or a device without a reader; name a file",
}
_WRITING = {
    errno.ENOSPC: "the disk is full; make room, or write elsewhere",
    errno.EDQUOT: "the user's disk quota is used up; make room, or write elsewhere",
    errno.EFBIG: "the file would be larger than the file system or the limit (ulimit -f) allows; write elsewhere",
    errno.EROFS: "the file system is mounted read-only; mount it writable, or write elsewhere",
    errno.ENOENT: "there is no such folder; make it, or name another",
    errno.ENOTDIR: "a part of the path is a file, not a folder; name another",
    errno.EISDIR: "it is a folder; name a file",
    errno.EEXIST: "it is there already; choose another name, or remove it",
    errno.EACCES: "permission denied; change who may write there, or write elsewhere",
    errno.EPERM: "not permitted; change who may write there, or write elsewhere",
    errno.ELOOP: "it is a link that leads to itself; correct the link",
    errno.ENAMETOOLONG: "the name is too long; choose a shorter one",
    errno.EMFILE: "too many files are open; raise the limit (ulimit -n)",
    errno.EIO: "the disk does not take it; look at the disk (dmesg)",
    errno.ESTALE: "the network drive has gone away; mount it again, or write elsewhere",
    errno.EBUSY: "it is in use; wait, or name another",
}


def why_not_read(error: OSError) -> str:
    """That a file cannot be read, why, and what to do; to follow the file's name and a colon."""
    why = _READING.get(error.errno or 0) or f"{_reason(error)}; look at the name and the disk"
    return f"cannot be read: {why}"


def why_not_written(error: OSError) -> str:
    """That a file or folder cannot be written, why, and what to do; to follow its name and a colon."""
    why = _WRITING.get(error.errno or 0) or f"{_reason(error)}; look at the disk, or write elsewhere"
    return f"cannot be written: {why}"


def _reason(error: OSError) -> str:
    return error.strerror or (os.strerror(error.errno) if error.errno else str(error))
