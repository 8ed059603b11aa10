"""Servos as another program, or a hand, has left them: set right or refused, and never sent the long way round.

The servos are the simulator's, which count the turns of the shaft as the cable does.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from fakes.timebases import FastClock, on

from rig import timebase
from rig.config.sections import KeepOut
from rig.daemon.servo_restarts import restart_servos
from rig.devices.pan_tilt import PanTilt
from rig.errors import DeviceError, RigError, WrongDeviceError
from rig.fault_notes import collecting
from rig.watch.sources import _head
from sim.devices.pty_port import PtyPort
from sim.devices.servo import Servo
from sim.devices.servo_bus import ServoBus
from sim.devices.x_series import MODELS

DEG_PER_TICK = 360.0 / 4096.0
MIDDLE_DEG = 2048 * DEG_PER_TICK
SPEED = 4.0


@pytest.fixture(autouse=True)
def _in_haste(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """These servos do not swing: they stand as soon as they have stopped. And all goes four times as fast.

    The answers, which a thread of this computer gives, have more time than on a real bus.
    """
    monkeypatch.setattr("rig.devices.pan_tilt._STILL_S", 0.05)
    monkeypatch.setattr("rig.devices.pan_tilt._POLL_S", 0.01)
    monkeypatch.setattr("rig.devices.dynamixel.servo_bus._TURNAROUND_S", 0.3 * SPEED)
    with on(FastClock(SPEED)):
        yield


@dataclass(frozen=True)
class Axis:
    id: int
    model: str = "XM430-W350"
    zero_tick: int = 2048
    direction: int = 1
    min_deg: float = -178.0
    max_deg: float = 178.0


@dataclass(frozen=True)
class Parameters:
    port: str
    pan: Axis = field(default_factory=lambda: Axis(1))
    tilt: Axis = field(default_factory=lambda: Axis(2, min_deg=-40.0, max_deg=60.0))
    keep_out: tuple[KeepOut, ...] = ()
    baud: int = 1_000_000
    velocity_deg_s: float = 1500.0
    acceleration_deg_s2: float = 20000.0
    bus_watchdog_ms: int = 2500
    settle_timeout_s: float = 30.0
    take_up_deg: float = 0.0


@dataclass
class Rig:
    """Two servos on a wire; ``angles`` are the shafts' true ones, over whole turns."""

    port: PtyPort
    pan: Servo
    tilt: Servo
    bus: ServoBus

    def angles(self) -> tuple[float, float]:
        return self.pan.shaft()[0] - MIDDLE_DEG, self.tilt.shaft()[0] - MIDDLE_DEG


def servo(servo_id: int, model: str, left: dict[str, int], seed: int = 1) -> Servo:
    registers = {"baud_rate": 3, "return_delay_time": 0, **left}
    return Servo(
        replace(MODELS[model], speed_deg_s=2000.0),
        servo_id,
        clock=timebase.monotonic_s,
        rng=np.random.default_rng(seed),
        eeprom=registers,
    )


@contextmanager
def rig_with(
    pan: dict[str, int] | None = None, tilt: dict[str, int] | None = None, model: str = "XM430-W350"
) -> Iterator[Rig]:
    servos = servo(1, model, pan or {}), servo(2, model, tilt or {})
    rig = Rig(PtyPort(), *servos, ServoBus(servos))
    rig.bus.serve(rig.port)
    yield rig
    rig.port.close()


@contextmanager
def head_of(rig: Rig, **others: object) -> Iterator[PanTilt]:
    model = rig.pan.model.name
    axes = {"pan": Axis(1, model), "tilt": Axis(2, model, min_deg=-40.0, max_deg=60.0)}
    with PanTilt(Parameters(rig.port.path, **axes, **others)) as head:  # type: ignore[arg-type]
        yield head


def travel(rig: Rig, head: PanTilt, *goals: tuple[float, float]) -> None:
    """Go there, and require that the shafts stand there, whole turns included."""
    for goal in goals:
        state = head.go_to(*goal)
        assert (state.pan_deg, state.tilt_deg) == pytest.approx(goal, abs=0.5)
        assert rig.angles() == pytest.approx(goal, abs=0.5)


