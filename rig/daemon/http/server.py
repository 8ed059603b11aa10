"""Runs uvicorn in a thread of the daemon, from the bound socket to the end of the last stream."""

import logging
import socket
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import uvicorn

from localizer.dem.choice import DemChoice
from rig.config.run import HttpServer
from rig.daemon.heartbeat import Heartbeats
from rig.daemon.http.access_control import read_token
from rig.daemon.http.app import make_app
from rig.daemon.http.bundles import BundleStore
from rig.daemon.http.event_streams import EventStreams
from rig.daemon.http.idle_timeout import IdleTimeoutProtocol
from rig.daemon.http.map import ReliefMap
from rig.daemon.sockets import why_not_listening
from rig.daemon.state import Actions, DaemonState
from rig.errors import RigError

_log = logging.getLogger(__name__)

MAX_REQUESTS = 512
"""Limit of requests, those included whose client has just gone: a delayed one notices that after a moment. Beyond it uvicorn
answers 503. Open connections have a lower limit (``rig.daemon.http.idle_timeout``)."""
STREAMS_END_S = 1
"""Time (whole seconds) for running requests at shutdown before they are cut off."""
STOP_S = 2.0
SILENT_S = 30
"""A connection without acknowledgements for this long is closed, such as that of a phone out of range."""


class HttpError(RigError):
    """The server cannot run at the configured address."""


@contextmanager
def serving(
    section: HttpServer,
    daemon_state: DaemonState,
    actions: Actions,
    spool: BundleStore,
    dem: DemChoice | Sequence[Path],
    heartbeats: Heartbeats | None = None,
) -> Iterator[str]:
    """Serve while the context lasts, and yield the URL; with port 0 the system chooses one. ``heartbeats`` receive its
    heartbeat.

    Raises ``ConfigError`` for a token that cannot be used, ``HttpError`` where the address is taken or not this machine's.
    """
    token = read_token(section.token_file) if section.token_file else None
    listening = _listen(section.listen)
    event_streams, relief = EventStreams(daemon_state), ReliefMap(dem)
    app = make_app(section, daemon_state, actions, spool, event_streams, relief, token, heartbeats)
    server = uvicorn.Server(
        uvicorn.Config(
            app,
            http=IdleTimeoutProtocol,
            ws="none",
            loop="asyncio",
            lifespan="on",
            log_config=None,
            log_level=logging.WARNING,
            access_log=False,
            proxy_headers=False,
            server_header=False,
            limit_concurrency=MAX_REQUESTS,
            timeout_graceful_shutdown=STREAMS_END_S,
        )
    )
    thread = threading.Thread(target=server.run, args=([listening],), name="http", daemon=True)
    thread.start()
    try:
        yield _url(listening)
    finally:
        event_streams.end()
        relief.end()
        server.should_exit = True
        thread.join(STOP_S)
        if thread.is_alive():
            _log.warning("the HTTP server did not end within %g s; it is left behind", STOP_S)
        listening.close()


def _listen(address: str) -> socket.socket:
    host, _, port = address.rpartition(":")
    host = host.strip("[]")
    try:
        family, kind, protocol, _, where = socket.getaddrinfo(host, int(port), type=socket.SOCK_STREAM)[0]
        listening = socket.socket(family, kind, protocol)
    except OSError as error:
        raise _refused(address, error) from error
    try:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        # each connection inherits it
        listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, SILENT_S * 1000)
        listening.bind(where)
        listening.listen()
    except OSError as error:
        listening.close()
        raise _refused(address, error) from error
    return listening


def _refused(address: str, error: OSError) -> HttpError:
    return HttpError(f"[run.http] listen {address}: {why_not_listening(error)}")


def _url(listening: socket.socket) -> str:
    host, port = listening.getsockname()[:2]
    return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"
