"""Starts the fake devices of a world, writes a rig configuration for them, and shuts everything down."""

import json
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.devices.camera_stream import CameraStream
from sim.devices.gear_train import GearTrain
from sim.devices.i2c_bridge import I2cBridge
from sim.devices.pty_port import PtyPort
from sim.devices.servo import Servo
from sim.devices.servo_bus import ServoBus
from sim.devices.talkers import Talker
from sim.devices.x_series import BAUD_RATES, MODELS
from sim.faults.chip import FaultyChip
from sim.faults.injector import FaultTargets, injecting_faults
from sim.faults.script import Fault
from sim.launch import fitted_sensors
from sim.launch.fitted_sensors import FittedChip, FittedTalker
from sim.launch.odometer import running_odometer
from sim.launch.rig_config import rig_config, run_tables
from sim.launch.steering import SOCKET_NAME, steered
from sim.render.scene_camera import Picture, SceneCamera
from sim.world.mechanics import Attitude, JointState
from sim.world.truth import World

BAUD = 1_000_000
SHAKING_MG = 40.0
DEG_PER_TICK = 360.0 / 4096.0
RETURN_DELAY_2US = 25
"""Return delay set by an installer, in units of 2 us; the factory's 500 us only cost time."""


@dataclass(frozen=True)
class Joint:
    """Mounting of a servo: the tick at joint zero, and the direction."""

    name: str
    servo_id: int
    zero_tick: int
    direction: int
    min_deg: float
    max_deg: float
    parked_deg: float

    def angle_deg(self, shaft_deg: float) -> float:
        """The joint's angle at a position of the servo's shaft."""
        return (shaft_deg - self.zero_tick * DEG_PER_TICK) * self.direction

    def tick(self, angle_deg: float) -> float:
        """The servo's position at an angle of the joint."""
        return self.zero_tick + angle_deg * self.direction / DEG_PER_TICK


PAN = Joint("pan", 1, zero_tick=2053, direction=1, min_deg=-178.0, max_deg=178.0, parked_deg=35.0)
TILT = Joint("tilt", 2, zero_tick=1992, direction=-1, min_deg=-40.0, max_deg=60.0, parked_deg=-12.0)


@dataclass(frozen=True)
class SimulatedRig:
    """Fake devices that run. Tests reach into them to break something; programs only get the two paths.

    Attributes
    ----------
    config_path : pathlib.Path
        A rig configuration that points at the fake devices (``SKYFIX_CONFIG``).
    truth_path : pathlib.Path
        A JSON file with the truth (``SKYFIX_TRUTH``); only tests and evaluations may read it.
    environment : dict of str
        Both, as environment variables for a command that is started.
    world : World
        That they measure.
    pan, tilt : Servo
        The two servos on ``servo_bus``.
    servo_bus : ServoBus
        Their serial line.
    i2c : I2cBridge
        The chips' buses; ``i2c.url(number)`` is what a configuration names.
    camera : CameraStream
        An MJPEG stream over HTTP; its ``url`` is what a configuration names.
    talkers : tuple of Talker
        Those of compass and altimeter that send sentences.
    stage, clock_steps, eye
        Of the fault scripts and of the view.
    """

    config_path: Path
    truth_path: Path
    pan: Servo
    tilt: Servo
    servo_bus: ServoBus
    i2c: I2cBridge
    camera: CameraStream
    talkers: tuple[Talker, ...]
    stage: FaultTargets
    clock_steps: bool
    world: World
    scene_camera: SceneCamera

    @property
    def environment(self) -> dict[str, str]:
        """The environment variables of the contract, and the clock's offset file if a fault steps the clock."""
        paths = {"SKYFIX_CONFIG": self.config_path, "SKYFIX_TRUTH": self.truth_path}
        if self.clock_steps:
            paths["SKYFIX_CLOCK_OFFSET"] = self.stage.clock_file
        return {name: str(path) for name, path in paths.items()}

    def truth(self) -> dict[str, Any]:
        """The truth at this moment.

        Returns
        -------
        dict
            JSON values: ``lat_deg``, ``lon_deg``, ``easting_m``, ``northing_m``, ``crs``, ``row``, ``col``, ``ground_m``,
            ``altitude_m``, ``base_attitude``, ``biases`` and more.
        """
        return self.world.truth_json()

    def go(self, speed_m_s: float, course_deg: float) -> None:
        """Have the vehicle drive: its odometer says so, and its inclinometer is shaken, until it stands somewhere.

        Parameters
        ----------
        speed_m_s : float
            Over the ground.
        course_deg : float
            Clockwise from true north.
        """
        vehicle = self.world.vehicle
        vehicle.speed_m_s, vehicle.course_deg, vehicle.shaken_mg = speed_m_s, course_deg % 360.0, SHAKING_MG

    def stand_at(
        self,
        lat_deg: float,
        lon_deg: float,
        heading_deg: float,
        pitch_deg: float = 0.0,
        roll_deg: float = 0.0,
    ) -> dict[str, Any]:
        """Put the vehicle elsewhere while all devices run.

        Parameters
        ----------
        lat_deg, lon_deg : float
            WGS84.
        heading_deg : float
            Of the vehicle, clockwise from true north.
        pitch_deg, roll_deg : float
            How it leans there.

        Returns
        -------
        dict
            The truth there, which the truth's file says, too.

        Raises
        ------
        SimulationError
            The DEM has no height there.
        """
        vehicle = self.world.vehicle
        standpoint = self.world.standpoint_at(lat_deg, lon_deg)
        vehicle.speed_m_s = 0.0
        self.scene_camera.move_to(standpoint)
        vehicle.standpoint, vehicle.shaken_mg = standpoint, 0.0
        self.world.mechanics.base = Attitude(heading_deg % 360.0, pitch_deg, roll_deg)
        truth = self.truth()
        fresh = self.truth_path.with_suffix(".new")
        fresh.write_text(json.dumps(truth, indent=2), encoding="utf-8")
        fresh.replace(self.truth_path)
        return truth