@pytest.mark.parametrize("turned_deg", [189.0, -189.0, 400.0])
def test_a_head_turned_by_hand_beyond_one_turn_is_refused(turned_deg: float) -> None:
    with rig_with() as rig, head_of(rig) as head:
        rig.pan.turn_by_hand(turned_deg)
        for move in (head.go_to, head.move_to):
            with pytest.raises(DeviceError, match=r"pan servo .* beyond one turn .*turn it back by hand"):
                move(100.0, 0.0)
        assert rig.angles()[0] == pytest.approx(turned_deg, abs=0.2)
        assert rig.pan.register("torque_enable") == rig.tilt.register("torque_enable") == 0


def test_a_head_turned_back_by_hand_goes_on() -> None:
    with rig_with() as rig, head_of(rig) as head:
        rig.pan.turn_by_hand(189.0)
        with pytest.raises(DeviceError, match="turn it back by hand"):
            head.go_to(100.0, 0.0)
        rig.pan.turn_by_hand(-60.0)
        travel(rig, head, (100.0, 0.0))


def test_the_tilt_turned_by_hand_between_two_moves_is_refused_and_no_servo_moves() -> None:
    with rig_with() as rig:
        with head_of(rig) as head:
            travel(rig, head, (20.0, 10.0))
            head.relax()
            rig.tilt.turn_by_hand(-220.0)
            with pytest.raises(DeviceError, match=r"tilt servo .* was turned too far backward"):
                head.go_to(90.0, 0.0)
            assert rig.angles()[0] == pytest.approx(20.0, abs=0.5)
        assert rig.pan.register("torque_enable") == 0


def test_a_keep_out_zone_is_compared_with_the_way_that_would_really_be_gone() -> None:
    wall = KeepOut(pan_min_deg=-60.0, pan_max_deg=-40.0)
    with rig_with() as rig, head_of(rig, keep_out=(wall,)) as head:
        rig.pan.turn_by_hand(185.0)  # folded back it would be -175, and 100 lies beyond the wall
        with pytest.raises(RigError, match="turn it back by hand"):
            head.go_to(100.0, 0.0)
        assert rig.angles()[0] == pytest.approx(185.0, abs=0.2)


@pytest.mark.parametrize(
    "offset", [1000, *(pytest.param(each, marks=pytest.mark.long) for each in (-1000, 5000))]
)
def test_a_homing_offset_is_set_to_0_and_no_move_goes_round(offset: int) -> None:
    with collecting() as notes, rig_with(pan={"homing_offset": offset}) as rig:
        for _ in range(2):
            with head_of(rig) as head:
                travel(rig, head, (120.0, 0.0))
        assert rig.pan.register("homing_offset") == 0
    said = [note.problem for note in notes.all() if "Homing Offset" in note.problem]
    assert said == [f"had a Homing Offset of {offset} ticks, left by another program"]


@pytest.mark.parametrize("level", [0, pytest.param(1, marks=pytest.mark.long)])
def test_a_servo_that_answers_pings_or_reads_only_is_set_to_answer_all(level: int) -> None:
    with rig_with({"status_return_level": level}, {"status_return_level": level}) as rig:
        with head_of(rig) as head:
            travel(rig, head, (30.0, -10.0))
        assert rig.pan.register("status_return_level") == 2


def test_a_servo_with_anothers_id_as_its_secondary_one_does_not_move_with_it() -> None:
    with rig_with(pan={"secondary_id": 2}, tilt={"secondary_id": 1}) as rig, head_of(rig) as head:
        travel(rig, head, (50.0, 0.0), (50.0, 30.0))
        assert rig.pan.register("secondary_id") == rig.tilt.register("secondary_id") == 255


LEFT = [
    {"drive_mode": 1},
    {"drive_mode": 4, "profile_velocity": 30000, "profile_acceleration": 10000},
    {"drive_mode": 8},
    {"drive_mode": 13},
    {"operating_mode": 1},
    {"operating_mode": 4},
    {"operating_mode": 16, "goal_pwm": 300},
    {"moving_threshold": 1023},
    {"moving_threshold": 0},
    {"pwm_limit": 0, "goal_pwm": 0},
    {"goal_pwm": 0},
    {"velocity_limit": 0},
    {"min_position_limit": 2000, "max_position_limit": 2100},
    {"startup_configuration": 3},
    {"return_delay_time": 254},
    {"position_p_gain": 0},
    {"position_p_gain": 0, "position_i_gain": 0, "position_d_gain": 0, "feedforward_1st_gain": 0},
    {"profile_velocity": 1, "profile_acceleration": 1},
    {"bus_watchdog": 1},
    {"torque_enable": 1},
    {"shutdown": 0},
    {"temperature_limit": 100},
]


