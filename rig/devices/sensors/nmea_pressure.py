"""Parser of air pressure in NMEA 0183 sentences: choice of the transducer, unit and resolution.

XDR has groups of type, value, unit and name, of anything that a vehicle measures; MDA and MMB hold the pressure in
inches of mercury and in bar. Raises ``NoReadingError`` if a valid sentence has no usable pressure.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

from rig.clock import Instant
from rig.devices.readings import PressureReading
from rig.devices.sensors.nmea_sentence import Sentence, step_of
from rig.errors import NoReadingError

PRESSURE_KINDS = frozenset(("XDR", "MDA", "MMB"))
PLAUSIBLE_HPA = 300.0, 1250.0
PLAUSIBLE_C = -90.0, 70.0
COARSEST_FILLED_HPA = 1.0
"""Trailing zeros may come from NMEA 2000, whose step is 1 hPa, but from nothing coarser."""
MDA_AGREE_HPA = 1.0
FINE_ENOUGH_HPA = 0.1
"""Resolution of bar with four decimals, sufficient for a barometer; more digits in inches add nothing."""

_HPA_PER_INHG = 33.86389
_HPA_PER_MMHG = 1.333224
_HPA_PER_UNIT = {
    "B": 1000.0,
    "P": 0.01,
    "H": 1.0,
    "I": _HPA_PER_INHG,
}  # H as Vaisala writes hPa, I as MDA has it
_HPA_PER_UNIT |= {"BAR": 1000.0, "MBAR": 1.0, "MB": 1.0, "HPA": 1.0, "PA": 0.01, "KPA": 10.0}
_HPA_PER_UNIT |= {"INHG": _HPA_PER_INHG, "MMHG": _HPA_PER_MMHG, "TORR": _HPA_PER_MMHG}
_OF_THE_AIR = ("BARO", "ATM", "AIR", "PRES", "QFE", "OUTSIDE", "AMBIENT", "WEATHER", "PTB")
_OF_MACHINES = (
    *("ENGINE", "OIL", "BOOST", "FUEL", "TANK", "COOLANT", "HYDRAUL", "GEARBOX", "TURBO", "MANIFOLD", "RAIL"),
    *("TRANSMISSION", "EXHAUST", "WATER", "PUMP", "BRAKE", "TYRE", "TIRE", "REFRIG", "STEAM"),
)
_OF_SEA_LEVEL = ("QNH", "QFF", "MSL", "SLP", "SEA", "RELATIVE", "REDUCED")
"""Names of pressures reduced to sea level, which tell the weather, not the altitude."""


@dataclass(frozen=True)
class _Group:
    """A pressure group of an XDR: as sent, and in hPa by its unit (NaN for an unknown one); its step, in hPa."""

    name: str
    text: str
    unit: str
    pressure_hpa: float
    step_hpa: float

    @property
    def as_sent(self) -> str:
        """The value and unit as sent."""
        return f"{self.text} {self.unit} {self.name}".replace("  ", " ").strip()

    def relabelled(self) -> tuple["_Group", str] | None:
        """The group in the only unit that makes it an air pressure, and that unit's name; None if there is none.

        Bar, hectopascal and pascal cannot be confused. OpenCPN accepts 800 to 1100 "bar", so instruments send it. 760
        without a known unit may be millimetres of mercury.
        """
        if math.isnan(self.pressure_hpa) and is_air(float(self.text) * _HPA_PER_MMHG):
            return None
        for name, hpa_per_unit in (("hPa", 1.0), ("Pa", 0.01), ("bar", 1000.0)):
            if is_air(float(self.text) * hpa_per_unit):
                step_hpa = _step_hpa(self.text, hpa_per_unit)
                return _Group(
                    self.name, self.text, self.unit, float(self.text) * hpa_per_unit, step_hpa
                ), name
        return None


def parse_pressure(sentence: Sentence, at: Instant, transducer: str | None = None) -> PressureReading | None:
    """The air pressure in XDR, MDA or MMB; None for any other sentence, and for an XDR of other transducers.

    ``transducer`` selects an XDR group, or a sentence ("WIMDA"). Without it the first plausible pressure named like a
    barometer is used, else the first plausible one not named like a machine's. A sea-level pressure is used only if
    selected.
    """
    by_sentence = transducer is not None and transducer.upper() in (sentence.address, sentence.kind)
    match sentence.kind:
        case "XDR":
            return _xdr(sentence, at, None if by_sentence else transducer)
        case "MDA" | "MMB":
            return _mda(sentence, at) if transducer is None or by_sentence else None
    return None


def is_air(pressure_hpa: float) -> bool:
    """Whether such a pressure occurs on land."""
    return math.isfinite(pressure_hpa) and PLAUSIBLE_HPA[0] <= pressure_hpa <= PLAUSIBLE_HPA[1]


def _xdr(sentence: Sentence, at: Instant, transducer: str | None) -> PressureReading | None:
    groups = list(_pressures(sentence))
    if transducer is not None:
        groups = [group for group in groups if group.name.upper() == transducer.upper()]
    else:
        groups = [group for group in groups if not _named(group.name, _OF_MACHINES)]
        reduced = [group for group in groups if _named(group.name, _OF_SEA_LEVEL)]
        groups = [group for group in groups if group not in reduced]
        if reduced and not groups:
            raise NoReadingError(
                f"{sentence.address} says {reduced[0].as_sent}, which is reduced to sea level: it says no altitude",
                "set the instrument to send the pressure where it stands (QFE)",
            )
    plausible = [group for group in groups if is_air(group.pressure_hpa)]
    named = [group for group in groups if transducer is not None or _named(group.name, _OF_THE_AIR)]
    remark = None
    if plausible:
        chosen = next(iter([*(group for group in plausible if group in named), *plausible]))
    else:
        readable = [found for group in named if (found := group.relabelled())]
        if not readable:
            _refuse(sentence, transducer, groups)
            return None
        chosen, unit = readable[0]
        remark = f"says {chosen.as_sent}: taken for {unit}"
    return pressure_reading(
        chosen.pressure_hpa,
        _temperature_c(sentence, chosen.name),
        at,
        resolution_hpa=chosen.step_hpa,
        source=f"{sentence.address} {chosen.name}".strip(),
        remark=remark,
    )


def _pressures(sentence: Sentence) -> Iterator[_Group]:
    """The groups of type P with a number; a defect of one group does not affect others."""
    for index in range(0, len(sentence.fields), 4):  # type, value, unit, name
        unit, value = sentence.field(index + 2), sentence.number_if_any(index + 1)
        if sentence.field(index) == "P" and value is not None:
            hpa_per_unit = _HPA_PER_UNIT.get(unit.upper(), math.nan)
            text = sentence.field(index + 1)
            yield _Group(
                sentence.field(index + 3), text, unit, value * hpa_per_unit, _step_hpa(text, hpa_per_unit)
            )


def _named(name: str, words: tuple[str, ...]) -> bool:
    return any(word in name.upper() for word in words)


def _refuse(sentence: Sentence, transducer: str | None, groups: list[_Group]) -> None:
    """Raise the reason why no group is usable, unless none is an air pressure."""
    if groups:
        values_text = ", ".join(group.as_sent for group in groups)
        raise NoReadingError(
            f"{sentence.address} says {values_text}: no air pressure in that unit",
            "set the unit in the instrument, or name the right group with [altimeter] transducer",
        )
    empty = [
        sentence.field(index + 3)
        for index in range(0, len(sentence.fields), 4)
        if sentence.field(index) == "P" and sentence.number_if_any(index + 1) is None
    ]
    if any(
        name.upper() == transducer.upper() if transducer else not _named(name, _OF_MACHINES) for name in empty
    ):
        raise NoReadingError(f"{sentence.address} has no pressure now")


def _temperature_c(sentence: Sentence, name: str) -> float | None:
    """Temperature of the transducer of that name, else of the first that is not a machine's; None if none is plausible."""
    found: list[tuple[bool, float]] = []
    for index in range(0, len(sentence.fields), 4):
        value, called = sentence.number_if_any(index + 1), sentence.field(index + 3)
        if sentence.field(index) != "C" or value is None or _named(called, _OF_MACHINES):
            continue
        temperature_c = _celsius(value, sentence.field(index + 2))
        if temperature_c is not None and PLAUSIBLE_C[0] <= temperature_c <= PLAUSIBLE_C[1]:
            found.append((called == name, temperature_c))
    return max(found, key=lambda each: each[0])[1] if found else None


