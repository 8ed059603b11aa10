"""Boot id, time asleep and process age: monotonic times are valid within one boot only."""

import os
import time
from functools import cache
from pathlib import Path


@cache
def boot_id() -> str:
    """The kernel's id of the present boot."""
    return Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()


def suspended_s() -> float:
    """Total time suspended since boot: the monotonic clock stands still meanwhile."""
    return time.clock_gettime(time.CLOCK_BOOTTIME) - time.monotonic()


def process_age_s() -> float:
    """Seconds since the kernel started this process, imports included; to 0.01 s."""
    behind_name = Path("/proc/self/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    ticks = int(behind_name[19])  # starttime is field 22 of proc(5), the state behind the name field 3
    return time.clock_gettime(time.CLOCK_BOOTTIME) - ticks / os.sysconf("SC_CLK_TCK")
