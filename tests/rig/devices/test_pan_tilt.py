"""The head on servos that answer at wire level: angles, settling, bus watchdog, torque off always."""

import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import pytest
from fakes.servos import GOAL, HARDWARE_ERROR, POSITION, TORQUE, WATCHDOG, FakeServo, FakeServoBus
from fakes.timebases import FastClock, on

from rig import timebase
from rig.config.sections import KeepOut
from rig.devices.pan_tilt import PanTilt
from rig.errors import DeviceError, GoalError, TransientError, WrongDeviceError
from rig.fault_notes import collecting

SPEED = 5.0


@pytest.fixture(autouse=True)
def _in_haste(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The servos turn, and the head waits for them, five times as fast. Their answers, which a thread of
    this computer gives, have more time than on a real bus."""
    monkeypatch.setattr("rig.devices.dynamixel.servo_bus._TURNAROUND_S", 0.3 * SPEED)
    with on(FastClock(SPEED)):
        yield


@dataclass(frozen=True)
class Axis:
    id: int
    model: str = "XM430-W350"
    zero_tick: int = 2048
    direction: int = 1
    min_deg: float = -170.0
    max_deg: float = 170.0


@dataclass(frozen=True)
class Parameters:
    port: str
    baud: int = 1_000_000
    velocity_deg_s: float = 60.0
    acceleration_deg_s2: float = 180.0
    bus_watchdog_ms: int = 1000
    settle_timeout_s: float = 30.0
    pan: Axis = field(default_factory=lambda: Axis(1))
    tilt: Axis = field(default_factory=lambda: Axis(2, direction=-1, min_deg=-40.0, max_deg=60.0))
    keep_out: tuple[KeepOut, ...] = ()
    take_up_deg: float = 0.0


@pytest.fixture
def servos() -> Iterator[FakeServoBus]:
    with FakeServoBus(FakeServo(1), FakeServo(2)) as bus:
        yield bus


@pytest.fixture
def parameters(servos: FakeServoBus) -> Parameters:
    return Parameters(servos.path)


@pytest.fixture
def head(parameters: Parameters) -> Iterator[PanTilt]:
    with PanTilt(parameters) as head:
        yield head


def register(servos: FakeServoBus, address: int, length: int) -> list[int]:
    return [servo.get(address, length) for servo in servos.servos.values()]


def test_connecting_sets_the_servos_up_and_leaves_the_torque_off(head, servos):
    assert register(servos, TORQUE, 1) == [0, 0]
    assert register(servos, 9, 1) == [0, 0]  # return delay
    assert register(servos, 52, 4) == [114, 2048 - 683]  # tilt runs the other way
    assert register(servos, 48, 4) == [3982, 2048 + 455]
    assert register(servos, 112, 4) == [44, 44]
    assert head.identify() == "pan XM430-W350 firmware 45 (id 1), tilt XM430-W350 firmware 45 (id 2)"


def test_the_head_goes_where_it_is_asked_to(head, servos):
    head.move_to(90.0, 30.0)
    state = head.wait_settled()
    assert state.pan_deg == pytest.approx(90.0, abs=0.05)
    assert state.tilt_deg == pytest.approx(30.0, abs=0.05)
    assert state.ticks == (3072, 2048 - 341)
    assert not state.moving
    assert state.alerts == ()
    assert state.volts == (pytest.approx(12.1), pytest.approx(12.1))
    assert state.temps == (31.0, 31.0)
    assert timebase.monotonic_s() - state.monotonic_s < 5.0


@pytest.mark.parametrize(
    ("pan_deg", "tilt_deg", "axis"), [(171.0, 0.0, "pan"), (0.0, -41.0, "tilt"), (float("nan"), 0.0, "pan")]
)
def test_a_goal_outside_the_limits_is_refused_before_anything_moves(head, servos, pan_deg, tilt_deg, axis):
    servos.writes.clear()
    with pytest.raises(GoalError, match=f"{axis} goal .* is outside its limits"):
        head.move_to(pan_deg, tilt_deg)
    assert servos.writes == []


def test_leaving_the_head_switches_the_torque_off(parameters, servos):
    with PanTilt(parameters) as head:
        head.move_to(10.0, 10.0)
        assert register(servos, TORQUE, 1) == [1, 1]
    assert register(servos, TORQUE, 1) == [0, 0]


def move_and_raise(parameters: Parameters, error: BaseException) -> None:
    with PanTilt(parameters) as head:
        head.move_to(10.0, 10.0)
        raise error


@pytest.mark.parametrize("error", [ZeroDivisionError(), KeyboardInterrupt()])
def test_an_error_switches_the_torque_off_and_stays_the_error(parameters, servos, error):
    with pytest.raises(type(error)):
        move_and_raise(parameters, error)
    assert register(servos, TORQUE, 1) == [0, 0]


@pytest.mark.parametrize(("broken", "other"), [(1, 2), (2, 1)])
def test_torque_goes_off_for_each_servo_even_where_the_other_fails(parameters, servos, broken, other):
    head = PanTilt(parameters)
    head.move_to(10.0, 10.0)
    servos.servos[broken].silent = True
    with pytest.raises(
        DeviceError, match=rf"torque could not be switched off \(servo id {broken} .*power off"
    ):
        head.close()
    assert servos.servos[other].registers[TORQUE] == 0


def move_and_unplug(parameters: Parameters, servos: FakeServoBus) -> None:
    with PanTilt(parameters) as head:
        head.move_to(10.0, 10.0)
        servos.unplug()
        raise ZeroDivisionError


def test_failing_to_switch_off_does_not_hide_why_the_head_was_left(parameters, servos):
    with pytest.raises(ZeroDivisionError) as raised:
        move_and_unplug(parameters, servos)
    assert "torque could not be switched off" in raised.value.__notes__[0]


def test_an_unplugged_bus_is_one_clear_line(parameters, servos, monkeypatch):
    monkeypatch.setattr("rig.devices.bus.retry.REPLUG_S", 0.2)
    head = PanTilt(parameters)
    servos.unplug()
    with pytest.raises(DeviceError, match=r"serial port .*: (stopped working|there is no such port)"):
        head.state()
    with pytest.raises(DeviceError, match="torque could not be switched off"):
        head.close()


def test_a_port_that_is_not_there_is_one_clear_line(parameters):
    with pytest.raises(DeviceError, match="serial port /dev/not-there: there is no such port"):
        PanTilt(replace(parameters, port="/dev/not-there"))


def test_a_servo_of_another_model_is_left_alone(servos, parameters):
    servos.servos[2].put(0, 2, 1060)
    with pytest.raises(WrongDeviceError, match="found id 1: XM430-W350, id 2: XL430-W250"):
        PanTilt(parameters)
    assert servos.writes == []


def test_a_missing_servo_is_found_out_at_once(servos, parameters):
    servos.servos[2].silent = True
    with pytest.raises(TransientError, match="id 2: no answer"):
        PanTilt(parameters)


def test_old_firmware_without_a_bus_watchdog_is_refused_unless_it_is_off(servos, parameters):
    servos.servos[1].put(6, 1, 37)
    with pytest.raises(DeviceError, match=r"pan servo .* firmware 37 has no bus watchdog"):
        PanTilt(parameters)
    PanTilt(replace(parameters, bus_watchdog_ms=0)).close()


def test_a_few_lost_packets_are_survived(head, servos):
    servos.drop_next = 1
    head.state()
    servos.corrupt_next = 2
    head.state()
    servos.drop_next = 2
    head.move_to(5.0, 5.0)
    assert head.wait_settled().pan_deg == pytest.approx(5.0, abs=0.05)


def test_a_servo_that_falls_silent_is_named(head, servos):
    servos.servos[2].silent = True
    with pytest.raises(TransientError, match=r"tilt servo \(id 2\)"):
        head.state()
    servos.servos[2].silent = False


def test_the_state_shows_a_hardware_error_by_name(head, servos):
    servos.servos[1].registers[HARDWARE_ERROR] = 0x01
    assert head.state().alerts == (f"pan servo (id 1) on {servos.path}: input voltage out of range",)


def test_a_hardware_error_stops_the_moving(head, servos):
    servos.servos[2].registers[HARDWARE_ERROR] = 0x24
    servos.writes.clear()
    with pytest.raises(DeviceError, match=r"tilt servo \(id 2\) .*: overheated, overload; remove the cause"):
        head.move_to(5.0, 5.0)
    assert servos.writes == []


def test_a_hardware_error_on_the_way_ends_the_waiting(head, servos):
    slow(servos)
    head.move_to(50.0, 0.0)
    servos.servos[1].registers[HARDWARE_ERROR] = 0x20
    with pytest.raises(DeviceError, match="overload"):
        head.wait_settled()


def slow(servos: FakeServoBus) -> None:
    for servo in servos.servos.values():
        servo.speed_tick_s = 300.0


def test_a_blocked_servo_is_named_with_where_it_stopped(head, servos):
    servos.servos[1].stuck = True
    head.move_to(20.0, 0.0)
    with pytest.raises(
        DeviceError, match=r"pan servo .* stopped at 0\.0 deg on its way to 20\.0 deg; look for"
    ):
        head.wait_settled()


def test_a_head_that_never_stands_is_given_up_in_time(head, servos):
    servos.servos[1].creeps = True
    head.move_to(20.0, 0.0)
    started_s = timebase.monotonic_s()
    with pytest.raises(DeviceError, match="still moves at pan 20"):
        head.wait_settled(timeout_s=0.3)
    assert timebase.monotonic_s() - started_s < 5.0


def test_lost_power_on_the_way_is_named(head, servos):
    slow(servos)
    head.move_to(50.0, 0.0)
    servos.servos[1].registers[TORQUE] = 0
    with pytest.raises(DeviceError, match="lost its torque at"):
        head.wait_settled()


def test_after_lost_power_the_speed_is_set_again(head, servos):
    head.move_to(5.0, 0.0)
    head.wait_settled()
    for address, length in ((TORQUE, 1), (112, 4), (108, 4)):
        servos.servos[1].put(address, length, 0)
    head.move_to(10.0, 0.0)
    assert servos.servos[1].get(112, 4) == 44


def test_torque_comes_on_without_a_jump(parameters, servos):
    servos.servos[1].put(POSITION, 4, 1500)
    servos.servos[1].put(GOAL, 4, 3000)
    with PanTilt(parameters) as head:
        servos.writes.clear()
        head.move_to(0.0, 0.0)
        on = servos.writes.index((1, TORQUE, b"\x01"))
        goals = [(i, data) for i, (servo, a, data) in enumerate(servos.writes) if (servo, a) == (1, GOAL)]
        assert goals[0] == (goals[0][0], (1500).to_bytes(4, "little"))
        assert goals[0][0] < on < goals[1][0]


def test_the_bus_watchdog_is_armed_while_the_head_moves_only(head, servos):
    assert register(servos, WATCHDOG, 1) == [0, 0]
    head.move_to(5.0, 0.0)
    assert register(servos, WATCHDOG, 1) == [50, 50]
    head.wait_settled()
    assert register(servos, WATCHDOG, 1) == [0, 0]


def test_waiting_resets_the_bus_watchdog(parameters, servos):
    with PanTilt(replace(parameters, bus_watchdog_ms=200)) as head:
        slow(servos)
        head.move_to(20.0, 0.0)  # some 0.8 s
        assert head.wait_settled().pan_deg == pytest.approx(20.0, abs=0.05)


def test_a_head_stopped_by_its_watchdog_is_recognised_and_goes_on_when_asked_again(head, servos):
    slow(servos)
    head.move_to(50.0, 0.0)
    servos.servos[1].trip_watchdog()
    with pytest.raises(DeviceError, match="its bus watchdog stopped it at"):
        head.wait_settled()
    servos.servos[1].speed_tick_s = 20_000.0
    head.move_to(50.0, 0.0)
    assert servos.servos[1].get(112, 4) == 44  # the trip had set it to full speed
    assert head.wait_settled().pan_deg == pytest.approx(50.0, abs=0.05)


def test_a_watchdog_that_tripped_under_another_program_is_cleared_at_connect(parameters, servos):
    servos.servos[1].trip_watchdog()
    with PanTilt(parameters) as head:
        assert register(servos, WATCHDOG, 1) == [0, 0]
        head.move_to(5.0, 0.0)
        head.wait_settled()


def test_a_silent_program_lets_the_servos_stop_by_themselves(parameters, servos):
    with PanTilt(replace(parameters, bus_watchdog_ms=100)) as head:
        slow(servos)
        head.move_to(90.0, 0.0)
        time.sleep(0.3)
        with pytest.raises(DeviceError, match="its bus watchdog stopped it"):
            head.wait_settled()


def test_setting_up_that_fails_half_way_leaves_no_torque_and_a_free_port(parameters, servos):
    servos.servos[1].registers[TORQUE] = servos.servos[2].registers[TORQUE] = 1
    with pytest.MonkeyPatch.context() as refusing:
        refuse_writes_to(servos.servos[2], 112, refusing)
        with pytest.raises(DeviceError, match="servo id 2"):
            PanTilt(parameters)
    assert register(servos, TORQUE, 1) == [0, 0]
    PanTilt(parameters).close()


def refuse_writes_to(servo: FakeServo, address: int, monkeypatch: pytest.MonkeyPatch) -> None:
    write: Callable[[int, bytes], int] = servo.write
    monkeypatch.setattr(servo, "write", lambda a, data: 4 if a == address else write(a, data))


ANTENNA = KeepOut(pan_min_deg=40.0, pan_max_deg=60.0, tilt_min_deg=-30.0, tilt_max_deg=20.0)


def test_the_head_goes_round_a_keep_out_zone(parameters, servos):
    with PanTilt(replace(parameters, keep_out=(ANTENNA,))) as head:
        head.go_to(30.0, 0.0)
        servos.writes.clear()
        state = head.go_to(90.0, 0.0)
        assert (state.pan_deg, state.tilt_deg) == (pytest.approx(90.0, abs=0.1), pytest.approx(0.0, abs=0.1))
        tilts = [-(goal - 2048) * 360 / 4096 for servo, goal in servos.written(GOAL) if servo == 2]
        assert tilts[0] > 21.0, "over it"


def test_a_goal_in_a_keep_out_zone_is_refused_before_anything_moves(parameters, servos):
    with PanTilt(replace(parameters, keep_out=(ANTENNA,))) as head:
        for move in (head.go_to, head.move_to):
            with pytest.raises(
                GoalError, match=r"lies in the keep-out zone pan 40 to 60, tilt -30 to 20 deg"
            ):
                move(50.0, 0.0)
        with pytest.raises(GoalError, match=r"the straight way .* leads through a keep-out zone"):
            head.move_to(90.0, 0.0)
        assert not servos.written(GOAL)


def test_a_zone_that_cannot_be_passed(parameters, servos):
    wall = KeepOut(pan_min_deg=40.0, pan_max_deg=60.0)
    with PanTilt(replace(parameters, keep_out=(wall,))) as head:
        with pytest.raises(GoalError, match=r"no way from pan 0\.0, tilt -?0\.0 to pan 90\.0"):
            head.go_to(90.0, 0.0)
        servos.servos[1].put(POSITION, 4, 2048 + 569)
        with pytest.raises(
            GoalError, match=r"the head stands at pan 50\.0, tilt -?0\.0 deg, in the keep-out zone"
        ):
            head.go_to(90.0, 0.0)
        assert not servos.written(GOAL)


def test_a_head_that_lost_its_torque_during_a_move_is_set_up_again_and_continues(head, servos):
    slow(servos)

    def lose_power() -> None:
        servos.servos[1].registers[TORQUE] = 0
        servos.servos[1].speed_tick_s = 20_000.0

    threading.Timer(0.3 / SPEED, lose_power).start()
    with collecting() as notes:
        assert head.go_to(50.0, 0.0).pan_deg == pytest.approx(50.0, abs=0.1)
    assert any("lost its torque at" in note.problem for note in notes.all())


def test_an_alert_without_a_hardware_error_is_noted(head, servos, monkeypatch):
    monkeypatch.setattr(servos.servos[1], "false_alert", True)
    with collecting() as notes:
        assert head.go_to(5.0, 0.0).alerts == ()
    assert {note.problem for note in notes.all()} == {"raised its alert bit without a hardware error"}
