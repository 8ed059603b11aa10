"""Plays a log of ``rig record`` back: recorded devices on pseudo-terminals and an I2C bridge, a camera with grey
pictures.

Answering devices repeat the answer of the same request in the same situation (``sim.replay.response_lookup``); talkers
repeat their bytes with the same pauses. Requests that the log cannot answer are reported. The log's format is described
in docs/recording.md.
"""

import json
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from sim.devices.camera_stream import CameraStream
from sim.devices.i2c_bridge import I2cBridge
from sim.devices.pty_port import PtyPort
from sim.replay.devices import Exchange, ReplayedChip, ReplayedServos, ReplayedTalker, Say, with_epochs
from sim.replay.log_file import load_log

GREY = 128
NOTES_SHOWN = 3


class ReplayNotes:
    """Collects unanswered requests, each once, and devices with more requests than recorded."""

    def __init__(self, exchanges: Sequence[Exchange]) -> None:
        self._missing: dict[str, None] = {}
        self._asked: list[tuple[str, float, ReplayedChip | ReplayedServos]] = []
        self._ends_s = max(float(exchange["t"]) for exchange in exchanges)

    def about(self, device: str) -> Say:
        """The callback for a device's unanswered requests."""
        return lambda what: self._missing.setdefault(f"the log {what} ({device})")

    def watch(
        self, name: str, here: Sequence[tuple[Exchange, int]], device: ReplayedChip | ReplayedServos
    ) -> None:
        """Check at the end whether ``device`` got more requests than the exchanges ``here``."""
        self._asked.append((name, float(here[-1][0]["t"]), device))

    def lines(self, failed: bool) -> list[str]:
        """The missing requests, and for a failed command where the log ends."""
        lines = list(self._missing)
        if failed:
            lines += [
                f"the log of {name} ends after {at_s:.1f} s: what was asked beyond it got the answers of before"
                for name, at_s, device in self._asked
                if device.ran_out
            ]
        if not lines:
            return []
        more = [f"and {len(lines) - NOTES_SHOWN} more"] if len(lines) > NOTES_SHOWN else []
        end = (
            f"the log ends after {self._ends_s:.1f} s; replay the command that was recorded, "
            "or record the one that is to be replayed"
        )
        return [*lines[:NOTES_SHOWN], *more, end]


@dataclass(frozen=True)
class Replay:
    """The devices of a playback."""

    config_path: Path
    environment: Mapping[str, str]
    """Environment of the command: configuration and recorded clock."""
    notes: ReplayNotes


@contextmanager
def replayed(path: Path) -> Iterator[Path]:
    """Play devices back while the context lasts; yields the path of a rig configuration for them.

    Raises:
        SimulationError: as ``load_log``.
    """
    with replaying(path) as replay:
        yield replay.config_path


@contextmanager
def replaying(path: Path) -> Iterator[Replay]:
    """As ``replayed``, with environment and notes.

    Raises:
        SimulationError: as ``load_log``.
    """
    config, exchanges = load_log(path)
    notes = ReplayNotes(exchanges)
    with ExitStack() as running:
        folder = Path(running.enter_context(tempfile.TemporaryDirectory(prefix="skyfix-replay-")))
        sections = [section for section in config.values() if isinstance(section, dict)]
        bauds = {section.get("port"): section.get("baud") for section in sections}
        by_port: dict[str, list[tuple[Exchange, int]]] = {port: [] for port in bauds if port}
        by_bus: dict[str, list[tuple[Exchange, int]]] = {s["bus"]: [] for s in sections if "bus" in s}
        for exchange, epoch in with_epochs(exchanges):
            group, name = (by_port, "port") if "port" in exchange else (by_bus, "bus")
            group.setdefault(exchange[name], []).append((exchange, epoch))

        names: dict[str, str] = {}
        asked = [port for port, here in by_port.items() if any("sent" in e for e, _ in here)]
        head: ReplayedServos | None = None

        def epoch_now() -> int:
            return head.epoch() if head else 0

        # Answering devices first: talkers need to know the head's epoch.
        for number, name in enumerate(sorted(by_port, key=lambda port: (port not in asked, port))):
            port = PtyPort()
            running.callback(port.close)
            port.keep_name(folder / f"port-{number}")
            names[name] = port.path
            say = notes.about(name)
            if name in asked:
                servos = ReplayedServos(by_port[name], say, _models(config))
                notes.watch(name, by_port[name], servos)
                head = head or servos
                port.answer(servos.answer)
            else:
                baud = int(bauds.get(name) or 4800)
                running.callback(ReplayedTalker(port, by_port[name], baud, epoch_now, say).close)
        bridge = _bridge(by_bus, epoch_now, notes)
        running.callback(bridge.close)
        names |= {bus: bridge.url(number) for number, bus in enumerate(by_bus)}
        camera = _grey_camera(config["camera"])
        running.callback(camera.close)
        config["camera"]["source"] = camera.url
        if "exposure_url" in config["camera"]:
            config["camera"]["exposure_url"] = camera.exposure_url
        config_path = folder / "rig.toml"
        config_path.write_text(toml(renamed(config, names)), encoding="utf-8")
        yield Replay(config_path, {"SKYFIX_CONFIG": str(config_path), **_clock_of_then(path, folder)}, notes)


