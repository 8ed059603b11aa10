"""Which run of the computer this is: monotonic times of another one mean nothing here; and how old this process is."""

import os
import time
from functools import cache
from pathlib import Path


@cache
def boot_id() -> str:
    """The kernel's name for the time since it was started."""
    return Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()


def asleep_s() -> float:
    """How long this run of the computer has been suspended in all: the monotonic clock stands still meanwhile."""
    return time.clock_gettime(time.CLOCK_BOOTTIME) - time.monotonic()


def process_age_s() -> float:
    """Since the kernel started this process: loading of the interpreter and of its modules included. To 0.01 s."""
    behind_name = Path("/proc/self/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    ticks = int(behind_name[19])  # starttime is field 22 of proc(5), the state behind the name field 3
    return time.clock_gettime(time.CLOCK_BOOTTIME) - ticks / os.sysconf("SC_CLK_TCK")
