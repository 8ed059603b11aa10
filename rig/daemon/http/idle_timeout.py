"""Closes idle and slow connections; uvicorn waits without limit for a first request or the rest of one."""

import asyncio

from uvicorn.protocols.http.h11_impl import H11Protocol, RequestResponseCycle

MAX_WAITING = 48
"""Limit of open connections: beyond it the oldest idle or slow one is closed."""
STREAM_PATH = "/events"
"""The path of streams, which have their own limit (``rig.daemon.http.event_streams``)."""
REQUEST_TIMEOUT_S = 30.0
"""A connection without a complete request is closed after one to two times this. A stream is a continuing answer."""


class IdleTimeoutProtocol(H11Protocol):
    """uvicorn's HTTP/1.1 protocol with an idle timeout."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """A new connection: start its timeout."""
        super().connection_made(transport)
        self._since_s = self.loop.time()
        self._wait(None)
        there = [
            p for p in self.connections if isinstance(p, IdleTimeoutProtocol) and not p.transport.is_closing()
        ]
        if len(there) > MAX_WAITING:
            min(there, key=lambda each: each._eviction_priority(self)).transport.abort()

    def _eviction_priority(self, newest: "IdleTimeoutProtocol") -> tuple[int, float]:
        """Eviction order: lowest priority first, then oldest. A normal request takes only a moment."""
        if self is newest:
            claim = 4
        elif self.idle:
            claim = 0
        elif not self.cycle.response_started:  # the body is incomplete, or a wrong token is being delayed
            claim = 1
        else:
            claim = 3 if self.scope["path"] == STREAM_PATH else 2
        return claim, self._since_s

    @property
    def idle(self) -> bool:
        """Whether no request is being answered."""
        return self.cycle is None or self.cycle.response_complete

    def connection_lost(self, exc: Exception | None) -> None:
        """The connection is closed: stop its timeout."""
        self._waiting.cancel()
        super().connection_lost(exc)

    def _wait(self, answered: RequestResponseCycle | None) -> None:
        """``answered`` is the previous request, None if there was none."""
        self._waiting = self.loop.call_later(REQUEST_TIMEOUT_S, self._look, answered)

    def _look(self, answered: RequestResponseCycle | None) -> None:
        idle = self.idle
        if idle and self.cycle is answered:
            self.transport.close()
        else:
            self._wait(self.cycle if idle else None)
