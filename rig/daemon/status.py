"""The board as JSON values and as lines for people."""

from typing import Any

from rig.daemon.board import Answer, Snapshot
from rig.measure import utc_text
from rig.readings import Instant


def status_json(snapshot: Snapshot) -> dict[str, Any]:
    """``skyfix.status/1``: everything that the board has, ages in seconds by the monotonic clock."""
    now = Instant.now()
    return {
        "schema": "skyfix.status/1",
        "time": utc_text(now.utc),
        "started": utc_text(snapshot.started.utc),
        "activity": snapshot.activity,
        "degraded": snapshot.degraded,
        "locating": snapshot.locating,
        "waiting": snapshot.waiting,
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
    """An answer, and how old its position is."""
    if answer is None:
        return None
    return {
        "bundle": answer.bundle,
        "captured": utc_text(answer.captured.utc),
        "age_s": round(now.monotonic_s - answer.captured.monotonic_s, 1),
        "trigger": answer.trigger,
        "mode": answer.mode,
        "altitude_m": answer.altitude_m,
        "vehicle_heading_deg": answer.vehicle_heading_deg,
        "vehicle_heading_sigma_deg": answer.vehicle_heading_sigma_deg,
        "elsewhere": answer.elsewhere,
        "fix": answer.fix.model_dump(mode="json", by_alias=True),
    }


def status_text(status: dict[str, Any]) -> str:
    """What ``rig status`` prints of the same."""
    lines = [f"{status['activity']}{', degraded' if status['degraded'] else ''}; {status['waiting']} waiting"]
    for device in status["devices"]:
        lines.append(f"{device['name']:13} {device['state']:10} {device['detail']}")
    last = status["last"]
    if last is None:
        lines.append("no answer yet")
    else:
        fix = last["fix"]
        place = fix["position"]
        where = f"  {place['lat_deg']:.6f}, {place['lon_deg']:.6f}" if place else ""
        lines.append(f"{last['bundle']}: {fix['status']}{where}, {last['age_s']:.0f} s old")
    lines += [f"{name:30} {count}" for name, count in status["counts"].items()]
    return "\n".join(lines)
