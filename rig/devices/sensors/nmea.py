"""Parsers of NMEA 0183 sentences of compasses and barometers. No I/O."""

from rig.devices.sensors.nmea_heading import parse_heading
from rig.devices.sensors.nmea_pressure import parse_pressure, pressure_reading
from rig.devices.sensors.nmea_sentence import Sentence, SentenceReader, checksum, parse_sentence

__all__ = [
    "Sentence",
    "SentenceReader",
    "checksum",
    "parse_heading",
    "parse_pressure",
    "parse_sentence",
    "pressure_reading",
]