OFTEN = (1, 6, 7, 9, 14, 19)
"""Of LEFT: one of each kind of register. The others go the same way, each through a move of its own."""
OF_BOTH = [
    *(
        pytest.param(left, "XM430-W350", marks=[] if n in OFTEN else pytest.mark.long)
        for n, left in enumerate(LEFT)
    ),
    *(pytest.param(left, "XL430-W250", marks=pytest.mark.long) for left in LEFT[1:18:8]),
]


@pytest.mark.parametrize(
    ("left", "model"), OF_BOTH, ids=lambda part: part if isinstance(part, str) else "-".join(part)
)
def test_the_head_goes_where_it_is_asked_to_whatever_was_left(left: dict[str, int], model: str) -> None:
    with rig_with(left, left, model) as rig, head_of(rig) as head:
        travel(rig, head, (60.0, 20.0))
        state = {name: rig.pan.register(name) for name in ("pwm_limit", "drive_mode", "moving_threshold")}
        assert state == {"pwm_limit": 885, "drive_mode": 0, "moving_threshold": 10}
        assert rig.pan.register("startup_configuration") == 0
        assert rig.pan.register("shutdown") & 0x34 == 0x34
        assert rig.pan.register("position_p_gain") == {"XM430-W350": 800, "XL430-W250": 640}[model]
        assert rig.pan.register("temperature_limit") <= 80


@pytest.mark.parametrize(
    "left",
    [{"current_limit": 0, "goal_current": 0}, pytest.param({"operating_mode": 5}, marks=pytest.mark.long)],
)
def test_current_that_an_xm430_was_denied_is_given_back(left: dict[str, int]) -> None:
    with rig_with(left, left) as rig, head_of(rig) as head:
        travel(rig, head, (60.0, 20.0))
        assert (rig.pan.register("current_limit"), rig.pan.register("goal_current")) == (1193, 1193)


@pytest.mark.parametrize("lost", [14, *(pytest.param(n, marks=pytest.mark.long) for n in range(18, 30, 4))])
def test_an_answer_that_is_lost_while_a_reversed_servo_is_set_right_does_no_harm(lost: int) -> None:
    with rig_with(pan={"drive_mode": 1, "homing_offset": 300}) as rig:
        answers = iter(range(10_000))
        rig.bus.on_wire = lambda data: b"" if data and next(answers) == lost else data
        with head_of(rig) as head:
            travel(rig, head, (30.0, 0.0))


def test_a_servo_that_reboots_between_two_moves_gets_its_gains_and_speed_again() -> None:
    with rig_with() as rig, head_of(rig) as head:
        travel(rig, head, (20.0, 0.0))
        rig.pan.write(84, (0).to_bytes(2, "little"))
        rig.pan.reboot()
        timebase.sleep(0.3)
        travel(rig, head, (-20.0, 0.0))
        assert rig.pan.register("profile_velocity") == round(1500.0 / 1.374)


def test_a_servo_set_to_protocol_1_is_said_to_be_that() -> None:
    with (
        rig_with(tilt={"protocol_type": 1}) as rig,
        pytest.raises(WrongDeviceError, match=r"id 2: a servo set to Protocol 1\.0; set its Protocol Type"),
    ):
        PanTilt(Parameters(rig.port.path))


def test_a_limit_that_another_program_narrowed_is_named_with_the_error() -> None:
    said = pytest.raises(
        DeviceError, match=r"input voltage out of range \(12\.0 V; it is set to 9\.5 to 11\.0 V\)"
    )
    with rig_with(pan={"max_voltage_limit": 110}) as rig, head_of(rig) as head, said:
        head.go_to(10.0, 0.0)


def test_a_head_that_goes_another_way_is_let_go_at_once_and_for_good() -> None:
    with on(FastClock(1.0)), rig_with() as rig, head_of(rig) as head:
        travel(rig, head, (40.0, 0.0))
        head.move_to(60.0, 0.0)
        rig.pan.write(116, (2048 - 1138).to_bytes(4, "little"))  # what another program on the bus would do
        with pytest.raises(DeviceError, match=r"pan servo .* went astray: at .* from 40\.0 to 60\.0 deg"):
            head.wait_settled()
        assert rig.pan.register("torque_enable") == 0
        assert rig.angles()[0] > -60.0
        with pytest.raises(DeviceError, match="went astray"):
            head.go_to(0.0, 0.0)


