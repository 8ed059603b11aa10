"""Passes events of the daemon state from its threads to the server's streams; keeps the last ones for new streams."""

import asyncio
import threading
from collections import deque
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager

from rig.daemon.state import DaemonState, Event

MAX_STREAMS = 16
EVENTS_KEPT = 200
QUEUE_LENGTH = 256
POLL_S = 0.1

Stream = asyncio.Queue[Event | None]


class TooManyStreamsError(Exception):
    """The limit of streams is reached."""


class EventStreams:
    """One subscription for all streams. A stream that does not keep up is ended; its client has to reconnect."""

    def __init__(self, daemon_state: DaemonState) -> None:
        self._state = daemon_state
        self._recent: deque[Event] = deque(maxlen=EVENTS_KEPT)
        self._streams: set[Stream] = set()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._ended = threading.Event()

    @asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        """Pass events to the streams of the running event loop while the context lasts."""
        self._loop = asyncio.get_running_loop()
        thread = threading.Thread(target=self._relay, name="http-events", daemon=True)
        thread.start()
        try:
            yield
        finally:
            self._ended.set()
            await asyncio.to_thread(thread.join)

    def end(self) -> None:
        """End all streams, now and later; from any thread."""
        self._ended.set()

    def recent(self) -> list[Event]:
        """The last events, oldest first."""
        return list(self._recent)

    def initial_events(self, last_number: int | None) -> list[Event]:
        """The first events of a new stream: those since its client's last event, as far as they are kept.

        For a client without a last event, or with one of before a restart: the latest answer.
        """
        recent = self.recent()
        if last_number is not None and recent and last_number <= recent[-1].number:
            return [event for event in recent if event.number > last_number]
        return [event for event in recent if event.kind == "answer"][-1:]

    @property
    def streams(self) -> int:
        """Number of open streams."""
        return len(self._streams)

    @contextmanager
    def stream(self) -> Iterator[Stream]:
        """Events from now on, None at the end; called in the event loop. ``TooManyStreamsError`` beyond
        ``MAX_STREAMS``.
        """
        if len(self._streams) >= MAX_STREAMS:
            raise TooManyStreamsError
        stream: Stream = asyncio.Queue(QUEUE_LENGTH)
        self._streams.add(stream)
        if self._ended.is_set():
            stream.put_nowait(None)
        try:
            yield stream
        finally:
            self._streams.discard(stream)

    def _relay(self) -> None:
        assert self._loop is not None
        with self._state.subscribed() as subscription:
            while not self._ended.is_set():
                event = subscription.get(POLL_S)
                if event is not None:
                    self._loop.call_soon_threadsafe(self._distribute, event)
        self._loop.call_soon_threadsafe(self._end_streams)

    def _distribute(self, event: Event) -> None:
        self._recent.append(event)
        for stream in tuple(self._streams):
            if stream.full():
                self._end_stream(stream)
            else:
                stream.put_nowait(event)

    def _end_streams(self) -> None:
        for stream in tuple(self._streams):
            self._end_stream(stream)

    def _end_stream(self, stream: Stream) -> None:
        self._streams.discard(stream)
        if stream.full():
            stream.get_nowait()
        stream.put_nowait(None)
