"""Applies a fault script to a running simulated rig."""

import contextlib
import resource
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from sim.background import in_background
from sim.devices.camera_stream import CameraStream
from sim.devices.pty_port import PtyPort
from sim.devices.servo import ENCODER_ERROR, OVERLOAD_ERROR, Servo
from sim.devices.servo_bus import ServoBus
from sim.devices.talkers import Talker
from sim.errors import SimulationError
from sim.faults.catalogue import CATALOGUE
from sim.faults.chip import FaultyChip
from sim.faults.picture import FaultyPictures
from sim.faults.script import Fault
from sim.faults.wire import Wire

UNWRITABLE_FOLDER = Path("/sys/kernel")
"""A folder in which not even root can create files."""

Step = Callable[[], None]


@dataclass
class FaultTargets:
    """The targets of faults. ``sensors``: chip or talker by its name in scripts."""

    servo_port: PtyPort
    servo_bus: ServoBus
    servos: dict[str, Servo]
    sensors: dict[str, FaultyChip | Talker]
    camera: CameraStream
    clock_file: Path
    bundle_link: Path
    bundle_dir: Path
    rng: np.random.Generator
    wires: dict[str, Wire] = field(default_factory=dict)
    pictures: FaultyPictures = field(default_factory=FaultyPictures)
    clock_offset_s: float = 0.0
    command_pid: int | None = None
    largest_file: int = resource.RLIM_INFINITY

    def __post_init__(self) -> None:
        self.wires["servo-bus"] = Wire(self.rng)
        self.servo_bus.on_wire = self.wires["servo-bus"]
        for name, sensor in self.sensors.items():
            if isinstance(sensor, Talker):
                self.wires[name] = sensor.on_wire = Wire(self.rng)
        self.camera.alter = self.pictures

    def command_started(self, pid: int) -> None:
        """Register the process under test: a full disk is a fault of the process, not of a device."""
        self.command_pid = pid
        limit_files(self, self.largest_file)


def steps(stage: FaultTargets, fault: Fault) -> tuple[Step, Step]:
    """The functions that start and end a fault.

    Raises:
        SimulationError: the device that the scenario fits does not have this fault.
    """
    match fault.device:
        case "servo-bus":
            if fault.fault == "power-cut":
                return lambda: _power(stage, on=False), lambda: _power(stage, on=True)
            return _wire_steps(stage.wires["servo-bus"], stage.servo_port, fault)
        case "pan" | "tilt":
            return _servo_steps(stage.servos[fault.device], fault)
        case "camera":
            if fault.fault == "disconnected":
                return lambda: stage.camera.disconnect(True), lambda: stage.camera.disconnect(False)
            return lambda: stage.pictures.begin(fault), lambda: stage.pictures.end(fault)
        case "clock":
            seconds = fault.parameters["seconds"]
            return lambda: _step_clock(stage, seconds), lambda: _step_clock(stage, -seconds)
        case "disk":
            return _disk_steps(stage, fault)
        case _:
            return _sensor_steps(stage, fault)


def _wire_steps(wire: Wire, port: PtyPort, fault: Fault) -> tuple[Step, Step]:
    if fault.fault == "unplugged":
        return port.unplug, port.plug_in
    return lambda: wire.begin(fault), lambda: wire.end(fault)


def _sensor_steps(stage: FaultTargets, fault: Fault) -> tuple[Step, Step]:
    sensor = stage.sensors[fault.device]
    group = "talker" if isinstance(sensor, Talker) else "chip"
    if fault.fault not in CATALOGUE[group]:
        known = ", ".join(CATALOGUE[group])
        raise SimulationError(
            f"the {fault.device} of this scenario is a {group}: it has no fault {fault.fault!r}, only {known}"
        )
    if isinstance(sensor, Talker):
        return _wire_steps(stage.wires[fault.device], sensor.port, fault)
    return lambda: sensor.begin(fault), lambda: sensor.end(fault)


