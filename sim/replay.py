"""Plays a log of ``rig record`` back: recorded devices on pseudo-terminals and an I2C bridge, a camera that shows grey.

A device that was asked answers each request as it did then, in the order of then, and its last answer for ever; one that
talks unasked says the same bytes after the same pauses, over and over. The format of the log is described in
docs/recording.md.
"""

import json
import os
import tempfile
import threading
from collections import defaultdict, deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from sim.devices.camera_stream import CameraStream
from sim.devices.i2c_bridge import I2cBridge
from sim.devices.pty_port import PtyPort
from sim.errors import SimulationError
from sim.replay_registers import factory_answer

LOG_VERSION = 1
NO_ACKNOWLEDGE = 121
LISTENER_S = 0.3
"""From the listener's opening of the port to the first byte: it throws away what was there before."""

GREY = 128

Exchange = Mapping[str, Any]


class Answers:
    """What was answered to each request, in order; the last answer stays."""

    def __init__(self) -> None:
        self._answers: dict[Any, deque[Any]] = defaultdict(deque)

    def add(self, request: object, answer: object) -> None:
        """One more answer to ``request``."""
        self._answers[request].append(answer)

    def next(self, request: object, otherwise: Any) -> Any:
        """The answer to ``request``; ``otherwise`` where it was never made."""
        answers = self._answers.get(request)
        if not answers:
            return otherwise
        return answers.popleft() if len(answers) > 1 else answers[0]


class ReplayedChip:
    """A chip that reads as it did. Implements ``sim.devices.i2c_chip.I2cChip``."""

    def __init__(self, address: int) -> None:
        self.address = address
        self._answers = Answers()

    def add(self, exchange: Exchange) -> None:
        """One more recorded transfer."""
        self._answers.add((exchange["write"], exchange["length"]), exchange)

    def transfer(self, write: bytes, read_length: int) -> bytes:
        """See ``I2cChip``. No acknowledge for what was never recorded."""
        exchange = self._answers.next((write.hex(), read_length), {"errno": NO_ACKNOWLEDGE})
        if "errno" in exchange:
            raise OSError(exchange["errno"], os.strerror(exchange["errno"]))
        return bytes.fromhex(exchange["read"])


class ReplayedTalker:
    """Says what was received, with the same pauses, from the moment that somebody opens the port at ``baud``."""

    def __init__(self, port: PtyPort, said: Sequence[tuple[float, bytes]], baud: int) -> None:
        self._port, self._said, self._baud = port, said, baud
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._talk, name=f"replay {port.path}")
        self._thread.start()

    def close(self) -> None:
        """Fall silent."""
        self._stop.set()
        self._thread.join()

    def _talk(self) -> None:
        while self._port.baud != self._baud:
            if self._stop.wait(0.02):
                return
        pause_s = LISTENER_S
        while True:
            before_s = self._said[0][0]
            for at_s, data in self._said:
                if self._stop.wait(pause_s + at_s - before_s):
                    return
                self._port.send(data)
                pause_s, before_s = 0.0, at_s
            pause_s = LISTENER_S


def load_log(path: Path) -> tuple[dict[str, Any], list[Exchange]]:
    """The configuration and the exchanges of a log. A last line that a crash cut off is left out.

    Raises:
        SimulationError: it cannot be read, or is no such log.
    """
    try:
        lines = path.read_text(encoding="ascii").splitlines()
        header = json.loads(lines[0]) if lines else {}
        if header.get("skyfix_log") != LOG_VERSION:
            raise SimulationError(f"log {path}: is no log of rig record, version {LOG_VERSION}")
        exchanges = [json.loads(line) for line in lines[1:-1]]
        if lines[1:]:
            exchanges += _unless_cut(lines[-1])
    except OSError as error:
        raise SimulationError(f"log {path}: {error.strerror or error}; name a readable file") from error
    except (ValueError, AttributeError) as error:
        raise SimulationError(f"log {path}: is no log of rig record: {error}") from error
    if not exchanges:
        raise SimulationError(
            f"log {path}: holds nothing that a device was asked or said; record a command that got as far as the devices"
        )
    return header["config"], exchanges


def _unless_cut(line: str) -> list[Exchange]:
    try:
        return [json.loads(line)]
    except ValueError:
        return []


@contextmanager
def replayed(path: Path) -> Iterator[Path]:
    """Devices that behave as the log says, while the context lasts; the path of a rig configuration for them.

    Raises:
        SimulationError: as ``load_log``.
    """
    config, exchanges = load_log(path)
    with ExitStack() as running:
        folder = Path(running.enter_context(tempfile.TemporaryDirectory(prefix="skyfix-replay-")))
        names: dict[str, str] = {}
        bauds = {section.get("port"): section.get("baud") for section in config.values()}
        servos = [config["pan_tilt"][axis] for axis in ("pan", "tilt")]
        models = {int(servo["id"]): str(servo["model"]) for servo in servos}
        for number, port_name in enumerate(sorted({e["port"] for e in exchanges if "port" in e})):
            port = PtyPort()
            running.callback(port.close)
            port.keep_name(folder / f"port-{number}")
            names[port_name] = port.path
            here = [e for e in exchanges if e.get("port") == port_name]
            if any("sent" in e for e in here):
                port.answer(_answering(here, models))
            else:
                said = [(float(e["t"]), bytes.fromhex(e["received"])) for e in here]
                running.callback(ReplayedTalker(port, said, int(bauds.get(port_name) or 4800)).close)
        buses = sorted({e["bus"] for e in exchanges if "bus" in e})
        bridge = I2cBridge(
            {n: _chips([e for e in exchanges if e.get("bus") == bus]) for n, bus in enumerate(buses)}
        )
        running.callback(bridge.close)
        names |= {bus: bridge.url(number) for number, bus in enumerate(buses)}
        camera = _grey_camera(config["camera"])
        running.callback(camera.close)
        config["camera"]["source"] = camera.url
        config_path = folder / "rig.toml"
        config_path.write_text(toml(renamed(config, names)), encoding="utf-8")
        yield config_path


def _answering(exchanges: Sequence[Exchange], models: Mapping[int, str]) -> Any:
    """From requests to what was received until the next one; else to what a servo has from the factory."""
    answers, request, answer = Answers(), "", b""
    for exchange in [*exchanges, {"sent": ""}]:
        if "sent" in exchange:
            if request:
                answers.add(request, answer)
            request, answer = exchange["sent"], b""
        else:
            answer += bytes.fromhex(exchange["received"])

    def answer_to(data: bytes) -> bytes:
        answer = answers.next(data.hex(), None)
        return factory_answer(data, models) if answer is None else bytes(answer)

    return answer_to


def _chips(exchanges: Sequence[Exchange]) -> list[ReplayedChip]:
    chips: dict[int, ReplayedChip] = {}
    for exchange in exchanges:
        chips.setdefault(exchange["address"], ReplayedChip(exchange["address"])).add(exchange)
    return list(chips.values())


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
    """TOML of nested tables of plain values and lists of these; a list of tables is left out where it is empty."""
    lines, below = [], []
    for key, value in tables.items():
        if isinstance(value, dict):
            below.append(f"\n[{prefix}{key}]\n{toml(value, f'{prefix}{key}.')}")
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            below += [f"\n[[{prefix}{key}]]\n{toml(each)}" for each in value]
        else:
            lines.append(f"{key} = {json.dumps(value)}")
    return "\n".join(lines) + "\n" + "".join(below)
