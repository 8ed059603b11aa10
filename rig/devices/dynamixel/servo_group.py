"""Several servos of one bus: their states in one read, and the check that each is there and of the configured model."""

from collections.abc import Mapping, Sequence

from rig import timebase
from rig.devices.dynamixel import control_table as table
from rig.devices.dynamixel.servo import STATE_ADDRESS, STATE_LENGTH, Servo, ServoState
from rig.devices.dynamixel.servo_bus import ServoBus
from rig.errors import TransientError, WrongDeviceError


def read_states(bus: ServoBus, servos: Sequence[Servo]) -> list[ServoState]:
    """The states of all servos, in order, with one sync read.

    Raises ``TransientError`` naming every servo that did not answer.
    """
    statuses = bus.sync_read([servo.servo_id for servo in servos], STATE_ADDRESS, STATE_LENGTH)
    now_s = timebase.monotonic_s()
    silent = [servo.name for servo in servos if servo.servo_id not in statuses]
    if silent:
        raise TransientError(" and ".join(silent), "no valid answer", "check power and the servo cable")
    return [
        servo.decode_state(statuses[servo.servo_id].parameters, statuses[servo.servo_id].alert, now_s)
        for servo in servos
    ]


def require_models(bus: ServoBus, expected: Mapping[int, str]) -> dict[int, int]:
    """Firmware versions by servo id, if every servo is present and of the expected model.

    Raises ``WrongDeviceError`` for another model, ``TransientError`` for a silent one; both list expected and found for
    each id.
    """
    found: dict[int, tuple[int, int]] = {}
    for servo_id in expected:
        try:
            found[servo_id] = bus.ping(servo_id)
        except TransientError:
            continue  # it is listed as silent below
    wrong = [i for i, (number, _) in found.items() if number != table.MODEL_NUMBERS[expected[i]]]
    if wrong or len(found) < len(expected):
        old = [i for i in expected if i not in found and bus.answers_protocol_1(i)]
        absent = {i: "a servo set to Protocol 1.0" if i in old else "no answer" for i in expected}
        problem = f"expected {_list(expected)}, found " + _list(
            {i: _model_name(found[i][0]) if i in found else absent[i] for i in expected}
        )
        device = f"servo bus {bus.path} at {bus.baud} baud"
        if wrong:
            raise WrongDeviceError(device, problem, "correct `id` and `model`")
        if old:
            raise WrongDeviceError(
                device, problem, "set its Protocol Type (register 13) to 2 with Dynamixel Wizard"
            )
        raise TransientError(device, problem, "check servo power, cable, `id` and `baud`")
    return {servo_id: firmware for servo_id, (_, firmware) in found.items()}


def _list(by_id: Mapping[int, str]) -> str:
    return ", ".join(f"id {servo_id}: {what}" for servo_id, what in by_id.items())


def _model_name(number: int) -> str:
    names = {number: name for name, number in table.MODEL_NUMBERS.items()}
    return names.get(number, f"model number {number}")
