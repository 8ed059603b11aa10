"""Reads telemetry files: whole ones to the end, truncated ones as far as they are readable."""

import dataclasses
import os
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import lz4.frame
import zstandard
from mcap.exceptions import McapError
from mcap.records import Channel, Chunk, Footer, McapRecord, Message, Schema
from mcap.stream_reader import CRCValidationError, StreamReader, breakup_chunk
from mcap.writer import Writer

from localizer.documents import json_values
from localizer.os_errors import why_not_read, why_not_written
from rig.atomic import sync
from rig.errors import RigError

MAX_RECORD_BYTES = 64_000_000
"""Of one record, or of one uncompressed chunk; rig's own chunks have a megabyte."""
MAX_WINDOW_BYTES = 1 << 27
_DAMAGED = (
    McapError,
    CRCValidationError,
    struct.error,
    KeyError,
    ValueError,
    OverflowError,
    RuntimeError,  # of lz4
    zstandard.ZstdError,
)


class TelemetryReadError(RigError):
    """The file is no readable telemetry."""


@dataclass(frozen=True)
class Logged:
    """One message as stored in the file."""

    channel: Channel
    schema: Schema | None
    message: Message

    @property
    def topic(self) -> str:
        """The message's topic."""
        return str(self.channel.topic)

    def value(self) -> Any:
        """The JSON values."""
        return json_values(self.message.data)


class TelemetryFile:
    """Messages in file order. After the last one ``problem`` says why reading stopped, None for a whole file.

    Read as a stream: a truncated file has no index.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.problem: str | None = None

    def __iter__(self) -> Iterator[Logged]:
        """Raises ``TelemetryReadError`` if the file cannot be read at all."""
        try:
            with self.path.open("rb") as file:
                yield from self._messages(file)
        except OSError as error:
            raise TelemetryReadError(f"{self.path}: {why_not_read(error, self.path)}") from error

    def _messages(self, file: IO[bytes]) -> Iterator[Logged]:
        channels: dict[int, Channel] = {}
        schemas: dict[int, Schema] = {}
        whole = False
        try:
            for record in _records(file):
                match record:
                    case Schema():
                        schemas[record.id] = record
                    case Channel():
                        channels[record.id] = record
                    case Message():
                        channel = channels[record.channel_id]
                        yield Logged(channel, schemas.get(channel.schema_id), record)
                    case Footer():
                        whole = True
        except _DAMAGED as error:
            if not channels:
                raise TelemetryReadError(
                    f"{self.path}: is no MCAP file, or ends before its first message"
                ) from error
            if not whole:
                self.problem = (
                    f"is cut off or damaged ({type(error).__name__}); what lies before has been read"
                )


def _records(file: IO[bytes]) -> Iterator[McapRecord]:
    """All records, including those in chunks. The uncompressed size of a chunk is limited before it is decompressed.

    ``StreamReader`` alone trusts a chunk's stated size, and has no limit for lz4.
    """
    bounded: Any = _Bounded(file)
    for record in StreamReader(
        bounded, emit_chunks=True, validate_crcs=True, record_size_limit=MAX_RECORD_BYTES
    ).records:
        if not isinstance(record, Chunk):
            yield record
            continue
        data = _unpacked(record.compression, record.data)
        plain = dataclasses.replace(record, compression="", data=data, uncompressed_size=len(data))
        yield from breakup_chunk(plain, validate_crc=True)


def _unpacked(compression: str, data: bytes) -> bytes:
    if compression == "zstd":
        unpacker = zstandard.ZstdDecompressor(max_window_size=MAX_WINDOW_BYTES)
        unpacked = unpacker.stream_reader(data).read(MAX_RECORD_BYTES + 1)
    elif compression == "lz4":
        unpacked = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=MAX_RECORD_BYTES + 1)
    else:
        unpacked = data
    if len(unpacked) > MAX_RECORD_BYTES:
        raise ValueError(f"a chunk of more than {MAX_RECORD_BYTES / 1e6:g} MB")
    return bytes(unpacked)


class _Bounded:
    """A file whose reads are limited to the largest record, whatever length is requested."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file

    def read(self, size: int = -1) -> bytes:
        if not 0 <= size <= MAX_RECORD_BYTES:
            raise ValueError("a length beyond all records")
        return self._file.read(size)


def mend(source: Path, target: Path) -> int:
    """Copy all readable messages into a new, complete, indexed file; returns their number."""
    count = 0
    try:
        with target.open("xb") as file:
            try:
                count = _copied(source, file)
                file.flush()
                os.fsync(file.fileno())
            except BaseException:
                target.unlink()
                raise
        sync(target.parent)
    except OSError as error:
        raise TelemetryReadError(f"{target}: {why_not_written(error, 'choose another name')}") from error
    return count


def _copied(source: Path, file: IO[bytes]) -> int:
    count = 0
    writer = Writer(file)
    writer.start(profile="", library="skyfix")
    channels: dict[int, int] = {}
    for logged in TelemetryFile(source):
        channel, schema, message = logged.channel, logged.schema, logged.message
        if channel.id not in channels:
            schema_id = writer.register_schema(schema.name, schema.encoding, schema.data) if schema else 0
            channels[channel.id] = writer.register_channel(
                channel.topic, channel.message_encoding, schema_id, channel.metadata
            )
        writer.add_message(
            channels[channel.id],
            log_time=message.log_time,
            data=message.data,
            publish_time=message.publish_time,
            sequence=message.sequence,
        )
        count += 1
    writer.finish()
    return count