def _celsius(value: float, unit: str) -> float | None:
    match unit:
        case "C":
            return value
        case "K":
            return value - 273.15
        case "F":
            return (value - 32.0) / 1.8
    return None


def _mda(sentence: Sentence, at: Instant) -> PressureReading:
    """The finer of inches and bar, if both are plausible and agree."""
    found = []
    for index, hpa_per_unit in ((2, _HPA_PER_UNIT["B"]), (0, _HPA_PER_INHG)):
        value = sentence.number_if_any(index)
        if value is not None and is_air(value * hpa_per_unit):
            found.append((_written_hpa(sentence.field(index), hpa_per_unit), index, value * hpa_per_unit))
    if not found:
        return _mda_relabelled(sentence, at)
    off_hpa = abs(found[0][2] - found[-1][2])
    if off_hpa > found[0][0] + found[-1][0] + MDA_AGREE_HPA:
        raise NoReadingError(
            f"{sentence.address} says {sentence.field(0)} inches and {sentence.field(2)} bar, which do not agree",
            "look at the instrument's display and its settings",
        )
    fine = [each for each in found if each[0] <= FINE_ENOUGH_HPA * 1.001]
    _, index, pressure_hpa = fine[0] if fine else min(found)
    step_hpa = _step_hpa(sentence.field(index), _HPA_PER_UNIT["B"] if index else _HPA_PER_INHG)
    return pressure_reading(
        pressure_hpa, _air_c(sentence), at, resolution_hpa=step_hpa, source=sentence.address
    )


