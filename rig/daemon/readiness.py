"""Why no capture is possible at this moment, for whoever asks for one and for whoever wants to know why there was none."""

from rig.daemon.state import DaemonState, Snapshot

NEEDED = ("head", "inclinometer", "camera")
"""Without these there is no capture. Without a compass the search turns the whole circle, without an altimeter it looks at
every altitude."""


def why_not_ready(daemon_state: DaemonState) -> str | None:
    """In a few words, None where a capture is possible: the daemon starts, devices do not work, the spool takes none."""
    now = daemon_state.snapshot()
    if now.activity in ("starting", "connecting"):
        return "still starting"
    missing = _missing(now)
    return f"{', '.join(missing)} not ready" if missing else now.storage


def why_not_ready_in_full(daemon_state: DaemonState) -> str:
    """The same in full, each device with its fault."""
    now = daemon_state.snapshot()
    faults = {device.name: device.detail or device.state for device in now.devices}
    if now.activity in ("starting", "connecting"):
        return "still starting: devices are being connected and the DEM read; ask again in a moment"
    return "; ".join(f"{name}: {faults[name]}" for name in _missing(now)) or now.storage or "ask again"


def _missing(now: Snapshot) -> list[str]:
    return [device.name for device in now.devices if device.name in NEEDED and device.state != "ok"]
