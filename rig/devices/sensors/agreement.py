"""Several sources of one quantity on one line: combined if they agree, an error if they do not."""

from rig.devices.readings import PressureReading
from rig.errors import DeviceError
from rig.fault_notes import note_fault

RELABELLED = "the value can be nothing else"
AGREE_HPA = 1.5
"""Difference of good barometers in the same air; more means another place, another unit, or another quantity."""


def one_pressure_source(name: str, readings: list[PressureReading]) -> list[PressureReading]:
    """The readings of the source with the finest resolution, if all agree with it; else ``DeviceError`` with their
    values.
    """
    for remark in {reading.remark for reading in readings if reading.remark}:
        note_fault(name, remark, RELABELLED)
    by_source: dict[str, list[PressureReading]] = {}
    for reading in readings:
        by_source.setdefault(reading.source, []).append(reading)
    means = {
        source: sum(each.pressure_hpa for each in some) / len(some) for source, some in by_source.items()
    }
    steps = {source: min(each.resolution_hpa for each in some) for source, some in by_source.items()}
    best = min(by_source, key=lambda source: steps[source])
    for source, mean_hpa in means.items():
        if abs(mean_hpa - means[best]) > AGREE_HPA + (steps[source] + steps[best]) / 2.0:
            values = " and ".join(f"{each} {means[each]:.1f} hPa" for each in (best, source))
            raise DeviceError(
                name, f"its sources do not agree: {values}", "name the right one with [altimeter] transducer"
            )
    return by_source[best]
