"""Output of ``rig watch``: as a table, as one line, and as JSON values."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from rich.console import Group
from rich.table import Table
from rich.text import Text

from rig.capture.averaged_readings import utc_text
from rig.clock import utc_now
from rig.fault_notes import FaultNote
from rig.watch.attitudes import Attitudes, fresh_values
from rig.watch.watcher import DeviceStatus

STYLES = {"connecting": "yellow", "ok": "green", "warning": "yellow", "silent": "red", "failing": "bold red"}
NOTES_SHOWN = 3


def as_json(
    rig: str, statuses: Sequence[DeviceStatus], found: Attitudes, notes: Sequence[FaultNote]
) -> dict[str, Any]:
    """A snapshot; ``overcome`` counts recovered faults since the start."""
    return {
        "time": utc_text(utc_now()),
        "rig": rig,
        "ok": all(status.state == "ok" for status in statuses),
        "devices": {status.name: _device(status) for status in statuses},
        "attitude": asdict(found),
        "overcome": [
            {"device": n.device, "problem": n.problem, "action": n.action, "count": n.count} for n in notes
        ],
    }


def line(statuses: Sequence[DeviceStatus], found: Attitudes) -> str:
    """A snapshot as one line."""
    parts = [
        _angles("pan", found.pan_deg, "tilt", found.tilt_deg, digits=1),
        _angles("head tilt", found.head_tilt_deg, "roll", found.head_roll_deg, digits=2),
        _angles("heading", found.vehicle_heading_deg, digits=1),
        f"altitude {_number(found.altitude_m, 1)} m",
    ]
    values = fresh_values(statuses)
    if "head" in values:
        parts.append(_health("head", values["head"]))
    if "camera" in values:
        parts.append(f"camera {_health('camera', values['camera'])}")
    parts += [f"{s.name.upper()} {s.state.upper()}: {s.problem}" for s in statuses if s.problem]
    parts += [f"{s.name} connecting" for s in statuses if s.state == "connecting"]
    return f"{utc_now():%H:%M:%SZ}  " + " | ".join(parts)


def table(rig: str, statuses: Sequence[DeviceStatus], found: Attitudes, notes: Sequence[FaultNote]) -> Group:
    """A snapshot as a table for a terminal."""
    devices = Table(title=f"{rig}, {utc_now():%Y-%m-%d %H:%M:%S} UTC", title_justify="left", expand=True)
    for name, ratio in (("device", 3), ("", 2), ("reading", 8), ("health", 5)):
        devices.add_column(name, ratio=ratio)
    devices.add_column("age, s", justify="right", ratio=2)
    for status in statuses:
        values = status.reading.values if status.reading else {}
        age = Text(
            "-" if status.age_s is None else f"{status.age_s:.1f}",
            "" if status.state == "ok" else STYLES[status.state],
        )
        state = Text(status.state, STYLES[status.state])
        health = _health(status.name, values) if values else ""
        devices.add_row(status.name, state, _reading(status.name, values) if values else "", health, age)
    stands = Table(show_header=False, expand=True)
    for ratio in (2, 5, 2, 5):
        stands.add_column(ratio=ratio)
    altitude = f"{_number(found.altitude_m, 1)} +- {_number(found.altitude_sigma_m, 1)} m"
    vehicle = _angles(
        "heading", found.vehicle_heading_deg, "pitch", found.vehicle_pitch_deg, "roll", found.vehicle_roll_deg
    )
    camera = _angles(
        "azimuth", found.camera_azimuth_deg, "tilt", found.camera_tilt_deg, "roll", found.camera_roll_deg
    )
    stands.add_row("vehicle", vehicle, "camera looks", camera)
    stands.add_row(
        "altitude", altitude, "head", _angles("tilt", found.head_tilt_deg, "roll", found.head_roll_deg)
    )
    lines: list[Text | Table] = [devices, stands]
    lines += [Text(f"{s.name}: {s.problem}", STYLES[s.state]) for s in statuses if s.problem]
    latest = sorted(notes, key=lambda note: note.last.monotonic_s)[-NOTES_SHOWN:]
    lines += [Text(f"overcome {n.count} times: {n.device}: {n.problem}", "dim") for n in latest]
    return Group(*lines)


def _device(status: DeviceStatus) -> dict[str, Any]:
    age_s = status.age_s
    return {
        "state": status.state,
        "identity": status.identity,
        "age_s": None if age_s is None else round(age_s, 2),
        "values": dict(status.reading.values) if status.reading else None,
        "problem": status.problem,
        "failures": status.failures,
    }


def _reading(name: str, values: Mapping[str, Any]) -> str:
    if name == "head":
        moving = ", moving" if values["moving"] else ""
        return f"pan {values['pan_deg']:z.2f}, tilt {values['tilt_deg']:z.2f} deg{moving}"
    if name == "inclinometer":
        return f"tilt {values['tilt_deg']:z.3f}, roll {values['roll_deg']:z.3f} deg"
    if name == "compass" and "heading_deg" in values:
        return f"{values['heading_deg']:.1f} deg {values['reference']}"
    if name == "compass":
        axes = ", ".join(f"{axis} {values[f'field_{axis}_ut']:.1f}" for axis in ("right", "ahead", "up"))
        return f"{axes} uT"
    if name == "altimeter":
        return f"{values['pressure_hpa']:.2f} hPa, {values['altitude_m']:.1f} m"
    return f"mean level {values['brightness']:.0f} of 255"


def _health(name: str, values: Mapping[str, Any]) -> str:
    if name == "head":
        torque = {(True, True): "on", (False, False): "off"}.get(tuple(values["torque"]), "on for one servo")
        volts, temps = (
            "/".join(f"{v:.{digits}f}" for v in values[key])
            for key, digits in (("volts_v", 1), ("temperatures_c", 0))
        )
        return f"{volts} V, {temps} °C, torque {torque}"
    if name == "camera":
        return f"{values['frames_per_s']:.1f} frames/s"
    parts = []
    if "noise_deg" in values:
        parts.append(f"noise {values['noise_deg']:.4f} deg")
    if "field_ut" in values:
        parts.append(f"{values['field_ut']:.1f} uT in all")
    if values.get("temperature_c") is not None:
        parts.append(f"{values['temperature_c']:.0f} °C")
    return ", ".join(parts)


def _angles(*names_and_angles: str | float | None, digits: int = 2) -> str:
    pairs = zip(names_and_angles[::2], names_and_angles[1::2], strict=True)
    return ", ".join(f"{name} {_number(angle, digits)}" for name, angle in pairs) + " deg"


def _number(value: str | float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"
