"""The journal of a series: JSON lines, each fsynced before the step that it announces; after a crash it tells where to
resume.

    {"schema": "skyfix.series/1", "id": "series-20261124T150000Z-3f9a", "time": "...", "plan": {"repeat": 48, ...}}
    {"begun": 1, "time": "2026-11-24T15:00:00.210Z"}
    {"taken": 1, "time": "...", "took_s": 21.4, "bundle": "20261124T150021Z-77c1", "readings": {...}}
    {"begun": 2, "time": "..."}
    {"failed": 2, "time": "...", "took_s": 3.0, "reason": "..."}
    {"ended": "2026-11-25T14:30:22.500Z"}

An incomplete last line, left by a power cut, is dropped. The series' folder has the bundles in ``bundles`` and a
picture of each in ``previews``.
"""

import fcntl
import json
import os
import secrets
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

from localizer.bundle import Bundle, is_bundle_id
from localizer.documents import DocumentError, json_values, read_file
from localizer.os_errors import why_not_read, why_not_written
from rig.atomic import sync, write_atomically
from rig.capture.averaged_readings import utc_text
from rig.clock import wall_clock
from rig.errors import RigError

FILE_NAME = "series.jsonl"
SCHEMA = "skyfix.series/1"
MAX_RECORD_BYTES = 256_000_000
MAX_NUMBER = 10_000_000


class SeriesError(RigError):
    """The journal of a series cannot be read or written."""


@dataclass(frozen=True)
class Plan:
    """The command's parameters; the same parameters resume an unfinished series."""

    repeat: int
    every_s: float
    directions: tuple[str, ...]
    rig: str


@dataclass(frozen=True)
class Outcome:
    """The outcome of one number: a ``bundle`` with its ``readings``, or the ``reason`` for none."""

    number: int
    time: datetime
    took_s: float | None
    """None after a crash."""
    bundle: str | None = None
    readings: Mapping[str, Any] = field(default_factory=dict)
    reason: str | None = None


@dataclass
class Series:
    """A series as recorded in its journal. Methods that append to the journal raise ``SeriesError`` if the disk
    refuses.
    """

    folder: Path
    plan: Plan
    begun: dict[int, datetime] = field(default_factory=dict)
    outcomes: dict[int, Outcome] = field(default_factory=dict)
    ended: bool = False

    @property
    def id(self) -> str:
        """The id; also the folder's name."""
        return self.folder.name

    @property
    def bundles(self) -> Path:
        """The folder of its bundles."""
        return self.folder / "bundles"

    def preview(self, outcome: Outcome) -> Path:
        """The file of a bundle's picture."""
        return self.folder / "previews" / f"{outcome.number:04}-{outcome.bundle}.jpg"

    def remaining(self) -> list[int]:
        """The numbers not yet taken."""
        return [number for number in range(1, self.plan.repeat + 1) if number not in self.outcomes]

    def begin(self, number: int) -> None:
        """Record the begin of a capture."""
        self.begun[number] = wall_clock()
        self._append({"begun": number, "time": utc_text(self.begun[number])})

    def taken(
        self, number: int, took_s: float | None, bundle: Bundle, readings: Mapping[str, Any]
    ) -> Outcome:
        """Record a finished bundle."""
        took_s = None if took_s is None else round(took_s, 2)
        outcome = Outcome(number, wall_clock(), took_s, bundle.id, readings)
        self.outcomes[number] = outcome
        self._append(
            {
                "taken": number,
                "time": utc_text(outcome.time),
                "took_s": outcome.took_s,
                "bundle": bundle.id,
                "readings": dict(readings),
            }
        )
        return outcome

    def failed(self, number: int, took_s: float, reason: str) -> Outcome:
        """Record a failed capture."""
        outcome = Outcome(number, wall_clock(), round(took_s, 2), reason=reason)
        self.outcomes[number] = outcome
        self._append(
            {"failed": number, "time": utc_text(outcome.time), "took_s": outcome.took_s, "reason": reason}
        )
        return outcome

    def end(self) -> None:
        """Record the end of the series."""
        self.ended = True
        self._append({"ended": utc_text(wall_clock())})

    def _append(self, entry: Mapping[str, Any]) -> None:
        path = self.folder / FILE_NAME
        try:
            with path.open("ab") as file:
                file.write(json.dumps(entry).encode() + b"\n")
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise SeriesError(f"{path}: {why_not_written(error)}; the series ends here") from error


