"""``/healthz``: liveness and readiness of the daemon, for supervisors and alarms."""

from fastapi import FastAPI
from starlette.responses import JSONResponse

from rig.daemon.heartbeat import Heartbeats
from rig.daemon.readiness import why_not_ready
from rig.daemon.state import DaemonState
from rig.version import __version__


def add_health(app: FastAPI, daemon_state: DaemonState, heartbeats: Heartbeats | None) -> None:
    """200 while all loops send heartbeats, 503 if one does not. Not being ready for a capture is no reason for a
    restart.
    """

    @app.get("/healthz", include_in_schema=False)
    async def healthz() -> JSONResponse:
        stalled = [str(each) for each in heartbeats.stalled()] if heartbeats else []
        problem = why_not_ready(daemon_state)
        body = {
            "alive": not stalled,
            "ready": not stalled and problem is None,
            "version": __version__,
            "problems": [*stalled, *([problem] if problem else [])],
        }
        return JSONResponse(body, 503 if stalled else 200)
