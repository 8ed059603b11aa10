"""``/healthz``: whether the daemon lives and could capture, in a few words, for whoever restarts or alarms."""

from fastapi import FastAPI
from starlette.responses import JSONResponse

from rig.daemon.heartbeat import Loops
from rig.daemon.readiness import obstacle
from rig.daemon.state import Board
from rig.version import package_version


def add_health(app: FastAPI, board: Board, loops: Loops | None) -> None:
    """200 while all of the daemon's loops get on, 503 where one does not. Not to be ready is no reason for a restart."""

    @app.get("/healthz", include_in_schema=False)
    async def healthz() -> JSONResponse:
        stuck = [str(each) for each in loops.stuck()] if loops else []
        hindrance = obstacle(board)
        told = {
            "alive": not stuck,
            "ready": not stuck and hindrance is None,
            "version": package_version(),
            "problems": [*stuck, *([hindrance] if hindrance else [])],
        }
        return JSONResponse(told, 503 if stuck else 200)
