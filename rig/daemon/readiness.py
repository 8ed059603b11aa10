"""Readiness for a capture, and the reason if there is none."""

from rig.daemon.state import DaemonState, Snapshot

NEEDED = ("head", "inclinometer", "camera")
"""Devices required for a capture. Without a compass the search covers all headings, without an altimeter all altitudes."""


def why_not_ready(daemon_state: DaemonState) -> str | None:
    """Short reason; None if a capture is possible: the daemon starts, devices fail, or the spool is full."""
    now = daemon_state.snapshot()
    if now.activity in ("starting", "connecting"):
        return "still starting"
    missing = _missing(now)
    return f"{', '.join(missing)} not ready" if missing else now.storage


def why_not_ready_in_full(daemon_state: DaemonState) -> str:
    """The full reason, with the fault of each device."""
    now = daemon_state.snapshot()
    faults = {device.name: device.detail or device.state for device in now.devices}
    if now.activity in ("starting", "connecting"):
        return "still starting: devices are being connected and the DEM read; ask again in a moment"
    return "; ".join(f"{name}: {faults[name]}" for name in _missing(now)) or now.storage or "ask again"


def _missing(now: Snapshot) -> list[str]:
    return [device.name for device in now.devices if device.name in NEEDED and device.state != "ok"]
