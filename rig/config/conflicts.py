"""Detects configuration keys that claim the same port, chip, listening address or file."""

import os
import re
from collections.abc import Iterator
from itertools import combinations, product
from pathlib import Path
from typing import NamedTuple

from rig.config.i2c_names import same_bus
from rig.config.run import RunSection, host_and_port
from rig.config.sections import AllSections

_MAVLINK = re.compile(r"(?P<kind>udpout|udpin|tcp):(?P<address>.*:\d{1,5})")
_ANY_HOST = ("", "0.0.0.0", "::", "*")


class _Claim(NamedTuple):
    """A resource claimed by a key: ``what`` is equal for the same resource, ``shown`` is how the file writes it."""

    key: str
    what: object
    shown: str


def conflicts(config: AllSections) -> Iterator[str]:
    """One sentence, naming both keys, for each conflict."""
    yield from _serial_ports(config)
    yield from _chips(config)
    if config.run is not None:
        yield from _addresses(config.run)
    yield from _places(config)


def _serial_ports(config: AllSections) -> Iterator[str]:
    sections = (("pan_tilt", config.pan_tilt), ("compass", config.compass), ("altimeter", config.altimeter))
    claims = [
        _Claim(f"[{name}] port", os.path.realpath(port), port)
        for name, section in sections
        if (port := getattr(section, "port", None)) is not None
    ]
    mavlink = config.run.mavlink if config.run else None
    if mavlink is not None and mavlink.connection.startswith("/"):
        port = mavlink.connection.split(",")[0]
        claims.append(_Claim("[run.mavlink] connection", os.path.realpath(port), port))
    for first, second in _same(claims):
        if {first.key, second.key} == {"[compass] port", "[altimeter] port"}:
            if config.compass and config.altimeter and _baud(config.compass) != _baud(config.altimeter):
                yield "[compass] and [altimeter] share a port and have another baud each; give both the same"
            continue  # one stream may carry both
        only = (
            "a servo bus is shared with nothing"
            if "pan_tilt" in first.key
            else "a talker's line is shared with no other program's"
        )
        yield f"{first.key} and {second.key} are the same port, {_both(first, second)}: {only}; give each its own"


def _baud(section: object) -> int | None:
    return getattr(section, "baud", None)


def _chips(config: AllSections) -> Iterator[str]:
    claims = [
        _Claim(
            f"[{name}] address",
            (same_bus(section.bus), section.address),
            f"0x{section.address:02X} on {section.bus}",
        )
        for name in ("inclinometer", "compass", "altimeter")
        if hasattr(section := getattr(config, name), "bus")
    ]
    for first, second in _same(claims):
        yield (
            f"{first.key} and {second.key} are the same, {_both(first, second)}: two chips at one address cannot be told "
            "apart; strap one to its other address, or put it on another bus"
        )


def _addresses(run: RunSection) -> Iterator[str]:
    tcp: list[_Claim] = []
    udp: list[_Claim] = []
    to: list[_Claim] = []
    to_tcp: list[_Claim] = []
    if run.http:
        tcp.append(_at("[run.http] listen", run.http.listen))
    if run.nmea and run.nmea.tcp:
        tcp.append(_at("[run.nmea] tcp", run.nmea.tcp))
    if run.odometry:
        udp.append(_at("[run.odometry] listen", run.odometry.listen))
    if run.nmea:
        to += [_at("[run.nmea] udp", address) for address in run.nmea.udp]
    mavlink = _MAVLINK.fullmatch(run.mavlink.connection) if run.mavlink else None
    if mavlink:
        claim = _at("[run.mavlink] connection", mavlink["address"])
        {"udpin": udp, "udpout": to, "tcp": to_tcp}[mavlink["kind"]].append(claim)
    for first, second in _overlapping(tcp):
        yield f"{first.key} and {second.key} listen on the same TCP port, {_both(first, second)}; give one another port"
    for first, second in _overlapping(udp):
        yield f"{first.key} and {second.key} listen on the same UDP port, {_both(first, second)}; give one another port"
    for sent, heard in [*product(to, udp), *product(to_tcp, tcp)]:
        if _overlap(sent, heard):
            yield (
                f"{sent.key} sends to where {heard.key} listens, {_both(sent, heard)}: the daemon would hear itself; give "
                "one another port"
            )
    for first, second in _overlapping(to):
        if first.key == second.key:
            yield f"{first.key}: {first.shown} is there twice; name it once"
        else:
            yield (
                f"{first.key} and {second.key} send to the same port, {_both(first, second)}: who listens there understands "
                "only one of them; give one another port"
            )


def _places(config: AllSections) -> Iterator[str]:
    """Folders and files that are written to."""
    claims = [_Claim("[rig] bundle_dir", _plain(config.rig.bundle_dir), str(config.rig.bundle_dir))]
    if config.rig.telemetry_dir:
        claims.append(
            _Claim("[rig] telemetry_dir", _plain(config.rig.telemetry_dir), str(config.rig.telemetry_dir))
        )
    run = config.run
    if run is not None:
        spool = run.spool.dir
        claims.append(_Claim("[run.spool] dir", _plain(spool), str(spool)))
        if run.control:
            claims.append(_Claim("[run] control", _plain(run.control), str(run.control)))
        if run.http and run.http.token_file:
            claims.append(
                _Claim("[run.http] token_file", _plain(run.http.token_file), str(run.http.token_file))
            )
        claims += [_Claim("[run] dem", _plain(file), str(file)) for file in run.dem]
    claims += [
        _Claim(f"[calibration] {kind}", _plain(file), str(file))
        for kind in type(config.calibration).model_fields
        if (file := getattr(config.calibration, kind)) is not None
    ]
    for first, second in _same(claims):
        if {first.key, second.key} == {"[rig] bundle_dir", "[rig] telemetry_dir"}:
            continue  # files beside folders
        if first.key == second.key:
            yield f"{first.key}: {first.shown} is there twice; name it once"
        elif {first.key, second.key} == {"[rig] bundle_dir", "[run.spool] dir"}:
            yield (
                f"{first.key} and {second.key} are the same folder, {_both(first, second)}: the daemon deletes old bundles of "
                "its spool; give each its own"
            )
        else:
            yield f"{first.key} and {second.key} are the same, {_both(first, second)}; give each its own"


def _at(key: str, address: str) -> _Claim:
    return _Claim(key, address, address)


def _same(claims: list[_Claim]) -> Iterator[tuple[_Claim, _Claim]]:
    return ((a, b) for a, b in combinations(claims, 2) if a.what == b.what)


def _overlapping(claims: list[_Claim]) -> Iterator[tuple[_Claim, _Claim]]:
    return ((a, b) for a, b in combinations(claims, 2) if _overlap(a, b))


def _overlap(first: _Claim, second: _Claim) -> bool:
    """Whether two addresses overlap. Port 0 never does: the system chooses a free one."""
    (host, port), (other_host, other_port) = host_and_port(first.shown), host_and_port(second.shown)
    if port != other_port or port == 0:
        return False
    hosts = {"127.0.0.1" if each == "localhost" else each for each in (host, other_host)}
    return len(hosts) == 1 or not hosts.isdisjoint(_ANY_HOST)


def _both(first: _Claim, second: _Claim) -> str:
    return first.shown if first.shown == second.shown else f"{first.shown} and {second.shown}"


def _plain(path: Path) -> str:
    return os.path.normpath(path)
