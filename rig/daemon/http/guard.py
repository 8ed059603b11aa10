"""Who is answered: names that are this machine's, and for what acts whoever shows the token.

A page on the Internet can have its own name resolve to a loopback address and then read this server through the crew's
browser. It cannot make the browser say another name than its own, so a name in ``Host`` has to be known; addresses are
no names. What acts wants the token in a header, which no page from elsewhere can send.
"""

import hmac
import ipaddress
import logging
import re
import socket
import stat
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Annotated

from fastapi import HTTPException, Security
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer
from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from rig.errors import ConfigError

_log = logging.getLogger(__name__)

LEAST_TOKEN = 16

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


class Guard:
    """Lets requests in that name this machine, and puts the security headers on all answers."""

    def __init__(self, app: ASGIApp, names: Iterable[str]) -> None:
        """``names``: those by which this machine may be asked, beside its own and all addresses."""
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
        )
        await refusal(scope, receive, send_guarded)

    def knows(self, host: str) -> bool:
        """Whether a ``Host`` header, with or without a port, names this machine or is any address."""
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
    """The token in a file, without the white space around it. ``ConfigError`` where it cannot be used."""
    where = f"[run.http] token_file {path}"
    try:
        token = path.read_text(encoding="ascii").strip()
        mode = path.stat().st_mode
    except OSError as error:
        raise ConfigError(f"{where}: {error.strerror}; make one with: openssl rand -hex 16") from error
    except UnicodeDecodeError:
        raise ConfigError(f"{where}: is not plain ASCII; make one with: openssl rand -hex 16") from None
    if len(token) < LEAST_TOKEN or not token.isprintable() or " " in token:
        raise ConfigError(
            f"{where}: holds no token: one word of {LEAST_TOKEN} characters or more; make one with: openssl rand -hex 16"
        )
    if mode & stat.S_IROTH:
        _log.warning("%s can be read by everybody: chmod o-r", where)
    return token


_bearer = HTTPBearer(auto_error=False, description="The content of [run.http] token_file.")


def token_check(token: str | None) -> Callable[[HTTPAuthorizationCredentials | None], None]:
    """What a path that acts depends on: 403 where there is no token to show, 401 for a wrong one."""

    def check(shown: Annotated[HTTPAuthorizationCredentials | None, Security(_bearer)]) -> None:
        if token is None:
            raise HTTPException(403, "nothing can be done over HTTP: [run.http] token_file is not configured")
        # bytes: a string that is not ASCII could not be compared
        if shown is None or not hmac.compare_digest(shown.credentials.encode(), token.encode()):
            raise HTTPException(
                401,
                "show the token: Authorization: Bearer TOKEN, as in [run.http] token_file",
                {"WWW-Authenticate": "Bearer"},
            )

    return check
