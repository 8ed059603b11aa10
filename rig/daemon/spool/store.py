"""The spool: a folder of bundles and an index of their states and answers.

    bundles/<id>/     complete or absent, as ``rig.bundle.writer`` has it
    index.sqlite      one row a bundle: waiting, located or failed; the answer, and the tracker's state with it

Power may fail at any time. The folder is authoritative: ``reconcile`` adds bundles that the index does not know and
removes partly written or deleted ones. An answer and the tracker's state after it are stored in one transaction.

To stay within the quota the oldest located bundles are deleted (their answers stay in the index). Others are never
deleted.
"""

import fcntl
import json
import os
import shutil
import sqlite3
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Self

from localizer.bundle import FILE_NAME
from localizer.track.odometry import Movement
from localizer.track.tracker import Tracker, TrackerError
from rig.atomic import make_folder, sync
from rig.bundle.writer import MIN_FREE_BYTES
from rig.daemon.boot import boot_id
from rig.daemon.spool.bundle_folders import captured_at, remove, size_bytes_of
from rig.daemon.spool.index import (
    ANSWER,
    SELECT,
    BundleState,
    Entry,
    SpoolError,
    SpoolFullError,
    answer_of,
    composed,
    entry_of,
    leg_json,
    open_index,
    recall,
    remember,
    stored_intent,
    stored_leg,
)
from rig.daemon.state import Answer, TriggerSource

__all__ = ["BundleState", "Entry", "Spool", "SpoolError", "SpoolFullError"]

MAX_TRIES = 2
USUAL_BUNDLE_BYTES = 3_000_000
ROWS_KEPT = 10_000
ODOMETER = "odometer"
"""Key of the odometer's state."""