@contextmanager
def simulated_rig(
    world: World | None = None,
    *,
    picture: Picture | None = None,
    bundle_dir: Path | None = None,
    calibration: Mapping[str, Path] | None = None,
    faults: Sequence[Fault] = (),
    say: Callable[[str], None] = lambda what: None,
    dem_paths: Sequence[Path] = (),
    speed: float = 1.0,
) -> Iterator[SimulatedRig]:
    """Run fakes of all devices of a rig while the ``with`` block lasts: servos, chips, talkers and a camera.

    Parameters
    ----------
    world : World, optional
        What they measure; ``World.create()`` unless given.
    picture : callable, optional
        Draws what the camera sees: called with the camera's axes (columns) in east, north, up (3, 3) and a
        ``numpy.random.Generator``, returns (height, width, 3), uint8, blue, green, red. The world's terrain and sky unless
        given.
    bundle_dir : pathlib.Path, optional
        Where the rig puts bundles when not told otherwise; ``bundles`` in the current folder.
    calibration : mapping of str to pathlib.Path, optional
        Calibration files that the configuration names, by their kind.
    faults : sequence of Fault
        What goes wrong, and when.
    say : callable
        Hears what the fault script does.
    dem_paths : sequence of pathlib.Path
        With these the configuration has a ``[run]`` for the daemon, which searches them and keeps its spool beside the bundles.
    speed : float
        How many times as fast as the computer's clock the devices and the fault script run. For tests whose own clock runs as
        fast; delays that a fault makes on a wire stay as they are.

    Yields
    ------
    SimulatedRig
        Paths, environment and truth for whoever uses it.

    Raises
    ------
    SimulationError
        Of ``World.create``.

    Examples
    --------
    >>> import rig, sim
    >>> world = sim.World.create(seed=7, scenario=small_camera)
    >>> with sim.simulated_rig(world) as simulated:
    ...     config = rig.load_config(simulated.config_path)
    ...     with rig.connect(config) as devices:
    ...         pressure_hpa = devices.altimeter.read_many(0.1)[0].pressure_hpa
    ...     truth = simulated.truth()
    >>> print(f"{pressure_hpa:.0f} hPa at {truth['altitude_m']:.0f} m")
    950 hPa at 571 m
    """
    world = World.create() if world is None else world
    scene_camera = SceneCamera(world, picture)
    start_s = time.monotonic()

    def clock() -> float:
        return speed * (time.monotonic() - start_s)

    pan, tilt = (_servo(world, joint, clock) for joint in (PAN, TILT))

    def head() -> JointState:
        """The present joint angles; updates ``world.head``."""
        (pan_deg, pan_moves), (tilt_deg, tilt_moves) = pan.shaft(), tilt.shaft()
        world.head.set(
            PAN.angle_deg(pan_deg) + world.biases.pan_zero_deg,
            TILT.angle_deg(tilt_deg) + world.biases.tilt_zero_deg,
            pan_moves or tilt_moves,
            bool(pan.register("torque_enable") or tilt.register("torque_enable")),
        )
        return world.head.state()

    with ExitStack() as running:
        folder = Path(running.enter_context(tempfile.TemporaryDirectory(prefix="skyfix-sim-")))

        by_id = folder / "serial" / "by-id"
        servo_port = PtyPort()
        running.callback(servo_port.close)
        servo_port.keep_name(by_id / "usb-servo-bus-if00-port0")
        servo_bus = ServoBus([pan, tilt])
        servo_bus.serve(servo_port)

        inclinometer = fitted_sensors.inclinometer(world, head, clock)
        compass = fitted_sensors.compass(world, head, clock, speed)
        others = {"compass": compass, "altimeter": fitted_sensors.altimeter(world, clock, compass, speed)}
        talkers = {name: fitted.talker for name, fitted in others.items() if isinstance(fitted, FittedTalker)}
        for name, talker in talkers.items():
            running.callback(talker.close)
            if talker.has_own_port:
                talker.port.keep_name(by_id / f"usb-{name}-if00-port0")
        chips = {
            name: (fitted.bus, FaultyChip(fitted.chip, world.rng(f"{name} faults")))
            for name, fitted in {"inclinometer": inclinometer, **others}.items()
            if isinstance(fitted, FittedChip)
        }
        buses = {bus for bus, _ in chips.values()}
        i2c = I2cBridge({number: [chip for bus, chip in chips.values() if bus == number] for number in buses})
        running.callback(i2c.close)

        camera = _camera(world, head, scene_camera.picture, speed)
        running.callback(camera.close)

        def keys(fitted: FittedChip | FittedTalker) -> dict[str, Any]:
            where = (
                {"bus": i2c.url(fitted.bus)}
                if isinstance(fitted, FittedChip)
                else {"port": fitted.talker.path}
            )
            return fitted.keys | where

        bundle_dir = (bundle_dir or Path.cwd() / "bundles").absolute()
        stage = FaultTargets(
            servo_port,
            servo_bus,
            {"pan": pan, "tilt": tilt},
            {name: chip for name, (_, chip) in chips.items()} | talkers,
            camera,
            folder / "clock-offset-s",
            folder / "bundles",
            bundle_dir,
            world.rng("faults"),
        )
        if any(fault.device == "disk" for fault in faults):
            bundle_dir.mkdir(parents=True, exist_ok=True)
            stage.bundle_link.symlink_to(bundle_dir)
            bundle_dir = stage.bundle_link  # a link, so that a fault can replace the disk
        config_path, truth_path = folder / "rig.toml", folder / "truth.json"
        run = run_tables(dem_paths, bundle_dir.with_name("spool")) if dem_paths else {}
        if run:
            running.enter_context(running_odometer(world, run["run.odometry"]["listen"]))
        config = rig_config(
            world,
            pan_tilt={"port": servo_port.path, "baud": BAUD},
            joints={joint.name: _joint_keys(world, joint) for joint in (PAN, TILT)},
            inclinometer=keys(inclinometer),
            compass=keys(others["compass"]),
            altimeter=keys(others["altimeter"]),
            camera_source=camera.url,
            camera_exposure_url=camera.exposure_url,
            bundle_dir=bundle_dir,
            calibration={kind: str(file.absolute()) for kind, file in (calibration or {}).items()},
            run=run,
        )
        config_path.write_text(config, encoding="utf-8")
        truth_path.write_text(json.dumps(world.truth_json(), indent=2), encoding="utf-8")
        running.enter_context(injecting_faults(stage, faults, say, speed))
        rig = SimulatedRig(
            config_path,
            truth_path,
            pan,
            tilt,
            servo_bus,
            i2c,
            camera,
            tuple(talkers.values()),
            stage,
            clock_steps=any(fault.device == "clock" for fault in faults),
            world=world,
            scene_camera=scene_camera,
        )
        running.enter_context(steered(rig, config_path.with_name(SOCKET_NAME)))
        yield rig


