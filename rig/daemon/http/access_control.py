"""Access control: accepts ``Host`` names of this machine only, and requires the token for actions.

DNS rebinding: a page on the Internet can make its name resolve to a loopback address and read this server through the
crew's browser. The browser still sends the page's own name as ``Host``, so unknown names are rejected; addresses are
accepted. Actions require the token in a header, which a page of another origin cannot send.
"""

import asyncio
import hmac
import ipaddress
import logging
import math
import re
import socket
import stat
import time
from collections.abc import Awaitable, Callable, Iterable
from pathlib import Path
from typing import Annotated

from fastapi import HTTPException, Request, Security
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer
from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from localizer.documents import DocumentError, read_file
from rig.errors import ConfigError

_log = logging.getLogger(__name__)

MIN_TOKEN = 16
MAX_TOKEN_BYTES = 4096
FIRST_DELAY_S, LONGEST_DELAY_S = 0.1, 3.0
"""Delay of the answer to a wrong token; it doubles with each one."""
LONGEST_WAIT_S = 15.0
"""Limit of the delay, including that of queued requests."""
DISCONNECT_POLL_S = 0.25
DELAY_RESET_S = 60.0
LOG_EVERY_S = 60.0

HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Permissions-Policy": "camera=(), geolocation=(), microphone=()",
}


class HostCheck:
    """Middleware: rejects requests with a foreign ``Host``, and adds the security headers to all answers."""

    def __init__(self, app: ASGIApp, names: Iterable[str]) -> None:
        """``names``: accepted names in addition to the machine's own and all addresses."""
        own = socket.gethostname().lower()
        self._app = app
        self._names = {"localhost", own, own.split(".")[0] + ".local", *(name.lower() for name in names)}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return

        async def send_guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    headers[name] = value
                headers.setdefault("Cache-Control", "no-store")
            await send(message)

        hosts = Headers(scope=scope).getlist("host")
        if len(hosts) == 1 and self.knows(hosts[0]):
            await self._app(scope, receive, send_guarded)
            return
        asked = repr(hosts[0][:80]) if len(hosts) == 1 else f"{len(hosts)} names"
        refusal = PlainTextResponse(
            f"asked as {asked}, which is not known here: use the address, or add the name to [run.http] names\n",
            status_code=421,
            headers={"Connection": "close"},  # otherwise an unchecked body would be read
        )
        await refusal(scope, receive, send_guarded)

    def knows(self, host: str) -> bool:
        """Whether a ``Host`` header, with or without port, is a name of this machine or an address."""
        matched = re.fullmatch(r"(\[[0-9a-fA-F:.]+\]|[^:\[\]\s]+)(:\d{1,5})?", host)
        if not matched:
            return False
        name = matched[1].strip("[]").lower().removesuffix(".")
        if name in self._names:
            return True
        try:
            ipaddress.ip_address(name)
        except ValueError:
            return False
        return True


def read_token(path: Path) -> str:
    """The token in a file, white space stripped. ``ConfigError`` if it cannot be used."""
    where = f"[run.http] token_file {path}"
    try:
        token = read_file(path, MAX_TOKEN_BYTES).decode("ascii").strip()
        mode = path.stat().st_mode
    except DocumentError as error:
        raise ConfigError(f"{where}: {error}; make one with: openssl rand -hex 16") from error
    except OSError as error:
        raise ConfigError(f"{where}: {error.strerror}; make one with: openssl rand -hex 16") from error
    except UnicodeDecodeError:
        raise ConfigError(f"{where}: is not plain ASCII; make one with: openssl rand -hex 16") from None
    if len(token) < MIN_TOKEN or not token.isprintable() or " " in token:
        raise ConfigError(
            f"{where}: holds no token: one word of {MIN_TOKEN} characters or more; make one with: openssl rand -hex 16"
        )
    if mode & stat.S_IROTH:
        _log.warning("%s can be read by everybody: chmod o-r", where)
    return token


Check = Callable[[Request, HTTPAuthorizationCredentials | None], Awaitable[None]]
_bearer = HTTPBearer(auto_error=False, description="The content of [run.http] token_file.")


class _WrongTokens:
    """Wrong tokens: increasing delays, one request at a time, and a rate-limited log line."""

    def __init__(self) -> None:
        self._recent = 0
        self._last_s = self._logged_s = self._next_s = -math.inf
        self._unlogged = 0

    async def wrong(self, request: Request) -> None:
        """Wait while the client is connected, and perhaps log: clients that left must not delay others."""
        now_s = time.monotonic()
        if now_s - self._last_s > DELAY_RESET_S:
            self._recent = 0
        self._recent, self._last_s, self._unlogged = self._recent + 1, now_s, self._unlogged + 1
        if now_s - self._logged_s > LOG_EVERY_S:
            address = request.client.host if request.client else "an unknown address"
            _log.warning(
                "wrong token over HTTP from %s; %d since the last such line", address, self._unlogged
            )
            self._logged_s, self._unlogged = now_s, 0
        delay_s = min(FIRST_DELAY_S * 2.0 ** min(self._recent - 1, 10), LONGEST_DELAY_S)
        self._next_s = min(max(self._next_s, now_s) + delay_s, now_s + LONGEST_WAIT_S)
        until_s = self._next_s
        while (left_s := until_s - time.monotonic()) > 0.0 and not await request.is_disconnected():
            await asyncio.sleep(min(left_s, DISCONNECT_POLL_S))


def token_check(token: str | None, count: Callable[[str], None] = lambda what: None) -> Check:
    """Dependency of paths with an action: 403 without a configured token, 401 for a missing or a wrong one.

    A wrong token is answered late, the right one at once: guessing does not lock out others. ``count`` is called for
    wrong ones.
    """
    guesses = _WrongTokens()

    async def check(
        request: Request, shown: Annotated[HTTPAuthorizationCredentials | None, Security(_bearer)]
    ) -> None:
        if token is None:
            raise HTTPException(403, "nothing can be done over HTTP: [run.http] token_file is not configured")
        # bytes: non-ASCII strings cannot be compared
        if shown is None or not hmac.compare_digest(shown.credentials.encode(), token.encode()):
            if shown is not None:
                count("wrong tokens")
                await guesses.wrong(request)
            raise HTTPException(
                401,
                "show the token: Authorization: Bearer TOKEN, as in [run.http] token_file",
                {"WWW-Authenticate": "Bearer"},
            )

    return check