def _mda_relabelled(sentence: Sentence, at: Instant) -> PressureReading:
    """The pressure if bar holds hectopascals, as with some instruments (Lambrecht's met[LOG] documents it for its MMB)."""
    pressure_hpa = sentence.number_if_any(2)
    if pressure_hpa is None or not is_air(pressure_hpa):
        as_sent = [
            f"{sentence.field(i)} {unit}" for i, unit in ((0, "inches"), (2, "bar")) if sentence.field(i)
        ]
        raise NoReadingError(
            f"{sentence.address} says {' and '.join(as_sent)}: no air pressure"
            if as_sent
            else f"{sentence.address} has no pressure now"
        )
    return pressure_reading(
        pressure_hpa,
        _air_c(sentence),
        at,
        resolution_hpa=_step_hpa(sentence.field(2), 1.0),
        source=sentence.address,
        remark=f"says {sentence.field(2)} bar: taken for hPa",
    )


def _air_c(sentence: Sentence) -> float | None:
    air_c = sentence.number_if_any(4) if sentence.kind == "MDA" else None
    return air_c if air_c is not None and PLAUSIBLE_C[0] <= air_c <= PLAUSIBLE_C[1] else None


def _step_hpa(text: str, hpa_per_unit: float) -> float:
    """Resolution of a pressure: by its digits; trailing zeros count as fillers, up to 1 hPa."""
    filled_hpa = step_of(text) * hpa_per_unit
    return max(_written_hpa(text, hpa_per_unit), min(filled_hpa, COARSEST_FILLED_HPA))


def _written_hpa(text: str, hpa_per_unit: float) -> float:
    return 10.0 ** -len(text.partition(".")[2]) * hpa_per_unit


def pressure_reading(
    pressure_hpa: float,
    temperature_c: float | None,
    at: Instant,
    *,
    resolution_hpa: float = 0.0,
    source: str = "",
    remark: str | None = None,
) -> PressureReading:
    """A reading, if the pressure occurs on land."""
    if not is_air(pressure_hpa):
        raise NoReadingError(f"{pressure_hpa:g} hPa is no air pressure")
    return PressureReading(
        pressure_hpa,
        temperature_c,
        at.monotonic_s,
        at.utc,
        resolution_hpa=resolution_hpa,
        source=source,
        remark=remark,
    )
