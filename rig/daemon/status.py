"""The daemon state as JSON values and as text."""

import math
from typing import Any

import numpy as np

from rig.capture.averaged_readings import utc_text
from rig.clock import Instant
from rig.daemon.state import Answer, Snapshot
from rig.version import __version__

BEGINNING = "starting", "connecting"
"""Activities during which a device that does not work has not failed yet."""


def status_json(snapshot: Snapshot) -> dict[str, Any]:
    """``skyfix.status/1``: the whole daemon state, ages in seconds by the monotonic clock."""
    now = Instant.now()
    return {
        "schema": "skyfix.status/1",
        "time": utc_text(now.utc),
        "version": __version__,
        "started": utc_text(snapshot.started.utc),
        "activity": snapshot.activity,
        "degraded": snapshot.degraded,
        "locating": snapshot.locating,
        "waiting": snapshot.waiting,
        "storage": snapshot.storage,
        "devices": [
            {
                "name": device.name,
                "state": device.state,
                "detail": device.detail,
                "since": utc_text(device.since.utc),
            }
            for device in snapshot.devices
        ],
        "last": answer_json(snapshot.last, now),
        "last_fix": answer_json(snapshot.last_fix, now),
        "counts": dict(sorted(snapshot.counts.items())),
    }


def answer_json(answer: Answer | None, now: Instant) -> dict[str, Any] | None:
    """An answer with the age of its position."""
    if answer is None:
        return None
    return {
        "bundle": answer.bundle,
        "captured": utc_text(answer.captured.utc),
        "age_s": round(now.monotonic_s - answer.captured.monotonic_s, 1),
        "before_start": answer.before_start,
        "trigger": answer.trigger,
        "mode": answer.mode,
        "altitude_m": answer.altitude_m,
        "vehicle_heading_deg": answer.vehicle_heading_deg,
        "vehicle_heading_sigma_deg": answer.vehicle_heading_sigma_deg,
        "wgs84_accuracy_m": answer.wgs84_accuracy_m,
        "elsewhere": answer.elsewhere,
        "fix": answer.fix.model_dump(mode="json", by_alias=True),
    }


def status_text(status: dict[str, Any]) -> str:
    """The text of ``rig status``."""
    doing = [status["activity"]]
    if status["degraded"] and status["activity"] not in BEGINNING:
        doing.append("degraded")
    if status["locating"]:
        doing.append(f"locating {status['locating']}")
    doing.append(f"{status['waiting'] or 'nothing'} to locate")
    lines = [", ".join(doing)]
    for device in status["devices"]:
        lines.append(f"{device['name']:13} {device['state']:10} {device['detail']}".rstrip())
    if status.get("storage"):
        lines.append(f"spool         takes no bundle: {status['storage']}")
    last, last_fix = status["last"], status["last_fix"]
    lines.append(f"last answer   {_answer_text(last) if last else 'none since the start'}")
    if last_fix and last_fix["bundle"] != last["bundle"]:
        lines.append(f"last fix      {_answer_text(last_fix)}")
    lines.append(f"since the start at {status['started']}")
    lines += [f"  {name:28} {count}" for name, count in status["counts"].items()]
    return "\n".join(lines)


def _answer_text(answer: dict[str, Any]) -> str:
    """``fix 37.307012, -122.215437, sigma 0.9 m, 17 s old; 20261126T124006Z-e891``: the ellipse's longer semi-axis."""
    fix = answer["fix"]
    parts = [fix["status"]]
    if fix["status"] == "ambiguous":
        parts.append(f"{len(fix['candidates'])} places")
    elif fix["position"]:
        parts[0] += f" {fix['position']['lat_deg']:.6f}, {fix['position']['lon_deg']:.6f}"
        parts.append(f"sigma {math.sqrt(np.linalg.eigvalsh(fix['covariance_m2'])[-1]):.1f} m")
    parts.append(f"{answer['age_s']:.0f} s old{' (before the restart)' if answer['before_start'] else ''}")
    return f"{', '.join(parts)}; {answer['bundle']}"
