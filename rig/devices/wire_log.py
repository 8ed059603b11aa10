"""Wire log: all raw bytes of a session as JSON lines, the first one a header; ``sim replay`` plays it back.

    {"skyfix_log": 1, "utc": "2026-11-24T15:00:00.000Z", "config": {...}}
    {"t": 0.012, "port": "/dev/serial/by-id/...", "sent": "fffffd00fe0300013142"}
    {"t": 0.013, "port": "/dev/serial/by-id/...", "received": "fffffd0001..."}
    {"t": 0.020, "bus": "/dev/i2c-1", "address": 29, "write": "06", "length": 11, "read": "0750..."}
    {"t": 0.021, "bus": "/dev/i2c-1", "address": 29, "write": "06", "length": 11, "errno": 121}

``t`` is seconds since the header. Pictures are not in it, nor are the camera's URLs.
"""

import json
import logging
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from localizer.os_errors import why_not_written
from rig import timebase
from rig.clock import utc_now
from rig.config.model import RigConfig
from rig.devices.bus import monitor
from rig.errors import RigError

LOG_VERSION = 1
URL_LEFT_OUT = "http://left-out.invalid/?ev={ev}"

_log = logging.getLogger(__name__)


class WireLogError(RigError):
    """The log cannot be written."""


@contextmanager
def recording_wire_log(path: Path, config: RigConfig) -> Iterator[None]:
    """Log the traffic of all ports and buses into ``path``, a new file, while the context lasts.

    The header holds the configuration with its calibrations, without the camera's URLs, which may contain a password.
    If the log cannot be written any more, as on a full disk, that is reported and the devices continue. Raises
    ``WireLogError`` if the file exists or cannot be created.
    """
    settings = config.model_dump(
        mode="json", exclude={"calibration": True, "camera": {"source"}}, exclude_none=True
    )
    if config.camera.exposure_url is not None:
        settings["camera"]["exposure_url"] = URL_LEFT_OUT  # its presence changes a capture
    utc = utc_now().isoformat(timespec="milliseconds").replace("+00:00", "Z")
    try:
        file = path.open("x", encoding="ascii", buffering=1)  # line-buffered, so that a crash loses nothing
    except OSError as error:
        raise WireLogError(f"{path}: {why_not_written(error, 'choose another name')}") from error
    begun_s, lock = timebase.monotonic_s(), threading.Lock()
    ended = False

    def write(exchange: dict[str, Any]) -> None:
        nonlocal ended
        with lock:
            at_s = round(timebase.monotonic_s() - begun_s, 6)
            if ended or file.closed:
                return
            try:
                file.write(json.dumps({"t": at_s, **exchange}) + "\n")
            except OSError as error:  # not an error of the device: its user must not see it
                ended = True
                _log.warning("%s: %s; the log ends after %.1f s", path, why_not_written(error), at_s)

    try:
        file.write(json.dumps({"skyfix_log": LOG_VERSION, "utc": utc, "config": settings}) + "\n")
    except OSError as error:
        raise WireLogError(f"{path}: {why_not_written(error, 'choose another name')}") from error
    monitor.subscribe(write)
    try:
        yield
    finally:
        monitor.unsubscribe(write)
        with lock, suppress(OSError):  # already reported when a line could not be written
            file.close()
