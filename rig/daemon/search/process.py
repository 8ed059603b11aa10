"""The search process, from the daemon's side: start, requests, limits of time and memory, end."""

import json
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from localizer.dem.choice import DemChoice
from localizer.track.document import TrackLine
from localizer.track.odometry import Movement
from localizer.track.tracker import Tracker
from rig.daemon.spool.index import leg_json
from rig.devices.bus.deadline import Deadline
from rig.errors import RigError

WORKER = (sys.executable, "-X", "faulthandler", "-m", "rig.daemon.search.worker")
STARTING_S = 1200.0
"""The first start compiles the kernels, which takes many minutes on a small computer."""
POLL_S = 0.1
_PAGE_BYTES = os.sysconf("SC_PAGE_SIZE")


class SearchFailedError(RigError):
    """A search failed: it crashed, exceeded memory or time, or the bundle cannot be read."""


@dataclass(frozen=True)
class CaptureInfo:
    """From the bundle itself: time of the last frame on both clocks, and the vehicle's heading then."""

    utc: str
    monotonic_s: float | None
    heading_deg: float | None
    mounting_sigmas_deg: tuple[float, ...]


@dataclass(frozen=True)
class SearchResult:
    """The result of a search."""

    track: TrackLine
    tracker: Tracker
    altitude_m: float | None
    azimuth_bias_sigma_deg: float | None
    capture_info: CaptureInfo
    wgs84_accuracy_m: float = 0.0
    """Accuracy of the transformation from the DEM's datum, in addition to the fix's covariance."""


class SearchProcess:
    """One worker. ``beat`` is called during waits; it may raise, to end the wait and the worker.

    Stages: ``wait_terrain``, ``wait_pictures``, ``wait_ready``; each waits for the ones before it.
    """

    def __init__(
        self,
        dem: Sequence[Path],
        memory_mb: int,
        time_s: float,
        command: Sequence[str] = WORKER,
        *,
        dem_error_m: float | None = None,
        chosen_dem: DemChoice | None = None,
    ) -> None:
        """``chosen_dem`` has more options than ``dem`` and ``dem_error_m``, and replaces them."""
        self.dem = tuple(dem)
        self._limits = memory_mb, time_s
        self.beat: Callable[[], None] = lambda: None
        self._terrain = self._pictures = self._ready = False
        self._rest = b""
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            bufsize=0,
        )
        try:
            choice = chosen_dem or DemChoice(self.dem, error_m=dem_error_m)
            self._send(
                {"dem": [str(file) for file in choice.paths], "dem_error_m": choice.error_m}
                | {"said": choice.to_fields()}
            )
        except BaseException:
            self.close()
            raise

    @property
    def pid(self) -> int:
        """The worker's process id."""
        return self._process.pid

    @property
    def memory_mb(self) -> float:
        """Resident memory of the worker; 0 if it has ended."""
        try:
            resident = Path(f"/proc/{self.pid}/statm").read_text(encoding="ascii").split()[1]
        except (OSError, IndexError):
            return 0.0
        return int(resident) * _PAGE_BYTES / 1e6

    def wait_terrain(self) -> None:
        """Wait until the DEM is loaded. ``SearchFailedError`` if it cannot be used, or the worker crashed."""
        if not self._terrain:
            self._receive(STARTING_S, "could not read the DEM in time")
            self._terrain = True

    def wait_pictures(self) -> None:
        """Wait until the picture kernels are in the disk cache, which other processes use too."""
        self.wait_terrain()
        if not self._pictures:
            self._receive(STARTING_S, "was not ready for pictures")
            self._pictures = True

    def wait_ready(self) -> None:
        """Wait until all kernels are loaded."""
        self.wait_pictures()
        if not self._ready:
            self._receive(STARTING_S, "was not ready")
            self._ready = True

    def search(self, bundle_dir: Path, tracker: Tracker, leg: Movement | None) -> SearchResult:
        """Search for a bundle. After a ``SearchFailedError`` the worker may have ended: see ``alive``."""
        state = tracker.model_dump(mode="json", by_alias=True)
        self._send({"bundle": str(bundle_dir), "tracker": state, "leg": leg_json(leg)})
        fields = self._receive(self._limits[1], "took longer than [run.search] time_s")
        return SearchResult(
            TrackLine.model_validate(fields["track"], strict=False),
            Tracker.model_validate(fields["tracker"], strict=False),
            fields["altitude_m"],
            fields["azimuth_bias_sigma_deg"],
            CaptureInfo(**fields["capture_info"]),
            fields.get("wgs84_accuracy_m", 0.0),
        )

    @property
    def alive(self) -> bool:
        """Whether the worker accepts requests."""
        return self._process.poll() is None

    def close(self) -> None:
        """Kill the worker."""
        self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe:
                pipe.close()

    def _send(self, message: dict[str, Any]) -> None:
        assert self._process.stdin
        try:
            self._process.stdin.write(json.dumps(message).encode() + b"\n")
        except BrokenPipeError:
            raise SearchFailedError(self._end()) from None

    def _receive(self, within_s: float, late: str) -> dict[str, Any]:
        """The next message. Kills the worker if none comes in time, or it exceeds its memory."""
        assert self._process.stdout
        deadline, largest_mb = Deadline.after(within_s), self._limits[0]
        while b"\n" not in self._rest:
            try:
                self.beat()
            except BaseException:
                self.close()
                raise
            if deadline.expired:
                self.close()
                raise SearchFailedError(f"the search {late}: ended after {within_s:g} s")
            if self.memory_mb > largest_mb:
                self.close()
                raise SearchFailedError(
                    f"the search took more than [run.search] memory_mb = {largest_mb}: ended"
                )
            if not select.select([self._process.stdout], [], [], POLL_S)[0]:
                continue
            part = os.read(self._process.stdout.fileno(), 1 << 16)
            if not part:
                raise SearchFailedError(self._end())
            self._rest += part
        line, self._rest = self._rest.split(b"\n", 1)
        message: dict[str, Any] = json.loads(line)
        if "error" in message:
            raise SearchFailedError(message["error"])
        return message

    def _end(self) -> str:
        """How the worker ended, in words."""
        waited = Deadline.after(1.0)
        while self.alive and not waited.expired:
            time.sleep(0.01)
        status = self._process.poll()
        self.close()
        if status is None:
            return "the search closed its output and went on: ended"
        if status < 0:
            return f"the search crashed: {signal.Signals(-status).name}"
        return f"the search ended by itself with status {status}; its last words are in the log"
