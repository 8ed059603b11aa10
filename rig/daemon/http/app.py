"""The FastAPI application with all paths."""

import asyncio
import re
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Annotated, Any

import anyio.to_thread
from fastapi import Depends, FastAPI, Header, HTTPException, Request
from fastapi.sse import EventSourceResponse, ServerSentEvent
from fastapi.staticfiles import StaticFiles
from prometheus_client import CONTENT_TYPE_LATEST, generate_latest
from starlette.responses import FileResponse, JSONResponse, Response

from localizer.errors import SkyfixError
from rig.clock import Instant
from rig.config.run import HttpServer
from rig.daemon.heartbeat import Heartbeats
from rig.daemon.http.access_control import HostCheck, token_check
from rig.daemon.http.bundles import NOT_FOUND, BundleStore, Limit, bundle_routes
from rig.daemon.http.event_streams import EventStreams, Stream, TooManyStreamsError
from rig.daemon.http.health import add_health
from rig.daemon.http.map import ReliefMap
from rig.daemon.http.metrics import metrics_registry
from rig.daemon.http.models import (
    TRIGGER_PROBLEM,
    TRIGGER_STATUS,
    CaptureAnswer,
    FixAnswer,
    LogEvent,
    MapSheet,
    Problem,
    State,
    TrackPoint,
    fix_answer,
    log_event,
    state_of,
    track_point,
)
from rig.daemon.http.request_limits import RequestLimits
from rig.daemon.publish.published import newest_answer
from rig.daemon.readiness import why_not_ready_in_full
from rig.daemon.state import Actions, DaemonState
from rig.version import __version__

PAGE = Path(__file__).parent / "page"
MAX_THREADS = 8
"""Threads for requests that read the disk; one picture each is enough for the page."""
LOOP, BEAT_S, MAX_INTERVAL_S = "http", 2.0, 30.0
DESCRIPTION = (
    "Where the vehicle is, and how that is known. Reading is open to whoever reaches the server; what acts wants the "
    "token. An answer is of the moment of its capture: see age_s and current before using one."
)

TROUBLE: dict[int | str, dict[str, Any]] = {
    503: {"model": Problem, "description": "Not now: the spool or the map cannot be read."}
}


def make_app(
    section: HttpServer,
    daemon_state: DaemonState,
    actions: Actions,
    spool: BundleStore,
    event_streams: EventStreams,
    relief: ReliefMap,
    token: str | None,
    heartbeats: Heartbeats | None = None,
) -> FastAPI:
    """Build the application. It uses only what is passed in."""

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        anyio.to_thread.current_default_thread_limiter().total_tokens = MAX_THREADS
        async with event_streams.running(), _sending_heartbeats(heartbeats):
            yield

    app = FastAPI(
        title="skyfix",
        version=__version__,
        description=DESCRIPTION,
        lifespan=lifespan,
        docs_url=None,
        redoc_url=None,
    )
    app.add_middleware(RequestLimits)
    app.add_middleware(HostCheck, names=section.names)
    _add_state(app, section, daemon_state, token is not None)
    add_health(app, daemon_state, heartbeats)
    _add_events(app, event_streams)
    _add_actions(app, actions, daemon_state, token)
    _add_map(app, spool, relief)
    app.include_router(bundle_routes(spool), responses=TROUBLE)
    registry = metrics_registry(daemon_state, event_streams)

    @app.get(
        "/metrics", tags=["state"], response_class=Response, responses={200: {"content": {"text/plain": {}}}}
    )
    async def metrics() -> Response:
        """For Prometheus."""
        return Response(generate_latest(registry), media_type=CONTENT_TYPE_LATEST)

    @app.exception_handler(SkyfixError)
    async def expected(_: Request, error: SkyfixError) -> JSONResponse:
        return JSONResponse({"detail": str(error)}, 503)

    @app.get("/", include_in_schema=False)
    async def page() -> FileResponse:
        return FileResponse(PAGE / "index.html", headers={"Cache-Control": "no-cache"})

    app.mount("/page", _Page(directory=PAGE))
    return app


@asynccontextmanager
async def _sending_heartbeats(heartbeats: Heartbeats | None) -> AsyncIterator[None]:
    """Send heartbeats for the server's loop while the context lasts."""
    if heartbeats is None:
        yield
        return

    async def beat() -> None:
        while True:
            heartbeats.beat(LOOP)
            await asyncio.sleep(BEAT_S)

    with heartbeats.watched(LOOP, MAX_INTERVAL_S):
        beating = asyncio.create_task(beat())
        try:
            yield
        finally:
            beating.cancel()