def _servo_steps(servo: Servo, fault: Fault) -> tuple[Step, Step]:
    gears, temperature_c, supply_v = servo.gears, servo.temperature_c, servo.supply_v
    match fault.fault:
        case "overload":
            return lambda: servo.fail(OVERLOAD_ERROR), _nothing
        case "encoder-error":
            return lambda: servo.fail(ENCODER_ERROR), _nothing
        case "reboot":
            return lambda: _ignore(servo.reboot()), _nothing
        case "blocked":
            return lambda: servo.block(True), lambda: servo.block(False)
        case "overheating":
            name, value, before = "temperature_c", fault.parameters["temperature_c"], temperature_c
        case "voltage-low":
            name, value, before = "supply_v", fault.parameters["volts"], supply_v
        case "backlash":
            loose = replace(gears, backlash_deg=fault.parameters["degrees"])
            return lambda: setattr(servo, "gears", loose), lambda: setattr(servo, "gears", gears)
        case "alert":
            return lambda: setattr(servo, "false_alert", True), lambda: setattr(servo, "false_alert", False)
        case _:
            return lambda: setattr(servo, "silent", True), lambda: setattr(servo, "silent", False)
    return lambda: setattr(servo, name, value), lambda: setattr(servo, name, before)


def _power(stage: FaultTargets, *, on: bool) -> None:
    for servo in stage.servos.values():
        if on:
            servo.reboot()
        else:
            servo.lose_power()
        servo.silent = not on


def _step_clock(stage: FaultTargets, seconds: float) -> None:
    stage.clock_offset_s += seconds
    fresh = stage.clock_file.with_suffix(".new")
    fresh.write_text(f"{stage.clock_offset_s:.3f}\n", encoding="ascii")
    fresh.replace(stage.clock_file)


def _disk_steps(stage: FaultTargets, fault: Fault) -> tuple[Step, Step]:
    if fault.fault == "full":
        limit = int(fault.parameters["largest_file_bytes"])
        return lambda: limit_files(stage, limit), lambda: limit_files(stage, resource.RLIM_INFINITY)
    return lambda: _point(stage.bundle_link, UNWRITABLE_FOLDER), lambda: _point(
        stage.bundle_link, stage.bundle_dir
    )


def limit_files(stage: FaultTargets, size: int) -> None:
    """Limit the command's file size to ``size`` bytes: the closest to a full disk without privileges."""
    stage.largest_file = size
    if stage.command_pid is None:
        return
    with contextlib.suppress(ProcessLookupError):  # it has ended
        _, hard = resource.prlimit(stage.command_pid, resource.RLIMIT_FSIZE)
        resource.prlimit(stage.command_pid, resource.RLIMIT_FSIZE, (size, hard))


def _point(link: Path, target: Path) -> None:
    fresh = link.with_suffix(".new")
    fresh.symlink_to(target)
    fresh.replace(link)


def _ignore(result: object) -> None:
    """Discard a result."""


def _nothing() -> None:
    """No-op."""


@contextmanager
def injecting_faults(
    stage: FaultTargets, faults: Sequence[Fault], say: Callable[[str], None], speed: float = 1.0
) -> Iterator[None]:
    """Apply ``faults`` on schedule while the context lasts; ``say`` is called for each.

    Faults at 0 s are active before the context is entered. Other times count from the rig's first instruction to the
    head, by a clock that runs ``speed`` times as fast as the computer's.

    Raises:
        SimulationError: a device does not have a fault of the script.
    """
    timed = []
    for fault in faults:
        begin, end = steps(stage, fault)
        if fault.at_s == 0.0:
            begin()
            say(f"from the beginning: {fault}")
        else:
            timed.append((fault.at_s, f"{fault}", begin))
        if fault.for_s is not None:
            timed.append((fault.at_s + fault.for_s, f"{fault.device} {fault.fault} is over", end))
    timed.sort(key=lambda step: step[0])

    def play(stop: threading.Event) -> None:
        while not stage.servo_bus.contacted.wait(0.02):
            if stop.is_set():
                return
        start_s = time.monotonic()
        for at_s, what, step in timed:
            if stop.wait(max(0.0, start_s + at_s / speed - time.monotonic())):
                return
            step()
            say(f"{at_s:.2f} s: {what}")

    with in_background(play, "fault script"):
        yield
