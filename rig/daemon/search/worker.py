"""The search process: requests on standard input, answers on standard output, one JSON object per line.

    -> {"dem": ["terrain.tif"], "dem_error_m": null}        once
    <- {"terrain": {"cells": 153036}} or {"error": "one line"}
    <- {"pictures": true}                                   kernels for pictures are on the disk
    <- {"ready": true}
    -> {"bundle": "spool/bundles/...", "tracker": {...}, "leg": {...}}
    <- {"track": {...}, "tracker": {...}, ...} or {"error": "one line"}

It ends with its input, that is, with its parent.
"""

import json
import math
import os
import queue
import signal
import sys
import threading
import time
from functools import partial
from pathlib import Path
from typing import Any, TextIO

from localizer.bundle import Bundle, BundleError, load_bundle
from localizer.dem.choice import DemChoice
from localizer.dem.horizon import Terrain, prepare_terrain
from localizer.dem.info import dem_notes
from localizer.dem.lattice import load_dem
from localizer.errors import SkyfixError
from localizer.jit import recompiled_if_damaged
from localizer.search.altitude_reference import altitude_note, reason_note
from localizer.search.locate import load_kernels, load_picture_kernels, observe
from localizer.skyline.upright import frame_skyline
from localizer.track.document import track_line
from localizer.track.tracker import Tracker, follow
from rig.atomic import write_atomically
from rig.daemon.memory import release_free_heap
from rig.daemon.search.skylines import FILE_NAME, BundleSkylines, bundle_skylines
from rig.daemon.spool.index import leg_of

NICENESS = 5
"""The rig's loops have priority: without timely servo traffic the bus watchdog stops the head."""


def main() -> None:
    """Serve until standard input ends."""
    # Signals are for the daemon, which controls this process.
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGUSR1):
        signal.signal(number, signal.SIG_IGN)
    os.nice(NICENESS)
    out = os.fdopen(os.dup(sys.stdout.fileno()), "w", buffering=1, encoding="utf-8")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # output of libraries must not mix with answers
    requests: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
    threading.Thread(target=_receive, args=(requests,), daemon=True).start()
    try:
        first = requests.get()
        if "said" in first:
            dem = DemChoice.from_fields(first["said"]).load()
        else:
            dem = load_dem([Path(file) for file in first["dem"]], error_m=first["dem_error_m"])
        for note in dem_notes(dem):
            print(f"dem: {note}", file=sys.stderr)
        terrain = recompiled_if_damaged(lambda: prepare_terrain(dem))
    except SkyfixError as error:
        _send(out, {"error": f"[run] dem: {error}"})
        return
    _send(out, {"terrain": {"cells": int(terrain.height_m.size)}})
    recompiled_if_damaged(load_picture_kernels)
    _send(out, {"pictures": True})
    recompiled_if_damaged(lambda: load_kernels(terrain))
    _send(out, {"ready": True})
    while True:
        request = requests.get()
        try:
            answer = _located(terrain, request)
        except SkyfixError as error:
            answer = {"error": str(error)}
        _send(out, answer)
        release_free_heap()


def _receive(requests: "queue.SimpleQueue[dict[str, Any]]") -> None:
    """A separate thread, so that the end of input also ends a running search."""
    for line in sys.stdin:
        requests.put(json.loads(line))
    os._exit(0)


def _send(out: TextIO, message: dict[str, Any]) -> None:
    out.write(json.dumps(message) + "\n")


def _located(terrain: Terrain, request: dict[str, Any]) -> dict[str, Any]:
    bundle = load_bundle(Path(request["bundle"]))
    if bundle.directory.is_symlink():  # results would be written to the link's target
        raise BundleError(f"{bundle.directory}: is a link; put the bundle itself into the spool")
    if bundle.id != bundle.directory.name:
        raise BundleError(
            f"{bundle.directory}: holds the bundle {bundle.id}; its folder must have the same name"
        )
    tracker = Tracker.model_validate(request["tracker"])
    begin = time.perf_counter()
    skylines = [frame_skyline(bundle, frame) for frame in bundle.frames]
    timing_s = {"horizon": time.perf_counter() - begin}
    step = follow(tracker, leg_of(request["leg"]), terrain, observe(bundle, skylines), bundle.id, timing_s)
    for note in (altitude_note(step.fix, bundle, terrain.dem), reason_note(step.fix)):
        if note:
            print(f"{bundle.id}: {note}", file=sys.stderr)
    _store(bundle.directory / FILE_NAME, bundle_skylines(bundle, skylines, step.fix, terrain))
    return {
        "track": track_line(step, terrain.dem).model_dump(mode="json", by_alias=True),
        "tracker": step.tracker.model_dump(mode="json", by_alias=True),
        "altitude_m": step.best.altitude_m if step.best else None,
        "azimuth_bias_sigma_deg": step.best.azimuth_bias_sigma_deg if step.best else None,
        "capture_info": capture_info_of(bundle),
        "wgs84_accuracy_m": terrain.dem.lonlat_accuracy_m,
    }


def _store(file: Path, skylines: BundleSkylines) -> None:
    """For the web page; a failure does not affect the fix."""
    try:
        write_atomically(file, skylines.model_dump_json().encode())
    except OSError as error:
        print(f"{file}: {error.strerror}; the page will not show the skylines", file=sys.stderr)


def capture_info_of(bundle: Bundle) -> dict[str, Any]:
    """Time and measured heading of the bundle, for the daemon.

    Null values if the bundle, perhaps of another program, lacks them.
    """
    last = max(bundle.frames, key=lambda frame: frame.time)
    times_s = _within(last.model_extra, "raw", "frame_monotonic_s")
    read = partial(_number, _within(bundle.model_extra, "calibration"))
    return {
        "utc": last.time.isoformat(),
        "monotonic_s": _number(times_s[-1]) if isinstance(times_s, list) and times_s else None,
        "heading_deg": read("heading", "heading_deg"),
        "mounting_sigmas_deg": [
            read("configuration", "camera", "boresight_azimuth_sigma_deg") or 0.0,
            read("configuration", "pan_tilt", "azimuth_sigma_deg") or 0.0,
        ],
    }


def _within(value: object, *keys: str) -> object:
    """The value at a path of keys; None if there is none."""
    for key in keys:
        value = value.get(key) if isinstance(value, dict) else None
    return value


def _number(value: object, *keys: str) -> float | None:
    number = _within(value, *keys)
    return float(number) if isinstance(number, int | float) and math.isfinite(number) else None


if __name__ == "__main__":
    main()