class _Page(StaticFiles):
    """The page's files, revalidated by the browser at each use."""

    def file_response(self, *args: Any, **kwargs: Any) -> Response:
        response = super().file_response(*args, **kwargs)
        response.headers["Cache-Control"] = "no-cache"
        return response


def _add_state(app: FastAPI, section: HttpServer, daemon_state: DaemonState, can_act: bool) -> None:
    @app.get("/fix", tags=["state"], responses=NOT_FOUND)
    async def fix() -> FixAnswer:
        """The answer to the newest capture, whatever its status, with its age; 404 as long as there is none.

        Where that is no fix, ``last_fix`` is the last one, with its own age.
        """
        snapshot = daemon_state.snapshot()
        last = newest_answer(snapshot)
        if last is None:
            raise HTTPException(404, "no answer yet: nothing has been located")
        return fix_answer(last, snapshot, section.valid_s, Instant.now())

    @app.get("/status", tags=["state"])
    async def status() -> State:
        """Everything at this moment: devices, activity, the latest answer and the latest fix."""
        return state_of(daemon_state.snapshot(), section.valid_s, can_act, Instant.now())


def _add_events(app: FastAPI, event_streams: EventStreams) -> None:
    async def stream() -> AsyncIterator[Stream]:
        try:
            with event_streams.stream() as waiting:
                yield waiting
        except TooManyStreamsError:
            raise HTTPException(503, "too many readers of events", {"Retry-After": "5"}) from None

    @app.get(
        "/events",
        tags=["events"],
        response_class=EventSourceResponse,
        responses={503: {"model": Problem, "description": "Too many read them already."}},
    )
    async def events(
        waiting: Annotated[Stream, Depends(stream)],
        last_event_id: Annotated[str | None, Header()] = None,
    ) -> AsyncIterator[ServerSentEvent]:
        """Server-sent events as they happen, each a JSON object (as in /log); a comment where nothing does.

        Begins with what was missed since ``Last-Event-ID``; without it with the latest answer, if there is one.
        """
        yield ServerSentEvent(comment="skyfix", retry=3000)
        last_sent = -1
        number = re.fullmatch(r"[0-9]{1,18}", last_event_id or "")  # anything else is not an id of ours
        for event in event_streams.initial_events(int(number[0]) if number else None):
            last_sent = event.number
            yield ServerSentEvent(data=log_event(event), event=event.kind, id=str(event.number))
        while (event_or_end := await waiting.get()) is not None:
            event = event_or_end
            if event.number > last_sent:
                yield ServerSentEvent(data=log_event(event), event=event.kind, id=str(event.number))

    @app.get("/log", tags=["events"])
    async def log() -> list[LogEvent]:
        """The last events, oldest first."""
        return [log_event(event) for event in event_streams.recent()]


def _add_actions(app: FastAPI, actions: Actions, daemon_state: DaemonState, token: str | None) -> None:
    @app.post(
        "/capture",
        tags=["actions"],
        status_code=202,
        dependencies=[Depends(token_check(token, daemon_state.count))],
        responses={
            401: {
                "model": Problem,
                "description": "The token is missing or wrong; a wrong one is answered late.",
            },
            403: {"model": Problem, "description": "No token is configured."},
            409: {"model": Problem, "description": "A capture is going on."},
            503: {
                "model": Problem,
                "description": "A device or room in the spool is missing, or the daemon ends.",
            },
        },
    )
    def capture() -> CaptureAnswer:
        """Begin a capture. One at a time, and nothing is queued."""
        answer = actions.trigger("http")
        if answer != "started":
            why = f": {why_not_ready_in_full(daemon_state)}" if answer == "not ready" else ""
            raise HTTPException(TRIGGER_STATUS[answer], f"{TRIGGER_PROBLEM[answer]}{why}")
        return CaptureAnswer(answer=answer)


def _add_map(app: FastAPI, spool: BundleStore, relief: ReliefMap) -> None:
    @app.get("/map", tags=["map"], responses=TROUBLE)
    def sheet() -> MapSheet:
        """What the map shows. The first to ask waits until it is drawn."""
        return relief.get().sheet

    @app.get(
        "/map/relief.webp",
        tags=["map"],
        response_class=Response,
        responses={200: {"content": {"image/webp": {}}}, **TROUBLE},
    )
    def picture() -> Response:
        """The DEM as shaded relief."""
        return Response(
            relief.get().webp, media_type="image/webp", headers={"Cache-Control": "private, max-age=3600"}
        )

    @app.get("/track", tags=["map"], responses=TROUBLE)
    def track(limit: Limit = 100) -> list[TrackPoint]:
        """The fixes among the newest bundles, oldest first. What was ambiguous or none is no part of a track."""
        points = [track_point(entry) for entry in spool.entries(limit)]
        return [point for point in reversed(points) if point is not None]
