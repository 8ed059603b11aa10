"""Reads a log of ``rig record``. The format is described in docs/recording.md."""

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from sim.errors import SimulationError
from sim.replay.devices import Exchange
from sim.replay.log_checks import check_config, check_exchange

LOG_VERSION = 1


def load_log(path: Path) -> tuple[dict[str, Any], list[Exchange]]:
    """The configuration and the exchanges of a log. A truncated last line is dropped.

    Raises:
        SimulationError: it cannot be read, or is no such log.
    """
    from sim.documents import log_lines, values_of  # of the commands only; the devices do not need it

    lines = log_lines(path)
    no_log = f"log {path}: is no log of rig record"

    def parsed(number: int) -> Any:
        try:
            return values_of(lines[number - 1])
        except SimulationError as error:
            raise SimulationError(f"{no_log}: line {number}: {error}") from error

    header = parsed(1) if lines else {}
    if not isinstance(header, dict) or "skyfix_log" not in header:
        raise SimulationError(f"{no_log}: it {_instead(lines)}; name the file that rig record wrote")
    if header["skyfix_log"] != LOG_VERSION:
        raise SimulationError(
            f"{no_log}, version {LOG_VERSION}: it says {header['skyfix_log']!r}; replay it with the skyfix that wrote it"
        )
    exchanges = [(number, parsed(number)) for number in range(2, len(lines))]
    if len(lines) > 1:
        with suppress(SimulationError):  # the last one may be cut off
            exchanges.append((len(lines), parsed(len(lines))))
    for number, exchange in exchanges:
        try:
            check_exchange(exchange)
        except ValueError as error:
            raise SimulationError(f"{no_log}: line {number} is no exchange: {error}") from error
    if not exchanges:
        raise SimulationError(
            f"log {path}: holds nothing that a device was asked or said; record a command that got as far as the devices"
        )
    try:
        check_config(header.get("config"))
    except ValueError as error:
        raise SimulationError(f"{no_log}: {error}") from error
    return header["config"], [exchange for _, exchange in exchanges]


def _instead(lines: Sequence[bytes]) -> str:
    if not lines:
        return "is empty"
    return f"begins with {lines[0][:40].decode(errors='replace')!r}"
