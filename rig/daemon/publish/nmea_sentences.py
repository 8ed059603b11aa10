"""Encodes a fix, or its absence, as one epoch of NMEA 0183 (4.10) sentences. No I/O, no clock.

How the order and time fields of the sentences affect gpsd is described in docs/daemon.md and tested with gpsd itself.
"""

from collections.abc import Callable, Collection
from datetime import datetime

from rig.config.run import SentenceKind
from rig.daemon.publish.published import PublishedFix
from rig.devices.sensors.nmea import checksum

TALKER = "GP"
"""QGIS accepts no other talker id: neither II nor IN."""
RMC_DATE = 8
"""Index of the date among its fields."""
MINUTE_DECIMALS = 5
"""Two centimetres."""
_MODE = {1: "A", 6: "E"}
"""Mode indicator for GGA's quality: autonomous, estimated."""

Fields = list[str]


def epoch(
    fix: PublishedFix | None,
    utc: datetime,
    quality: int,
    kinds: Collection[SentenceKind],
    *,
    dated: bool = True,
) -> bytes:
    """The sentences of one epoch, in the order in which gpsd combines them into one report.

    Times of a position are those of its capture, so that a repeated one does not look new. ``utc`` is the present, for
    ZDA and for sentences without a position.

    Not ``dated``: the clock is implausible, so ZDA and the date in RMC are left out, as receivers may set their clock
    by them. The time of day stays: gpsd separates epochs by it.
    """
    return _sentences(fix, utc, quality, [kind for kind in _FIELDS if kind in kinds], dated)


def epoch_for_datagrams(
    fix: PublishedFix | None,
    utc: datetime,
    quality: int,
    kinds: Collection[SentenceKind],
    *,
    dated: bool = True,
) -> bytes:
    """An epoch for receivers that may have joined during a fix, as with datagrams.

    gpsd learns the last sentence of an epoch where the time changes, and in repeated fixes it does not. So GBS comes
    last, and once more without values at the present time.
    """
    chosen = [kind for kind in _FIELDS if kind in kinds and kind != "GBS"]
    if "GBS" not in kinds:
        return _sentences(fix, utc, quality, chosen, dated)
    closing = b"" if fix is None else _sentences(None, utc, quality, ["GBS"], dated)
    return _sentences(fix, utc, quality, [*chosen, "GBS"], dated) + closing


def _sentences(
    fix: PublishedFix | None, utc: datetime, quality: int, kinds: Collection[SentenceKind], dated: bool
) -> bytes:
    chosen = ((kind, _FIELDS[kind](fix, utc, quality)) for kind in kinds if dated or kind != "ZDA")
    sentences = (
        (kind, fields if dated else _dateless(kind, fields)) for kind, fields in chosen if fields is not None
    )
    return b"".join(sentence(kind, fields) for kind, fields in sentences)


def _dateless(kind: str, fields: Fields) -> Fields:
    return [*fields[:RMC_DATE], "", *fields[RMC_DATE + 1 :]] if kind == "RMC" else fields


def sentence(kind: str, fields: Fields) -> bytes:
    """A line with its checksum."""
    body = ",".join([TALKER + kind, *fields]).encode("ascii")
    return b"$%s*%02X\r\n" % (body, checksum(body))


def hhmmss(utc: datetime) -> str:
    """To a hundredth of a second, truncated: rounding could give second 60."""
    return f"{utc:%H%M%S}.{utc.microsecond // 10_000:02d}"


def lat_lon(fix: PublishedFix | None) -> Fields:
    """Latitude, N or S, longitude, E or W; all empty without a fix."""
    if fix is None:
        return [""] * 4
    north, east = "N" if fix.lat_deg >= 0.0 else "S", "E" if fix.lon_deg >= 0.0 else "W"
    return [degrees_minutes(fix.lat_deg, 2), north, degrees_minutes(fix.lon_deg, 3), east]


def degrees_minutes(angle_deg: float, degree_digits: int) -> str:
    """``ddmm.mmmmm`` of the absolute value."""
    # rounded as a whole: rounded minutes could become 60.00000
    unit = 10**MINUTE_DECIMALS
    degrees, minutes = divmod(round(abs(angle_deg) * 60.0 * unit), 60 * unit)
    return f"{degrees:0{degree_digits}d}{minutes // unit:02d}.{minutes % unit:0{MINUTE_DECIMALS}d}"


def _zda(_fix: PublishedFix | None, utc: datetime, _quality: int) -> Fields:
    return [hhmmss(utc), *f"{utc:%d %m %Y}".split(), "00", "00"]


def _rmc(fix: PublishedFix | None, utc: datetime, quality: int) -> Fields:
    at = utc if fix is None else fix.utc
    status, mode = ("V", "N") if fix is None else ("A", _MODE[quality])
    # no speed, course and variation; V at the end: no navigational status available
    return [hhmmss(at), status, *lat_lon(fix), "", "", f"{at:%d%m%y}", "", "", mode, "V"]


def _gga(fix: PublishedFix | None, utc: datetime, quality: int) -> Fields:
    altitude_m = "" if fix is None or fix.altitude_m is None else f"{fix.altitude_m:.1f}"
    at = utc if fix is None else fix.utc
    # no satellites, no dilution of precision, geoid height unknown
    return [hhmmss(at), *lat_lon(fix), str(quality if fix else 0), "00", "", altitude_m, "M", "", "M", "", ""]


def _gbs(fix: PublishedFix | None, utc: datetime, _quality: int) -> Fields:
    if fix is None:
        return [hhmmss(utc), *[""] * 7]
    return [hhmmss(fix.utc), f"{fix.sigma_north_m:.2f}", f"{fix.sigma_east_m:.2f}", *[""] * 5]


def _gst(fix: PublishedFix | None, utc: datetime, _quality: int) -> Fields:
    if fix is None:
        return [hhmmss(utc), *[""] * 7]
    ellipse = [f"{fix.sigma_major_m:.2f}", f"{fix.sigma_minor_m:.2f}", _azimuth(fix.major_azimuth_deg, 180.0)]
    # no range residuals, and no sigma of the altitude
    return [hhmmss(fix.utc), "", *ellipse, f"{fix.sigma_north_m:.2f}", f"{fix.sigma_east_m:.2f}", ""]


def _hdt(fix: PublishedFix | None, _utc: datetime, _quality: int) -> Fields | None:
    # some receivers read an empty one as north
    return None if fix is None or fix.heading_deg is None else [_azimuth(fix.heading_deg, 360.0), "T"]


def _gll(fix: PublishedFix | None, utc: datetime, quality: int) -> Fields:
    status, mode = ("V", "N") if fix is None else ("A", _MODE[quality])
    return [*lat_lon(fix), hhmmss(utc if fix is None else fix.utc), status, mode]


def _azimuth(azimuth_deg: float, full_deg: float) -> str:
    return f"{round(azimuth_deg, 1) % full_deg:.1f}"


_FIELDS: dict[SentenceKind, Callable[[PublishedFix | None, datetime, int], Fields | None]] = {
    "ZDA": _zda,
    "RMC": _rmc,
    "GGA": _gga,
    "GBS": _gbs,
    "GST": _gst,
    "HDT": _hdt,
    "GLL": _gll,
}
