"""Connections over which nothing is asked are given up; uvicorn waits for ever for a first question or the rest of one."""

import asyncio

from uvicorn.protocols.http.h11_impl import H11Protocol, RequestResponseCycle

MAX_WAITING = 48
"""So many connections may be open; one more, and the oldest of those that have asked nothing, or that are slow, goes."""
STREAM_PATH = "/events"
"""Where an answer goes on and on, and few are let in (``rig.daemon.http.event_streams``)."""
REQUEST_TIMEOUT_S = 30.0
"""Whoever has not put a whole question for so long, at most twice as long, is cut off. A stream is an answer that goes on."""


class IdleTimeoutProtocol(H11Protocol):
    """HTTP/1.1 as uvicorn speaks it, with an end to waiting for a question."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Somebody has come: wait for what is asked."""
        super().connection_made(transport)
        self._since_s = self.loop.time()
        self._wait(None)
        there = [
            p for p in self.connections if isinstance(p, IdleTimeoutProtocol) and not p.transport.is_closing()
        ]
        if len(there) > MAX_WAITING:
            min(there, key=lambda each: each._eviction_priority(self)).transport.abort()

    def _eviction_priority(self, newest: "IdleTimeoutProtocol") -> tuple[int, float]:
        """Who has the least claim to stay, and of these the oldest, goes first: a question is put and answered in a moment."""
        if self is newest:
            claim = 4
        elif self.idle:
            claim = 0
        elif not self.cycle.response_started:  # the body does not end, or a wrong token waits
            claim = 1
        else:
            claim = 3 if self.scope["path"] == STREAM_PATH else 2
        return claim, self._since_s

    @property
    def idle(self) -> bool:
        """Whether nothing is being answered."""
        return self.cycle is None or self.cycle.response_complete

    def connection_lost(self, exc: Exception | None) -> None:
        """There is nobody to wait for."""
        self._waiting.cancel()
        super().connection_lost(exc)

    def _wait(self, answered: RequestResponseCycle | None) -> None:
        """``answered`` is the question before, None where there was none."""
        self._waiting = self.loop.call_later(REQUEST_TIMEOUT_S, self._look, answered)

    def _look(self, answered: RequestResponseCycle | None) -> None:
        idle = self.idle
        if idle and self.cycle is answered:
            self.transport.close()
        else:
            self._wait(self.cycle if idle else None)
