"""Telemetry read back: to the end of a whole file, and as far as it goes in one that was cut off."""

import json
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from mcap.exceptions import McapError
from mcap.records import Channel, Footer, Message, Schema
from mcap.stream_reader import CRCValidationError, StreamReader
from mcap.writer import Writer

from localizer.os_errors import why_not_read, why_not_written
from rig.errors import RigError


class TelemetryReadError(RigError):
    """No telemetry can be read there."""


@dataclass(frozen=True)
class Logged:
    """One message as it is in the file."""

    channel: Channel
    schema: Schema | None
    message: Message

    @property
    def topic(self) -> str:
        """What it is about."""
        return str(self.channel.topic)

    def value(self) -> Any:
        """The JSON values."""
        return json.loads(self.message.data)


class TelemetryFile:
    """Messages in the order of the file. ``problem`` says after the last one why there are no more, None of a whole file.

    Streamed: a file that was cut off has no index to seek by.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.problem: str | None = None

    def __iter__(self) -> Iterator[Logged]:
        """Raises ``TelemetryReadError`` where the file cannot be read at all."""
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
            for record in StreamReader(file, validate_crcs=True, record_size_limit=2**30).records:
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
        except (McapError, CRCValidationError, struct.error, KeyError, UnicodeDecodeError) as error:
            if not channels:
                raise TelemetryReadError(
                    f"{self.path}: is no MCAP file, or ends before its first message"
                ) from error
            if not whole:
                self.problem = (
                    f"is cut off or damaged ({type(error).__name__}); what lies before has been read"
                )


def mend(source: Path, target: Path) -> int:
    """Write all messages that can be read into a new, whole, indexed file; how many there are."""
    count = 0
    try:
        with target.open("xb") as file:
            writer = Writer(file)
            writer.start(profile="", library="skyfix")
            channels: dict[int, int] = {}
            for logged in TelemetryFile(source):
                channel, schema, message = logged.channel, logged.schema, logged.message
                if channel.id not in channels:
                    schema_id = (
                        writer.register_schema(schema.name, schema.encoding, schema.data) if schema else 0
                    )
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
    except OSError as error:
        raise TelemetryReadError(f"{target}: {why_not_written(error, 'choose another name')}") from error
    except TelemetryReadError:
        target.unlink()
        raise
    return count
