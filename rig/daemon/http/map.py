"""The map's background: the DEM as shaded relief, drawn once by a separate process.

A separate process, as drawing takes some hundred megabytes of memory.
"""

import json
import subprocess
import sys
import threading
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from localizer.dem.choice import DemChoice
from rig.daemon.http.models import MapSheet
from rig.errors import RigError

DRAW_TIMEOUT_S = 300.0


class MapError(RigError):
    """The map cannot be drawn."""


@dataclass(frozen=True)
class Relief:
    """The picture (WebP) and its description."""

    sheet: MapSheet
    webp: bytes


class ReliefMap:
    """The relief, drawn at the first request; concurrent requests wait."""

    def __init__(self, dem: DemChoice | Sequence[Path]) -> None:
        self._dem = dem if isinstance(dem, DemChoice) else DemChoice(tuple(dem))
        self._drawing = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._ended = False
        self._relief: Relief | None = None

    def get(self) -> Relief:
        """The map. ``MapError`` if it cannot be drawn; the next request tries again."""
        with self._drawing:
            if self._relief is None:
                self._relief = self._draw()
            return self._relief

    def end(self) -> None:
        """Stop drawing; from any thread."""
        self._ended = True
        process = self._process
        if process is not None:
            process.kill()

    def _draw(self) -> Relief:
        command = [sys.executable, "-m", "rig.daemon.http.draw_relief", json.dumps(self._dem.to_fields())]
        with subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE
        ) as process:
            self._process = process
            if self._ended:
                process.kill()
            try:
                out, problem = process.communicate(timeout=DRAW_TIMEOUT_S)
            except subprocess.TimeoutExpired:
                process.kill()
                raise MapError(f"the map took longer than {DRAW_TIMEOUT_S:g} s to draw") from None
            finally:
                self._process = None
        if process.returncode != 0:
            lines = problem.decode(errors="replace").strip().splitlines()
            raise MapError(
                f"the map cannot be drawn: {lines[-1] if lines else f'status {process.returncode}'}"
            )
        head, webp = out.split(b"\n", 1)
        return Relief(MapSheet(**json.loads(head), image=f"/map/relief.webp?v={zlib.crc32(webp):08x}"), webp)
