"""The memory of an X-series servo: fields by name for the servo, bytes by address for the bus."""

from sim.devices.dynamixel_packet import StatusError
from sim.devices.x_series import INDIRECT_BANKS, TABLE_SIZE, Field, ServoModel


class RegisterTable:
    """A control table with its indirect registers. It knows layout and bounds, not meaning."""

    def __init__(self, model: ServoModel) -> None:
        self._fields = {field.name: field for field in model.fields}
        self._field_at = {field.address: field for field in model.fields}
        self._defined = {address for field in model.fields for address in range(field.address, field.end)}
        self._defined |= {first + i for _, first, count in INDIRECT_BANKS for i in range(count)}
        self._memory = bytearray(TABLE_SIZE)
        for field in model.fields:
            self[field.name] = field.default

    def __contains__(self, name: str) -> bool:
        return name in self._fields

    def __getitem__(self, name: str) -> int:
        field = self._fields[name]
        return int.from_bytes(self._memory[field.address : field.end], "little", signed=field.signed)

    def __setitem__(self, name: str, value: int) -> None:
        field = self._fields[name]
        data = (value & ((1 << 8 * field.length) - 1)).to_bytes(field.length, "little")
        self._memory[field.address : field.end] = data

    def field(self, name: str) -> Field:
        """Where ``name`` is, and its bounds."""
        return self._fields[name]

    def reset(self, *, from_address: int = 0, keep: tuple[str, ...] = ()) -> None:
        """Reset all fields from an address on to their defaults."""
        for field in self._fields.values():
            if field.address >= from_address and field.name not in keep:
                self[field.name] = field.default

    def read(self, address: int, length: int) -> tuple[int, bytes]:
        """(error, data) of a read. It must begin at a field; gaps further on read as 0."""
        if length == 0 or address + length > TABLE_SIZE or address not in self._defined:
            return StatusError.ACCESS, b""
        return StatusError.NONE, bytes(
            self._memory[self._target(a)] for a in range(address, address + length)
        )

    def fields_of(self, address: int, data: bytes) -> tuple[int, list[tuple[Field, int]]]:
        """(error, fields and values) of a write. A partial field is a data length error."""
        bytes_at = [(self._target(address + offset), byte) for offset, byte in enumerate(data)]
        fields: list[tuple[Field, int]] = []
        while bytes_at:
            start = bytes_at[0][0]
            field = self._field_at.get(start)
            if field is None:
                return StatusError.ACCESS, []
            part, bytes_at = bytes_at[: field.length], bytes_at[field.length :]
            if [target for target, _ in part] != list(range(start, field.end)):
                return StatusError.DATA_LENGTH, []
            fields.append((field, int.from_bytes(bytes(b for _, b in part), "little", signed=field.signed)))
        return StatusError.NONE, fields

    def _target(self, address: int) -> int:
        """Resolved address: an indirect data register stands for the one that its address register names."""
        for first_address, first_data, count in INDIRECT_BANKS:
            if first_data <= address < first_data + count:
                pointer = first_address + 2 * (address - first_data)
                return int.from_bytes(self._memory[pointer : pointer + 2], "little")
        return address