def test_a_head_that_drifts_into_a_keep_out_zone_is_let_go() -> None:
    wall = KeepOut(pan_min_deg=42.0, pan_max_deg=60.0)
    with on(FastClock(1.0)), rig_with() as rig, head_of(rig, keep_out=(wall,)) as head:
        travel(rig, head, (30.0, 0.0))
        head.move_to(40.0, 0.0)
        rig.pan.write(
            116, (2048 + round(43.5 / DEG_PER_TICK)).to_bytes(4, "little")
        )  # within 4 deg of its way
        with pytest.raises(DeviceError, match=r"pan servo .* went astray"):
            head.wait_settled()
        assert rig.pan.register("torque_enable") == 0


def test_a_head_that_is_sent_back_while_it_moves_is_not_astray() -> None:
    with rig_with() as rig, head_of(rig, velocity_deg_s=200.0, acceleration_deg_s2=600.0) as head:
        head.move_to(150.0, 0.0)
        timebase.sleep(0.35)
        head.move_to(0.0, 0.0)
        assert head.wait_settled().pan_deg == pytest.approx(0.0, abs=0.5)


def test_a_servo_whose_count_folds_when_the_torque_comes_on_is_let_go(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with rig_with() as rig, head_of(rig) as head:
        monkeypatch.setattr("rig.devices.dynamixel.servo.Servo.require_one_turn", lambda self, tick: None)
        rig.pan.turn_by_hand(189.0)
        monkeypatch.setattr("rig.devices.pan_tilt.route", lambda here, goal, *others: [goal])
        with pytest.raises(
            DeviceError, match=r"its position went from tick 4198 to .* when the torque came on"
        ):
            head.go_to(100.0, 0.0)
        assert rig.pan.register("torque_enable") == 0
        assert rig.angles()[0] == pytest.approx(189.0, abs=1.0)


@pytest.mark.parametrize("mode", [4, 1])
def test_a_head_that_another_program_drove_past_one_turn_is_refused_before_the_count_is_lost(
    mode: int,
) -> None:
    with rig_with(pan={"operating_mode": mode}) as rig:
        rig.pan.turn_by_hand(200.0)
        for _ in range(2):
            with pytest.raises(DeviceError, match=r"pan servo .* beyond one turn .*turn it back by hand"):
                PanTilt(Parameters(rig.port.path))
        rig.pan.turn_by_hand(-100.0)
        with head_of(rig) as head:
            travel(rig, head, (90.0, 0.0))


def test_a_servo_that_shut_down_is_not_restarted_where_that_would_forget_a_turn() -> None:
    with rig_with(pan={"status_return_level": 1}) as rig:
        rig.pan.fail(0x20)
        rig.pan.turn_by_hand(200.0)
        section = Parameters(rig.port.path)
        with pytest.raises(DeviceError, match="turn it back by hand"):
            restart_servos(section)  # type: ignore[arg-type]
        rig.pan.turn_by_hand(-60.0)
        assert restart_servos(section) == [f"pan servo (id 1) on {rig.port.path}: overload"]  # type: ignore[arg-type]


@dataclass(frozen=True)
class WatchedAxis(Axis):
    def angle_deg(self, tick: int) -> float:
        return (tick - self.zero_tick) * DEG_PER_TICK


@dataclass(frozen=True)
class Watched(Parameters):
    pan: Axis = field(default_factory=lambda: WatchedAxis(1))
    tilt: Axis = field(default_factory=lambda: WatchedAxis(2))


def test_watching_says_that_a_head_was_turned_too_far_though_the_servos_answer_pings_only() -> None:
    with rig_with({"status_return_level": 0}, {"status_return_level": 0}) as rig:
        rig.pan.turn_by_hand(200.0)
        with _head(Watched(rig.port.path)) as source:  # type: ignore[arg-type]
            reading = source.read()
        assert reading.values["pan_deg"] == pytest.approx(200.0, abs=0.5)
        assert "turn it back by hand" in reading.warnings[0]
