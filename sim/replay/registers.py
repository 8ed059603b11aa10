"""Answers unrecorded reads of a servo's set-up registers with factory values.

Today's driver may read more registers than the one that recorded the log. Registers that were not read then did not
affect it.
"""

from collections.abc import Mapping

from sim.devices.dynamixel_packet import Instruction, Request, RequestReader, status_packet
from sim.devices.register_table import RegisterTable
from sim.devices.x_series import MODELS

SET_UP_END = 104
"""First address after the set-up registers; later ones are goals or measurements."""

RESERVED = frozenset((address, b"\x2c", 2) for address in (0x6A, 0x6B))
"""Address, bytes written and length of reads of a third axis, which an IIS2ICLX lacks: no acknowledge is correct."""


def factory_answer(data: bytes, models: Mapping[int, str]) -> bytes:
    """The status packets for the set-up reads among the requests in ``data``; ``models`` by id."""
    return b"".join(set_up_answer(request, models) for request in RequestReader().feed(data))


def set_up_answer(request: Request, models: Mapping[int, str]) -> bytes:
    """The status packet for one request; empty unless it is a set-up read of a known servo."""
    model = MODELS.get(models.get(request.servo_id, ""))
    if model is None or request.instruction != Instruction.READ or len(request.parameters) != 4:
        return b""
    address, length = (int.from_bytes(request.parameters[i : i + 2], "little") for i in (0, 2))
    if not 0 < length <= SET_UP_END - address:
        return b""
    error, found = RegisterTable(model).read(address, length)
    return status_packet(request.servo_id, error, found)
