"""Writes the MCAP file in small chunks, in its own thread: a power cut loses at most the last chunk, and no caller
blocks.

A disk error ends the telemetry, not the session.
"""

import contextlib
import json
import os
import queue
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from mcap.writer import Writer

from localizer.os_errors import why_not_written
from rig import event_bus, timebase
from rig.atomic import make_folder, sync
from rig.config.model import RigConfig
from rig.devices.camera.frames import TimedFrame
from rig.errors import RigError
from rig.telemetry.messages import Message, messages_of, opening, time_ns

CHUNK_BYTES = 32_768  # about a second, which a power cut may lose
FRAME_EVERY_S = 0.5
SYNC_EVERY_S = 2.0
WAITING = 4000
END_S = 10.0


class TelemetryError(RigError):
    """The file cannot be created."""


@contextmanager
def recording_telemetry(path: Path, config: RigConfig) -> Iterator[Path]:
    """Record published objects into ``path`` while the context lasts; an existing name gets a number appended.

    Yields the file's path. Raises ``TelemetryError`` if it cannot be created.
    """
    path, file = _new_file(path)
    recorder = _Recorder(file, path, config)
    event_bus.subscribe(recorder.take)
    try:
        yield path
    finally:
        event_bus.unsubscribe(recorder.take)
        recorder.end()


class _Recorder:
    """Queues objects from any thread; its own thread converts and writes them."""

    def __init__(self, file: IO[bytes], path: Path, config: RigConfig) -> None:
        self._file, self._path = file, path
        self._waiting: queue.Queue[object] = queue.Queue(WAITING)
        self._end, self._failed = threading.Event(), False
        self._lost = 0
        self._last_frame_s = -FRAME_EVERY_S
        self._opening = opening(config)
        self._rig = config.rig.name
        self._thread = threading.Thread(target=self._run, name="telemetry", daemon=True)
        self._thread.start()

    def take(self, item: object) -> None:
        """Queue an item. Frames are limited to two a second: they are large, and meant for viewing only."""
        if self._failed:
            return
        if isinstance(item, TimedFrame):
            if item.arrived.monotonic_s - self._last_frame_s < FRAME_EVERY_S:
                return
            self._last_frame_s = item.arrived.monotonic_s
        try:
            self._waiting.put_nowait(item)
        except queue.Full:
            self._lost += 1

    def end(self) -> None:
        """Write the queue and finish the file."""
        self._end.set()
        self._thread.join(END_S)
        if self._lost and not self._failed:
            _say(f"{self._path}: {self._lost} messages lost: the disk is too slow")

    def _run(self) -> None:
        try:
            with self._file:
                self._write()
        except OSError as error:
            self._failed = True
            _say(f"{self._path}: cannot be written: {error.strerror}; the session goes on without telemetry")

    def _write(self) -> None:
        writer = Writer(self._file, chunk_size=CHUNK_BYTES)
        writer.start(profile="", library="skyfix")
        writer.add_metadata("skyfix", {"rig": self._rig})
        channels: dict[str, int] = {}
        counts: dict[str, int] = {}

        def write(message: Message) -> None:
            if message.topic not in channels:
                schema = writer.register_schema(
                    message.schema["title"], "jsonschema", json.dumps(message.schema).encode()
                )
                channels[message.topic] = writer.register_channel(message.topic, "json", schema)
            at_ns = time_ns(message.monotonic_s)
            stamp = {"sec": at_ns // 1_000_000_000, "nsec": at_ns % 1_000_000_000}
            counts[message.topic] = counts.get(message.topic, 0) + 1
            writer.add_message(
                channels[message.topic],
                log_time=at_ns,
                data=json.dumps({"timestamp": stamp, **message.fields}).encode(),
                publish_time=at_ns,
                sequence=counts[message.topic],
            )

        for message in self._opening:
            write(message)
        synced_s = timebase.monotonic_s()
        while not (self._end.is_set() and self._waiting.empty()):
            with contextlib.suppress(queue.Empty):
                for message in messages_of(self._waiting.get(timeout=0.1)):
                    write(message)
            if timebase.monotonic_s() - synced_s > SYNC_EVERY_S:
                synced_s = timebase.monotonic_s()
                self._sync()
        writer.finish()
        self._sync()

    def _sync(self) -> None:
        self._file.flush()
        os.fsync(self._file.fileno())


def _new_file(path: Path) -> tuple[Path, IO[bytes]]:
    for number in range(1, 10_000):
        name = path if number == 1 else path.with_name(f"{path.stem}-{number}{path.suffix}")
        try:
            make_folder(name.parent)
            file = name.open("xb")
            sync(name.parent)
            return name, file
        except FileExistsError:
            if name.parent.is_dir():
                continue
            raise TelemetryError(f"{path}: {name.parent} is no folder; choose another name") from None
        except OSError as error:
            raise TelemetryError(f"{path}: {why_not_written(error, 'choose another name')}") from error
    raise TelemetryError(f"{path}: is taken, and so are 9999 more names; clear up")


def _say(text: str) -> None:
    print(f"rig: {text}", file=sys.stderr)
