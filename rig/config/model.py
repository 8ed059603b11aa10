"""The whole configuration: consistency between sections, and calibrations that replace keys."""

import logging
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Self

from pydantic import PrivateAttr, ValidationError, model_validator

from rig.config.calibration_files import CALIBRATION_ORDER, AppliedCalibration, CalibrationError
from rig.config.conflicts import conflicts
from rig.config.keep_out import described, zone_at
from rig.config.problems import joined, wrong_value
from rig.config.section import Section
from rig.config.sections import AllSections, Mmc5983maSection

_log = logging.getLogger(__name__)


class RigConfig(AllSections):
    """The whole configuration file: immutable, checked, every key with its unit in its name.

    Attributes
    ----------
    rig, place, pan_tilt, inclinometer, compass, altimeter, camera, capture, calibration, run : section
        The file's tables; None where a table may be absent and is. ``configs/vehicle.toml`` explains each key.
    calibrations : tuple
        Those that have replaced keys of the sections.
    """

    _calibrations: tuple[AppliedCalibration, ...] = PrivateAttr(default=())

    @property
    def calibrations(self) -> tuple[AppliedCalibration, ...]:
        """The calibrations that are in force."""
        return self._calibrations

    @model_validator(mode="after")
    def _parts_fit_each_other(self) -> Self:
        pan = self.pan_tilt.pan
        for angle_deg in self.capture.base_attitude_pan_angles_deg:
            if not pan.min_deg <= angle_deg <= pan.max_deg:
                raise ValueError(
                    f"[capture] base_attitude_pan_angles_deg: {angle_deg:g} is beyond [pan_tilt.pan] "
                    f"min_deg {pan.min_deg:g} and max_deg {pan.max_deg:g}"
                )
            zone = zone_at((angle_deg, 0.0), self.pan_tilt.keep_out)
            if zone:
                raise ValueError(
                    f"[capture] base_attitude_pan_angles_deg: pan {angle_deg:g}, tilt 0 lies in the keep-out zone "
                    f"{described(zone)}"
                )
        if (
            isinstance(self.compass, Mmc5983maSection)
            and self.compass.declination_deg is None
            and self.place is None
        ):
            raise ValueError(
                "[compass] declination_deg: needed to get from magnetic to true north; give it, "
                "or the rough [place] to compute it from"
            )
        for conflict in conflicts(self):
            raise ValueError(conflict)
        return self


def with_calibrations(config: RigConfig, calibrations: Iterable[AppliedCalibration]) -> RigConfig:
    """The configuration with the values of calibrations in place of its own; later ones take precedence.

    ``CalibrationError`` for one that was made with another device than the configured one.
    """
    in_force = {each.document.kind: each for each in config.calibrations}
    for each in calibrations:
        kind = each.document.kind
        for name, made_with in each.document.based_on.items():
            if name in in_force and in_force[name].document.id != made_with:
                _log.warning(
                    "%s was made with %s, not with %s: calibrate the %s anew soon",
                    Path(each.file).name,
                    made_with,
                    in_force[name].document.id,
                    kind,
                )
        for name, made_for in each.document.made_for().items():
            misfit = _misfit(name, made_for, getattr(config, name))
            if misfit:
                raise CalibrationError(f"{each.file}: {misfit}; calibrate the {kind} anew")
        for name, keys in each.document.values().items():
            section = getattr(config, name)
            try:
                changed = type(section).model_validate({**section.model_dump(), **keys})
            except ValidationError as error:
                raise CalibrationError(
                    f"{each.file}: {joined([wrong_value(e, keys) for e in error.errors()])}"
                ) from error
            config = config.model_copy(update={name: changed})
        in_force[kind] = each
    config = config.model_copy()
    config._calibrations = tuple(in_force[kind] for kind in CALIBRATION_ORDER if kind in in_force)
    return config


def _misfit(name: str, made_for: Mapping[str, object] | None, section: Section | None) -> str | None:
    """Why a calibration's device does not match this section; None if it does."""
    if made_for is None or section is None:
        if made_for is None and section is None:
            return None
        return (
            f"was made {'without' if made_for is None else 'with'} a {name}, and the configuration has "
            + (f"no [{name}]" if section is None else f"a [{name}]")
        )
    there = {key: getattr(section, key, None) for key in made_for}
    return None if there == made_for else f"is for {_described(made_for)}, [{name}] says {_described(there)}"


def _described(keys: Mapping[str, object]) -> str:
    words = [f"{key} {list(value) if isinstance(value, tuple) else value}" for key, value in keys.items()]
    return ", ".join(words)