def _models(config: Mapping[str, Any]) -> dict[int, str]:
    """The servos' models by id, from the log's configuration."""
    head = config.get("pan_tilt")
    servos = [head.get(axis) for axis in ("pan", "tilt")] if isinstance(head, dict) else []
    return {
        each["id"]: str(each.get("model"))
        for each in servos
        if isinstance(each, dict) and isinstance(each.get("id"), int)
    }


def _bridge(
    by_bus: Mapping[str, Sequence[tuple[Exchange, int]]], epoch: Callable[[], int], notes: ReplayNotes
) -> I2cBridge:
    buses = list(by_bus)
    chips: dict[int, list[ReplayedChip]] = {}
    for number, bus in enumerate(buses):
        chips[number] = []
        for address in sorted({e["address"] for e, _ in by_bus[bus]}):
            name = f"0x{address:02X} on {bus}"
            here = [(e, at) for e, at in by_bus[bus] if e["address"] == address]
            chips[number].append(ReplayedChip(address, here, epoch, notes.about(name)))
            notes.watch(name, here, chips[number][-1])
    known = {(number, chip.address) for number, here in chips.items() for chip in here}

    def fault(bus: int, address: int) -> int:
        if (bus, address) not in known and bus < len(buses):
            notes.about(f"0x{address:02X} on {buses[bus]}")("holds nothing of this chip")
        return 0

    return I2cBridge(chips, fault=fault)


def _clock_of_then(path: Path, folder: Path) -> dict[str, str]:
    """Environment with the recorded clock, as declination and drift depend on the date."""
    from sim.documents import values_of

    try:
        with path.open("rb") as file:
            then = datetime.fromisoformat(values_of(file.readline())["utc"])
    except (KeyError, TypeError, ValueError):
        return {}
    offset_s = (then - datetime.now(UTC)).total_seconds()
    file_path = folder / "clock-offset"
    file_path.write_text(f"{offset_s:.3f}", encoding="ascii")
    return {"SKYFIX_CLOCK_OFFSET": str(file_path)}


def _grey_camera(camera: Mapping[str, Any]) -> CameraStream:
    noise = np.random.default_rng(1)
    size = camera["height_px"], camera["width_px"], 3
    return CameraStream(lambda: np.clip(noise.normal(GREY, 2.0, size), 0, 255).astype(np.uint8))


def renamed(value: Any, names: Mapping[str, str]) -> Any:
    """``value`` with every string that is a key of ``names`` replaced."""
    if isinstance(value, dict):
        return {key: renamed(each, names) for key, each in value.items()}
    return names.get(value, value) if isinstance(value, str) else value


def toml(tables: Mapping[str, Any], prefix: str = "") -> str:
    """TOML of nested tables of plain values and lists; an empty list of tables is omitted."""
    lines, below = [], []
    for key, value in tables.items():
        if isinstance(value, dict):
            below.append(f"\n[{prefix}{key}]\n{toml(value, f'{prefix}{key}.')}")
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            below += [f"\n[[{prefix}{key}]]\n{toml(each)}" for each in value]
        else:
            lines.append(f"{key} = {json.dumps(value)}")
    return "\n".join(lines) + "\n" + "".join(below)