def _model_name(world: World, joint: Joint) -> str:
    fitted = world.scenario.servo
    return fitted.pan_model if joint is PAN else fitted.tilt_model


def _joint_keys(world: World, joint: Joint) -> dict[str, Any]:
    return {
        "id": joint.servo_id,
        "model": _model_name(world, joint),
        "zero_tick": joint.zero_tick,
        "direction": joint.direction,
        "min_deg": joint.min_deg,
        "max_deg": joint.max_deg,
    }


def _servo(world: World, joint: Joint, clock: Callable[[], float]) -> Servo:
    fitted, model = world.scenario.servo, MODELS[_model_name(world, joint)]
    left = fitted.pan_left if joint is PAN else fitted.tilt_left
    servo = Servo(
        replace(model, speed_deg_s=min(fitted.max_velocity_deg_s, model.speed_deg_s)),
        joint.servo_id,
        clock=clock,
        rng=world.rng(f"{joint.name} servo"),
        shaft_tick=joint.tick(joint.parked_deg),
        gears=GearTrain(
            backlash_deg=fitted.backlash_deg,
            settle_sigma_deg=fitted.settle_sigma_deg,
            encoder_sigma_ticks=fitted.encoder_noise_ticks,
            ring_deg=fitted.swing_deg,
        ),
        supply_v=fitted.supply_voltage_v,
        temperature_c=world.air_temperature_c + 12.0,
        eeprom={"baud_rate": BAUD_RATES.index(BAUD), "return_delay_time": RETURN_DELAY_2US, **left},
    )
    turned_deg = fitted.pan_turned_deg if joint is PAN else fitted.tilt_turned_deg
    if turned_deg:
        servo.turn_by_hand(turned_deg * joint.direction)
    return servo


def _camera(world: World, head: Callable[[], JointState], picture: Picture, speed: float) -> CameraStream:
    noise, optics = world.rng("camera"), world.scenario.camera
    one_at_a_time = threading.Lock()  # one sensor for all clients

    def frame() -> NDArray[np.uint8]:
        with one_at_a_time:
            state = head()
            return picture(world.camera_rotation(state.pan_deg, state.tilt_deg), noise)

    frame()  # the first frame compiles its kernels, which would exceed a client's timeout
    return CameraStream(frame, rate_hz=speed * optics.frame_rate_hz, jpeg_quality=optics.jpeg_quality)