def begin_series(out_dir: Path, plan: Plan) -> Series:
    """Begin a new series in its own folder."""
    now = wall_clock()
    folder = out_dir / f"series-{now:%Y%m%dT%H%M%SZ}-{secrets.token_hex(2)}"
    header = {"schema": SCHEMA, "id": folder.name, "time": utc_text(now), "plan": asdict(plan)}
    try:
        write_atomically(folder / FILE_NAME, json.dumps(header).encode() + b"\n")
        sync(out_dir)
    except OSError as error:
        raise SeriesError(f"{folder}: {why_not_written(error, 'choose another --out')}") from error
    return Series(folder, plan)


def unfinished_series(out_dir: Path, plan: Plan) -> Series | None:
    """The newest unfinished series with this plan; ``SeriesError`` if a journal is damaged."""
    for path in sorted(out_dir.glob(f"series-*/{FILE_NAME}"), reverse=True):
        series = load_series(path.parent)
        if series.plan == plan and not series.ended:
            return series
    return None


def load_series(folder: Path) -> Series:
    """Read a series' journal. ``SeriesError`` names the damaged line."""
    path = folder / FILE_NAME
    try:
        lines = read_file(path, MAX_RECORD_BYTES).split(b"\n")
    except OSError as error:
        raise SeriesError(f"{path}: {why_not_read(error, path)}") from error
    except DocumentError as error:
        raise SeriesError(f"{path}: {error}; --fresh begins another series") from error
    series: Series | None = None
    for number, line in enumerate(lines[:-1], 1):  # the last is empty, or was torn
        try:
            entry = json_values(line)
            if series is None:
                series = Series(folder, _plan(entry))
            else:
                _add(series, entry)
        except (DocumentError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise SeriesError(
                f"{path}: line {number} is damaged ({error}); --fresh begins another series"
            ) from error
    if series is None:
        raise SeriesError(f"{path}: is empty; --fresh begins another series")
    return series


@contextmanager
def locked_series(folder: Path) -> Iterator[Series]:
    """The series in a folder, locked for this process, after removal of an incomplete last line and of partly written
    files.

    ``SeriesError`` if another process holds the lock.
    """
    path = folder / FILE_NAME
    with path.open("r+b") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise SeriesError(f"{path}: another process is taking this series; wait for it") from error
        content = file.read()
        file.truncate(content.rfind(b"\n") + 1)
        for partial in (*folder.glob("bundles/.*.partial"), *folder.glob("previews/.*.partial")):
            _remove(partial)
        yield load_series(folder)


def _plan(entry: Mapping[str, Any]) -> Plan:
    if entry.get("schema") != SCHEMA:
        raise ValueError(f"no {SCHEMA}")
    plan = entry["plan"]
    return Plan(plan["repeat"], plan["every_s"], tuple(plan["directions"]), plan["rig"])


def _add(series: Series, entry: Mapping[str, Any]) -> None:
    if "ended" in entry:
        series.ended = True
        return
    time = datetime.fromisoformat(entry["time"])
    if time.tzinfo is None:
        raise ValueError("its time has no zone")
    if "begun" in entry:
        series.begun[_number(entry["begun"])] = time
        return
    number, bundle, readings, reason = _number(entry.get("taken", entry.get("failed"))), None, {}, None
    took_s = entry["took_s"]
    if took_s is not None and (isinstance(took_s, bool) or not isinstance(took_s, int | float)):
        raise ValueError("took_s is no time")
    if "taken" in entry:
        bundle, readings = entry["bundle"], entry["readings"]
        if not is_bundle_id(bundle) or not isinstance(readings, Mapping):
            raise ValueError("names a bundle that can be none")
    else:
        reason = entry["reason"]
        if not isinstance(reason, str):
            raise ValueError("says no reason")
    series.outcomes[number] = Outcome(number, time, took_s, bundle, readings, reason)


def _number(value: object) -> int:
    """A checked number: it becomes part of a file's name."""
    if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= MAX_NUMBER:
        raise ValueError("numbers no bundle")
    return value


def _remove(path: Path) -> None:
    """Remove a folder with its content; of a link or another kind of entry only itself."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink()
