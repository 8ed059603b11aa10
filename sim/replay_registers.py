"""What a servo answers to a read that no log holds: the registers that it leaves the factory with.

A driver asks more than it did when a log was recorded. Set-up that nobody asked for then cannot have mattered then.
"""

from collections.abc import Mapping

from sim.devices.dynamixel_packet import Instruction, RequestReader, status_packet
from sim.devices.register_table import RegisterTable
from sim.devices.x_series import MODELS

SET_UP_END = 104
"""Behind the last register of set-up; what lies beyond is commanded or measured."""


def factory_answer(data: bytes, models: Mapping[int, str]) -> bytes:
    """The status packets of servos, model by id, for the reads of set-up among the requests in ``data``."""
    answers = b""
    for request in RequestReader().feed(data):
        model = MODELS.get(models.get(request.servo_id, ""))
        if model is None or request.instruction != Instruction.READ or len(request.parameters) != 4:
            continue
        address, length = (int.from_bytes(request.parameters[i : i + 2], "little") for i in (0, 2))
        if 0 < length <= SET_UP_END - address:
            error, found = RegisterTable(model).read(address, length)
            answers += status_packet(request.servo_id, error, found)
    return answers
