"""What a servo answers to a read that no log holds: the registers that it leaves the factory with.

A driver asks more than it did when a log was recorded. Set-up that nobody asked for then cannot have mattered then.
"""

from collections.abc import Mapping

from sim.devices.dynamixel_packet import Instruction, Request, RequestReader, status_packet
from sim.devices.register_table import RegisterTable
from sim.devices.x_series import MODELS

SET_UP_END = 104
"""Behind the last register of set-up; what lies beyond is commanded or measured."""

RESERVED = frozenset((address, b"\x2c", 2) for address in (0x6A, 0x6B))
"""Address, written and length of reads of a third axis, which an IIS2ICLX does not have: no acknowledge is the right answer."""


def factory_answer(data: bytes, models: Mapping[int, str]) -> bytes:
    """The status packets of servos, model by id, for the reads of set-up among the requests in ``data``."""
    return b"".join(set_up_answer(request, models) for request in RequestReader().feed(data))


def set_up_answer(request: Request, models: Mapping[int, str]) -> bytes:
    """The status packet to one request; none where it is no read of set-up, or to no servo that is known."""
    model = MODELS.get(models.get(request.servo_id, ""))
    if model is None or request.instruction != Instruction.READ or len(request.parameters) != 4:
        return b""
    address, length = (int.from_bytes(request.parameters[i : i + 2], "little") for i in (0, 2))
    if not 0 < length <= SET_UP_END - address:
        return b""
    error, found = RegisterTable(model).read(address, length)
    return status_packet(request.servo_id, error, found)
