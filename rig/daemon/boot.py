"""Which run of the computer this is: monotonic times of another one mean nothing here."""

from functools import cache
from pathlib import Path


@cache
def boot_id() -> str:
    """The kernel's name for the time since it was started."""
    return Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