class Spool:
    """The spool (see the module). Thread-safe, for one process at a time."""

    def __init__(
        self, folder: Path, quota_mb: int, on_waiting_changed: Callable[[int], None] = lambda bundles: None
    ) -> None:
        """Open or create it. ``SpoolError`` if it cannot be used, or another process uses it.

        ``on_waiting_changed`` gets the number of waiting bundles now and after every change, in order.
        """
        self.folder = folder
        self.bundles_dir = folder / "bundles"
        self.quota_bytes = quota_mb * 1_000_000
        self._on_waiting_changed = on_waiting_changed
        self._lock = threading.RLock()
        try:
            make_folder(self.bundles_dir)
            self._claim = os.open(folder / "lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        except OSError as error:
            raise SpoolError(
                f"{folder}: cannot be made: {error.strerror}; look at [run.spool] dir"
            ) from error
        try:
            fcntl.flock(self._claim, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self._db = open_index(folder / "index.sqlite")
        except BlockingIOError:
            os.close(self._claim)
            raise SpoolError(
                f"{folder}: another rig run uses this spool; give each its own [run.spool] dir"
            ) from None
        except BaseException:
            os.close(self._claim)
            raise
        self.reconcile()
        self._on_waiting_changed(self.count("waiting"))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the index and unlock the folder."""
        with self._lock:
            self._db.close()
            os.close(self._claim)

    # Used by a capture, in this order.

    def make_room(self) -> list[str]:
        """Delete the oldest located bundles until another one fits; returns their ids.

        ``SpoolFullError`` if that is not enough.
        """
        self.reconcile()
        removed = []
        total, need, located = self._sizes()
        while total + need > self.quota_bytes or shutil.disk_usage(self.folder).free < MIN_FREE_BYTES + need:
            if not located:
                raise SpoolFullError(self._full(total, need))
            bundle, size = located.pop(0)
            self._delete(bundle)
            removed.append(bundle)
            total -= size
        return removed

    def space_problem(self) -> str | None:
        """Why ``make_room`` would fail now; None if it would succeed."""
        try:
            total, need, located = self._sizes()
            to_gain = sum(size for _, size in located)
            if total - to_gain + need > self.quota_bytes:
                return self._full(total - to_gain, need)
            if shutil.disk_usage(self.folder).free + to_gain < MIN_FREE_BYTES + need:
                return self._full(0, need)
        except OSError as error:
            return f"{self.folder}: {error.strerror}; look at the disk"
        except SpoolError as error:
            return str(error)
        return None

    def _sizes(self) -> tuple[int, int, list[tuple[str, int]]]:
        """Bytes of all bundles, bytes that another one needs, and (id, bytes) of each located one, oldest first."""
        ((total, largest),) = self._read("SELECT sum(bytes), max(bytes) FROM bundles WHERE here")
        located = self._read(
            "SELECT bundle, bytes FROM bundles WHERE here AND state = 'located' ORDER BY number"
        )
        return total or 0, max(largest or 0, USUAL_BUNDLE_BYTES), located

    def _full(self, total: int, need: int) -> str:
        count = self.count("waiting") + self.count("failed")
        if total + need > self.quota_bytes:
            return (
                f"{self.folder}: full: {count} bundles that have not been located take {total / 1e6:.0f} of "
                f"{self.quota_bytes / 1e6:.0f} MB; see why they fail, move them away or raise [run.spool] quota_mb"
            )
        free = shutil.disk_usage(self.folder).free
        return (
            f"{self.folder}: {free / 1e6:.0f} MB are free on its disk, and a bundle with the reserve takes "
            f"{(MIN_FREE_BYTES + need) / 1e6:.0f}; no located bundle is left to delete: make room there"
        )

    def begin_capture(
        self, trigger: TriggerSource, leg: Movement | None, odometer: str | None = None
    ) -> None:
        """Store the trigger of a capture and the leg to it, before they can be lost.

        ``odometer`` is the odometer's state after that leg. It is stored together with the bundle or not at all, so
        that no leg is counted twice or lost by a power cut.
        """
        with self._transaction() as db:
            newest = db.execute("SELECT trigger FROM bundles ORDER BY number DESC LIMIT 1").fetchone()
            if newest == ("found",):  # the leg starts at an earlier capture
                leg = None
            intent = {"trigger": trigger, "leg": leg_json(leg), "boot": boot_id(), "odometer": odometer}
            remember(db, "capturing", json.dumps(intent))

    def end_capture(self) -> str | None:
        """Register the new bundle; returns its id, None if the capture left none."""
        new = self.reconcile()
        return new[-1] if new else None

    # Used by the search.

    def next_waiting(self) -> Entry | None:
        """The oldest waiting bundle."""
        rows = self._read(f"{SELECT} WHERE state = 'waiting' AND here ORDER BY number LIMIT 1")
        return entry_of(rows[0]) if rows else None

    def tracker_for(self, entry: Entry) -> tuple[Tracker, Movement | None]:
        """The tracker's state after the last answer, and how the vehicle moved from there to ``entry``.

        Raises ``localizer.track.tracker.TrackerError`` where the state cannot be read.
        """
        with self._lock:
            text, tracked = recall(self._db, "tracker"), recall(self._db, "tracked")
            if text is None or tracked is None:
                return Tracker(), None
            if not tracked.isdecimal():
                raise TrackerError(
                    f"state of a track: {tracked[:20]!r} is no bundle's number; a new track is begun"
                )
            legs = self._read(
                "SELECT leg FROM bundles WHERE number > ? AND number <= ? ORDER BY number",
                int(tracked),
                entry.number,
            )
        return Tracker.from_json(text), composed([stored_leg(leg) for (leg,) in legs])

    def set_answer(self, answer: Answer, tracker: Tracker) -> None:
        """Store a bundle's answer and the tracker's state after it, in one transaction."""
        size_bytes = size_bytes_of(
            self.bundles_dir / answer.bundle
        )  # includes the skylines written by the search
        with self._transaction() as db:
            db.execute(
                "UPDATE bundles SET state = 'located', tries = tries + 1, reason = NULL, answer = ?, bytes = ? "
                "WHERE bundle = ?",
                (ANSWER.dump_json(answer, by_alias=True).decode(), size_bytes, answer.bundle),
            )
            number = db.execute("SELECT number FROM bundles WHERE bundle = ?", (answer.bundle,)).fetchone()[0]
            remember(db, "tracker", tracker.to_json())
            remember(db, "tracked", str(number))

    def set_failed(self, bundle: str, reason: str) -> BundleState:
        """Store why a search failed; the bundle waits for another try, or is marked failed."""
        with self._transaction() as db:
            db.execute(
                "UPDATE bundles SET tries = tries + 1, reason = ?, "
                "state = CASE WHEN tries + 1 < ? THEN 'waiting' ELSE 'failed' END WHERE bundle = ?",
                (reason, MAX_TRIES, bundle),
            )
            state: BundleState = db.execute(
                "SELECT state FROM bundles WHERE bundle = ?", (bundle,)
            ).fetchone()[0]
        return state

    # Used by readers.

    def entries(self, limit: int, before: int | None = None) -> list[Entry]:
        """The newest bundles, newest first; those with a smaller number than ``before`` where it is given."""
        newest = 2**62 if before is None else before
        rows = self._read(f"{SELECT} WHERE number < ? ORDER BY number DESC LIMIT ?", newest, limit)
        return [entry_of(row) for row in rows]

    def folder_of(self, bundle_id: str) -> Path | None:
        """The folder of a bundle that is in the spool; None for any other name."""
        known = self._read("SELECT bundle FROM bundles WHERE bundle = ? AND here", bundle_id)
        return self.bundles_dir / bundle_id if known else None

    def answer_of(self, bundle_id: str) -> Answer | None:
        """A bundle's answer; None if the bundle is unknown or has none yet."""
        rows = self._read("SELECT answer FROM bundles WHERE bundle = ? AND answer IS NOT NULL", bundle_id)
        return answer_of(rows[0][0]) if rows else None

    def latest(self) -> tuple[tuple[Answer, str | None] | None, tuple[Answer, str | None] | None]:
        """The newest bundle's answer, and the newest fix, each with the boot of its capture.

        None if there is none, or this version cannot read it.
        """
        found = []
        # json_extract fails the whole query for one damaged row
        status = "CASE WHEN json_valid(answer) THEN json_extract(answer, '$.fix.status') END"
        for wanted in ("", f"AND {status} = 'fix' "):
            rows = self._read(
                f"SELECT answer, boot FROM bundles WHERE answer IS NOT NULL {wanted}ORDER BY number DESC LIMIT 1"
            )
            answer = answer_of(rows[0][0]) if rows else None
            found.append(None if answer is None else (answer, rows[0][1]))
        return found[0], found[1]

    def count(self, state: BundleState) -> int:
        """Number of stored bundles in a state."""
        return int(self._read("SELECT count(*) FROM bundles WHERE here AND state = ?", state)[0][0])

    # Used by a restart.

    def remember(self, name: str, value: str) -> None:
        """Store a text under a key."""
        with self._transaction() as db:
            remember(db, name, value)

    def recall(self, name: str) -> str | None:
        """The text under a key; None if there is none."""
        with self._lock:
            return recall(self._db, name)

    def reconcile(self) -> list[str]:
        """Synchronise the index with the folder; returns the ids of bundles new to the index."""
        with self._lock:
            try:
                names = sorted(path.name for path in self.bundles_dir.iterdir())
                for name in names:
                    if name.startswith("."):  # was being written or deleted
                        remove(self.bundles_dir / name)
            except OSError as error:
                raise SpoolError(f"{self.bundles_dir}: {error.strerror}; look at its permissions") from error
            bundles = {
                name
                for name in names
                if name.isprintable()  # undecodable names cannot be in the index; invalid ids are rejected by the search
                and (self.bundles_dir / name / FILE_NAME).is_file()
            }
            known = {row[0] for row in self._read("SELECT bundle FROM bundles WHERE here")}
            if bundles == known and recall(self._db, "capturing") is None:
                return []
            new = sorted(bundles - known)
            with self._transaction() as db:
                for name in known - bundles:
                    db.execute(
                        "UPDATE bundles SET here = 0, reason = CASE state WHEN 'waiting' THEN 'its folder is gone' "
                        "ELSE reason END, state = CASE state WHEN 'waiting' THEN 'failed' ELSE state END "
                        "WHERE bundle = ?",
                        (name,),
                    )
                intent = stored_intent(recall(db, "capturing"))
                for name in new:
                    self._take_in(db, name, intent if name == new[-1] else {})
                if new and intent.get("odometer"):
                    remember(db, ODOMETER, intent["odometer"])
                elif new:  # the stored leg starts at an earlier capture
                    db.execute("DELETE FROM memory WHERE name = ?", (ODOMETER,))
                db.execute("DELETE FROM memory WHERE name = 'capturing'")
                db.execute(
                    "DELETE FROM bundles WHERE NOT here AND number <= (SELECT max(number) FROM bundles) - ?",
                    (ROWS_KEPT,),
                )
        return new

    def _take_in(self, db: sqlite3.Connection, name: str, intent: Mapping[str, Any]) -> None:
        folder = self.bundles_dir / name
        captured = captured_at(folder / FILE_NAME).isoformat()
        trigger, boot, leg = intent.get("trigger", "found"), intent.get("boot"), intent.get("leg")
        db.execute(
            "INSERT INTO bundles (bundle, captured, trigger, boot, leg, bytes, state) "
            "VALUES (?, ?, ?, ?, ?, ?, 'waiting') "
            "ON CONFLICT (bundle) DO UPDATE SET here = 1, bytes = excluded.bytes, tries = 0, "
            "state = CASE WHEN answer IS NULL THEN 'waiting' ELSE 'located' END",
            (name, captured, trigger, boot, json.dumps(leg) if leg else None, size_bytes_of(folder)),
        )

    def _delete(self, bundle: str) -> None:
        """Renamed before deletion, and the rename brought to the disk first: a bundle is complete or absent."""
        going = self.bundles_dir / f".{bundle}.removed"
        try:
            (self.bundles_dir / bundle).rename(going)
            sync(self.bundles_dir)
            remove(going)
        except OSError as error:
            raise SpoolError(f"{self.bundles_dir / bundle}: cannot be deleted: {error.strerror}") from error
        with self._transaction() as db:
            db.execute("UPDATE bundles SET here = 0 WHERE bundle = ?", (bundle,))

    def _read(self, sql: str, *parameters: object) -> list[Any]:
        """Rows of the index. ``SpoolError`` where it cannot be read."""
        with self._lock:
            try:
                return self._db.execute(sql, parameters).fetchall()
            except sqlite3.Error as error:
                raise SpoolError(f"{self.folder / 'index.sqlite'}: {error}; look at the disk") from error

    @contextmanager
    def _transaction(self) -> Iterator[sqlite3.Connection]:
        """A durable transaction. ``SpoolError`` if the disk refuses."""
        with self._lock:
            try:
                self._db.execute("BEGIN IMMEDIATE")
                try:
                    yield self._db
                    waiting = self.count("waiting")
                except BaseException:
                    self._db.execute("ROLLBACK")
                    raise
                self._db.execute("COMMIT")
                self._on_waiting_changed(waiting)
            except sqlite3.Error as error:
                if self._db.in_transaction:
                    self._db.execute("ROLLBACK")
                raise SpoolError(f"{self.folder / 'index.sqlite'}: {error}; {_remedy(error)}") from error


def _remedy(error: sqlite3.Error) -> str:
    """What to do about an error of the index, from SQLite's message."""
    for words, remedy in (
        ("full", "make room on the disk"),
        ("locked", "end the other program that has it open"),
        ("readonly", "change who may write there, or mount the file system writable"),
        ("unable to open", "change who may read and write there"),
        ("malformed", "move it away: it is made anew from the bundles"),
        ("not a database", "move it away: it is made anew from the bundles"),
    ):
        if words in str(error):
            return remedy
    return "look at the disk (dmesg)"
