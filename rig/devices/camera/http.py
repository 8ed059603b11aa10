"""HTTP requests to cameras, with the user and password of the address."""

import errno
import http.client
import socket
import ssl
import urllib.error
import urllib.parse
import urllib.request
from typing import Any

from rig.config.camera_url import without_secrets


def credentials(url: str) -> tuple[str, str | None, str | None]:
    """The URL without user and password, and these two decoded, None if absent. ``ValueError`` for an invalid URL."""
    parts = urllib.parse.urlsplit(url)
    _ = parts.port  # ValueError where it is no number
    user = urllib.parse.unquote(parts.username) if parts.username is not None else None
    password = urllib.parse.unquote(parts.password) if parts.password is not None else None
    return parts._replace(netloc=parts.netloc.rpartition("@")[2]).geturl(), user, password


class UnusableUrlError(OSError):
    """An HTTP request without a usable answer: the camera's behaviour, and what to do."""

    def __init__(self, problem: str, remedy: str) -> None:
        super().__init__(f"{problem}; {remedy}")
        self.problem, self.remedy = problem, remedy


def get(url: str, timeout_s: float, key: str) -> http.client.HTTPResponse:
    """The response to GET, redirects followed, with the URL's user and password (basic or digest).

    Raises ``UnusableUrlError``; ``key`` names the configuration key to correct.
    """
    try:
        plain, user, password = credentials(url)
        opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
        if user is not None:
            known = urllib.request.HTTPPasswordMgrWithDefaultRealm()
            known.add_password(None, plain, user, password or "")
            opener.add_handler(urllib.request.HTTPBasicAuthHandler(known))
            opener.add_handler(urllib.request.HTTPDigestAuthHandler(known))
        request = urllib.request.Request(plain, headers={"User-Agent": "skyfix"})
        answer: http.client.HTTPResponse = opener.open(request, timeout=timeout_s)
        return answer
    except urllib.error.HTTPError as error:
        with error:
            raise UnusableUrlError(*_by_status(error, user is not None, key)) from None
    except urllib.error.URLError as error:
        raise UnusableUrlError(*why_not_connected(error.reason, url, timeout_s, key)) from None
    except (OSError, http.client.HTTPException) as error:
        raise UnusableUrlError(*why_not_connected(error, url, timeout_s, key)) from None
    except ValueError:
        raise UnusableUrlError(
            "its URL is broken",
            f"correct {key}; write / : @ and ? in a password as %2F %3A %40 %3F",
        ) from None


def _by_status(error: urllib.error.HTTPError, had_user: bool, key: str) -> tuple[str, str]:
    status = error.code
    said = f"HTTP {status}"
    if status == 401:
        return missing_credentials(had_user, said, key)
    if status == 403:
        return (
            f"forbids it to this user ({said})",
            "give the user the right to watch, in the camera's own settings",
        )
    if status in (404, 410):
        return (
            f"is there, and has nothing at that address ({said})",
            f"correct the path in {key}; the camera's manual names it",
        )
    if 300 <= status < 400:
        return f"redirects without end ({said})", f"name the address that it leads to in {key}"
    if status == 503:
        return f"is busy ({said})", "end other programs that watch it, or restart it"
    if status >= 500:
        return f"has an error of its own ({said})", "restart it; see its own log"
    return (
        f"refuses the request ({said} {error.reason})",
        f"correct {key}; the camera's manual names the address",
    )


def missing_credentials(had_user: bool, said: str, key: str) -> tuple[str, str]:
    """Problem and remedy of a camera that requires authentication."""
    if had_user:
        return (
            f"does not accept the user and the password ({said})",
            f"correct them in {key}; write / : @ and ? in them as %2F %3A %40 %3F",
        )
    return (
        f"wants a user and a password ({said})",
        f"write them into {key}, before the host: //USER:PASSWORD@HOST",
    )


def why_not_connected(error: Any, url: str, timeout_s: float, key: str) -> tuple[str, str]:
    """Problem and remedy of a failed connection. ``error`` is an exception, or urllib's text."""
    try:
        parts = urllib.parse.urlsplit(url)
        host, port = parts.hostname or "", parts.port or {"https": 443, "rtsp": 554}.get(parts.scheme, 80)
    except ValueError:
        host, port = "", 0
    if isinstance(error, TimeoutError):
        return f"does not answer within {timeout_s:g} s", "see that it is on, and the network on the way"
    if isinstance(error, socket.gaierror):
        return f"the name {host!r} is not known", f"correct the host in {key}, or give its address"
    if isinstance(error, ssl.SSLError):
        return f"its certificate is not accepted ({error.reason})", f"use http, or correct the host in {key}"
    if isinstance(error, OSError):
        match error.errno:
            case errno.ECONNREFUSED:
                return (
                    f"the connection is refused: nothing listens on port {port} of {host}",
                    f"switch the camera's stream on, or correct the port in {key}",
                )
            case errno.EHOSTUNREACH | errno.ENETUNREACH | errno.ENETDOWN:
                return (
                    f"there is no way to {host} ({error.strerror})",
                    f"see the network, or correct the host in {key}",
                )
            case errno.ECONNRESET | errno.EPIPE:
                return (
                    "closed the connection at once",
                    f"correct the port or the scheme (http, https, rtsp) in {key}",
                )
    if isinstance(error, http.client.HTTPException):
        return (
            f"does not speak HTTP on port {port}",
            f"correct the port or the scheme (http, https, rtsp) in {key}",
        )
    return f"cannot be reached ({without_secrets(str(error), url)})", f"correct {key}"
