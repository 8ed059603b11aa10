"""A log of all raw bytes of a session: JSON lines, the first one a header, played back by ``sim replay``.

    {"skyfix_log": 1, "utc": "2026-11-24T15:00:00.000Z", "config": {...}}
    {"t": 0.012, "port": "/dev/serial/by-id/...", "sent": "fffffd00fe0300013142"}
    {"t": 0.013, "port": "/dev/serial/by-id/...", "received": "fffffd0001..."}
    {"t": 0.020, "bus": "/dev/i2c-1", "address": 29, "write": "06", "length": 11, "read": "0750..."}
    {"t": 0.021, "bus": "/dev/i2c-1", "address": 29, "write": "06", "length": 11, "errno": 121}

``t`` is seconds since the header. Pictures are not in it.
"""

import json
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rig.bus import tap
from rig.clock import utc_now
from rig.config import RigConfig
from rig.errors import RigError

LOG_VERSION = 1


class RecordError(RigError):
    """The log cannot be written."""


@contextmanager
def recording(path: Path, config: RigConfig) -> Iterator[None]:
    """Record what passes on all ports and buses into ``path``, a new file, while the context lasts.

    The header holds the configuration with its calibrations, without the camera's source, which may have a password.
    Raises ``RecordError`` where the file is there already or cannot be made.
    """
    try:
        file = path.open(
            "x", encoding="ascii", buffering=1
        )  # a line at a time: a crash shall not take the end with it
    except OSError as error:
        raise RecordError(f"{path}: cannot be written: {error.strerror}; choose another name") from error
    begun_s, lock = time.monotonic(), threading.Lock()
    settings = config.model_dump(
        mode="json", exclude={"calibration": True, "camera": {"source"}}, exclude_none=True
    )
    utc = utc_now().isoformat(timespec="milliseconds").replace("+00:00", "Z")

    def write(exchange: dict[str, Any]) -> None:
        with lock:
            if not file.closed:
                file.write(json.dumps({"t": round(time.monotonic() - begun_s, 6), **exchange}) + "\n")

    with file:
        file.write(json.dumps({"skyfix_log": LOG_VERSION, "utc": utc, "config": settings}) + "\n")
        tap.listen(write)
        try:
            yield
        finally:
            tap.ignore(write)
