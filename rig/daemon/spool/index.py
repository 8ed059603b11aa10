"""The spool's index: tables, opening, and conversion of rows."""

import logging
import sqlite3
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from pydantic import TypeAdapter, ValidationError

from localizer.documents import DocumentError, json_text, json_values
from localizer.track.odometry import Movement
from rig.daemon.state import Answer, TriggerSource
from rig.errors import RigError

BundleState = Literal["waiting", "located", "failed"]
ANSWER = TypeAdapter(Answer)
MAX_LOGGED_UNREADABLE = 20
_log = logging.getLogger(__name__)
_logged_unreadable: set[str] = set()
"""Unreadable answers that are already logged."""
_VERSION = 1
_SCHEMA = """
CREATE TABLE bundles (
    number INTEGER PRIMARY KEY AUTOINCREMENT,
    bundle TEXT NOT NULL UNIQUE,
    captured TEXT NOT NULL,
    trigger TEXT NOT NULL,
    boot TEXT,
    leg TEXT,
    bytes INTEGER NOT NULL,
    state TEXT NOT NULL CHECK (state IN ('waiting', 'located', 'failed')),
    tries INTEGER NOT NULL DEFAULT 0,
    reason TEXT,
    answer TEXT,
    here INTEGER NOT NULL DEFAULT 1
);
CREATE INDEX by_state ON bundles (state, number);
CREATE TABLE memory (name TEXT PRIMARY KEY, value TEXT NOT NULL);
"""


class SpoolError(RigError):
    """The spool cannot be used; the message names its folder."""


class SpoolFullError(SpoolError):
    """Bundles not yet located fill the quota: there is no room for another one."""


@dataclass(frozen=True)
class Entry:
    """One row of the index: a bundle.

    ``boot`` is the boot of the capture, if known: its monotonic times belong to that boot. ``reason`` says why the
    search failed the last time; ``here`` whether the folder still exists.
    """

    number: int
    bundle: str
    captured: datetime
    trigger: TriggerSource
    boot: str | None
    state: BundleState
    tries: int
    reason: str | None
    size_bytes: int
    here: bool
    answer: Answer | None


def composed(legs: list[Movement | None]) -> Movement | None:
    """The sum of several movements; None if one is unknown, or there is none."""
    known = [leg for leg in legs if leg is not None]
    if len(known) < len(legs) or not known:
        return None
    return Movement(
        np.sum([leg.step_m for leg in known], axis=0), np.sum([leg.covariance_m2 for leg in known], axis=0)
    )


SELECT = (
    "SELECT number, bundle, captured, trigger, boot, state, tries, reason, bytes, here, answer FROM bundles"
)


def entry_of(
    row: tuple[int, str, str, TriggerSource, str | None, BundleState, int, str | None, int, int, str | None],
) -> Entry:
    number, bundle, captured, trigger, boot, state, tries, reason, size, here, answer = row
    if trigger not in get_args(TriggerSource):
        trigger = "found"
    return Entry(
        number,
        bundle,
        _time_of(captured),
        trigger,
        boot,
        state,
        tries,
        reason,
        size,
        bool(here),
        answer_of(answer),
    )


def _time_of(text: str) -> datetime:
    try:
        return datetime.fromisoformat(text)
    except ValueError:
        return datetime.fromtimestamp(0.0, UTC)


def answer_of(text: str | None) -> Answer | None:
    """The answer in a row; None if there is none, or this version cannot read it."""
    if text is None:
        return None
    try:
        return ANSWER.validate_json(json_text(text))
    except (DocumentError, ValidationError) as error:
        if (
            len(_logged_unreadable) < MAX_LOGGED_UNREADABLE and text not in _logged_unreadable
        ):  # the page asks every few seconds
            _logged_unreadable.add(text)
            _log.warning("an answer in the spool cannot be read: %s", str(error).splitlines()[0])
        return None


def leg_json(leg: Movement | None) -> dict[str, Any] | None:
    """A movement as JSON values."""
    return leg and {"step_m": leg.step_m.tolist(), "covariance_m2": leg.covariance_m2.tolist()}


def leg_of(fields: Mapping[str, Any] | None) -> Movement | None:
    """The inverse of ``leg_json``."""
    if fields is None:
        return None
    return Movement(np.array(fields["step_m"]), np.array(fields["covariance_m2"]))


def stored_leg(text: str | None) -> Movement | None:
    """The leg in a row; None (unknown) also if it is invalid."""
    try:
        leg = leg_of(json_values(text or "null"))
    except (DocumentError, KeyError, TypeError, ValueError):
        return None
    if leg is not None and (leg.step_m.shape != (2,) or leg.covariance_m2.shape != (2, 2)):
        return None
    return leg


def stored_intent(text: str | None) -> dict[str, Any]:
    """The note made before a capture; empty if it is invalid."""
    try:
        intent = json_values(text or "{}")
    except DocumentError:
        return {}
    return intent if isinstance(intent, dict) else {}


def remember(db: sqlite3.Connection, name: str, value: str) -> None:
    db.execute("INSERT OR REPLACE INTO memory (name, value) VALUES (?, ?)", (name, value))


def recall(db: sqlite3.Connection, name: str) -> str | None:
    row = db.execute("SELECT value FROM memory WHERE name = ?", (name,)).fetchone()
    return row[0] if row else None


def open_index(path: Path) -> sqlite3.Connection:
    """Open the index; an unreadable one is moved aside and rebuilt from the folder."""
    try:
        return _connected(path)
    except sqlite3.DatabaseError as error:
        if isinstance(error, sqlite3.OperationalError):
            raise SpoolError(f"{path}: {error}; look at its permissions") from error
        for suffix in ("", "-wal", "-shm"):
            damaged = path.with_name(path.name + suffix)
            if damaged.exists():
                damaged.rename(path.with_name(f"damaged-{datetime.now(UTC):%Y%m%dT%H%M%SZ}-{damaged.name}"))
        return _connected(path)


def _connected(path: Path) -> sqlite3.Connection:
    db = sqlite3.connect(path, check_same_thread=False, isolation_level=None, timeout=5.0)
    try:
        db.execute("PRAGMA journal_mode = WAL")
        db.execute("PRAGMA synchronous = FULL")
        version = db.execute("PRAGMA user_version").fetchone()[0]
        if version == 0:
            db.executescript(f"BEGIN; {_SCHEMA} PRAGMA user_version = {_VERSION}; COMMIT;")
        elif version != _VERSION:
            raise SpoolError(
                f"{path}: is of another version of skyfix ({version}); give another [run.spool] dir"
            )
        if db.execute("PRAGMA quick_check(1)").fetchone()[0] != "ok":
            raise sqlite3.DatabaseError("damaged")
    except BaseException:
        db.close()
        raise
    return db
