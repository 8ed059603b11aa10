"""Limits of size and time for request bodies; and HEAD for all paths with GET.

uvicorn accepts bodies of any size and duration, and FastAPI answers HEAD only where a path declares it
(https://github.com/Kludex/starlette/issues/890, https://github.com/fastapi/fastapi/issues/1773).
"""

import asyncio

import anyio
from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

MAX_BODY_BYTES = 65_536
BODY_TIMEOUT_S = 10.0
"""For the whole body, in however many parts."""


class _TooLargeError(Exception):
    """The body is larger than the limit."""


class RequestLimits:
    """Middleware: reads the body before the application runs; 413 if too large, 408 if too slow."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        if "content-length" in headers or "transfer-encoding" in headers:
            try:
                body = await asyncio.wait_for(_body(headers, receive), BODY_TIMEOUT_S)
            except _TooLargeError:
                await _end(
                    413, f"a body of more than {MAX_BODY_BYTES} bytes is not taken", scope, receive, send
                )
                return
            except TimeoutError:
                await _end(408, f"the body did not end within {BODY_TIMEOUT_S:g} s", scope, receive, send)
                return
            if body is None:  # whoever asked has gone
                return
            receive = _replayed_body(body, receive)
        if scope["method"] == "HEAD":
            await self._without_body({**scope, "method": "GET"}, receive, send)
        else:
            await self._app(scope, receive, _with_head_allowed(send))

    async def _without_body(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer as GET, with status and headers only; a streaming answer is ended."""
        with anyio.CancelScope() as going_on:

            async def send_head(message: Message) -> None:
                if message["type"] == "http.response.start":
                    await send(message)
                elif not going_on.cancel_called:
                    await send({"type": "http.response.body", "body": b"", "more_body": False})
                    going_on.cancel()

            await self._app(scope, receive, send_head)


async def _body(headers: Headers, receive: Receive) -> bytes | None:
    """The whole body; None if the connection was lost. The stated length is checked first."""
    claimed = headers.get("content-length", "0")
    if not claimed.isdecimal() or len(claimed) > 12 or int(claimed) > MAX_BODY_BYTES:
        raise _TooLargeError
    body = b""
    while True:
        message = await receive()
        if message["type"] == "http.disconnect":
            return None
        body += bytes(message.get("body", b""))
        if len(body) > MAX_BODY_BYTES:
            raise _TooLargeError
        if not message.get("more_body", False):
            return body


def _replayed_body(body: bytes, receive: Receive) -> Receive:
    """The body as one message, followed by the connection's messages."""
    said = False

    async def receive_again() -> Message:
        nonlocal said
        if said:
            return await receive()
        said = True
        return {"type": "http.request", "body": body, "more_body": False}

    return receive_again


def _with_head_allowed(send: Send) -> Send:
    """Add HEAD to the allowed methods wherever GET is allowed."""

    async def send_allowed(message: Message) -> None:
        if message["type"] == "http.response.start" and message["status"] == 405:
            headers = MutableHeaders(scope=message)
            allowed = headers.get("allow", "")
            if "GET" in allowed and "HEAD" not in allowed:
                headers["allow"] = f"{allowed}, HEAD"
        await send(message)

    return send_allowed


async def _end(status: int, why: str, scope: Scope, receive: Receive, send: Send) -> None:
    """Answer and close the connection: otherwise the rest of the body would be read and discarded."""
    await JSONResponse({"detail": why}, status, headers={"Connection": "close"})(scope, receive, send)
