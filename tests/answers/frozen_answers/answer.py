"""What the search answers to a question, as it is frozen: rounded to what is meaningful."""

import json
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BaseModel, ConfigDict

from frozen_answers.inputs import Fingerprint, Look, Question
from localizer import Dem, Fix, SkyfixError, Tracker, locate, lonlat_to_rowcol, rowcol_to_metric
from localizer.experiments import ground_distance_m

Candidate = tuple[float, float, float, float]
"""Easting, northing, probability, larger sigma: metres."""


class Answer(BaseModel):
    """The answer to one look. Absent: not applicable, as a position where there is none."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    status: str
    """Of the fix; or ``refused``: bad input, ``reason`` is the message; or ``error``: a defect of the program."""
    reason: str | None = None
    searched: str | None = None
    """Of a drive: where the search looked."""
    crs: str | None = None
    easting_m: float | None = None
    northing_m: float | None = None
    row: float | None = None
    col: float | None = None
    off_m: float | None = None
    """Distance from the truth."""
    covariance_m2: tuple[float, float, float] | None = None
    """East-east, east-north, north-north."""
    probability: float = 0.0
    elsewhere: float = 1.0
    candidates: tuple[Candidate, ...] = ()
    evidence: float | None = None
    inlier_share: float | None = None
    dem_error_m: float | None = None
    correlation_columns: float | None = None
    prior_chi2: float | None = None
    azimuth_bias_deg: float | None = None
    tilt_bias_deg: float | None = None
    altitude_bias_m: float | None = None
    points: int | None = None
    """Points of the contours that were used."""
    left_out: str | None = None
    """Labels of frames that contradict the others."""


class Frozen(BaseModel):
    """One line of the file: a case with the fingerprint of its input, and an answer for each look."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    case: str
    input: tuple[str | float, ...]
    answers: tuple[Answer, ...]

    @property
    def fingerprint(self) -> Fingerprint:
        """Of its input."""
        text, *numbers = self.input
        return Fingerprint(str(text), tuple(float(number) for number in numbers))

    def to_line(self) -> str:
        """As one line of JSON."""
        content = self.model_dump(exclude_defaults=True)
        return json.dumps(content, separators=(",", ":"), ensure_ascii=False)


def read_frozen(path: Path) -> dict[str, Frozen]:
    """The cases of a file, by name. Raises OSError, and ValueError for a line that is none."""
    lines = path.read_text(encoding="utf-8").splitlines()
    cases = [Frozen.model_validate_json(line) for line in lines if line.strip()]
    return {case.case: case for case in cases}


def write_frozen(path: Path, cases: Iterable[Frozen]) -> None:
    """One line a case, sorted by name."""
    lines = [case.to_line() for case in sorted(cases, key=lambda case: case.case)]
    path.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")


def answers_to(question: Question, folder: Path) -> tuple[Answer, ...]:
    """Search. What the localizer refuses is an answer too."""
    try:
        dem = question.ground.load(folder)
        if question.drive:
            return _of_a_drive(question.looks, dem)
        return tuple(_of_a_look(look, dem) for look in question.looks)
    except SkyfixError as error:
        return (Answer(status="refused", reason=str(error).replace(f"{folder}/", "")),)


def _of_a_look(look: Look, dem: Dem) -> Answer:
    result = locate(look.measurement, dem)
    errors, frames = result.details.errors, result.details.frames
    left_out = ",".join(frame.label for frame in frames if frame.left_out)
    sigmas_m = [_larger_sigma_m(covariance) for covariance in result.details.candidate_covariances_m2]
    candidates = [
        (candidate.easting_m, candidate.northing_m, candidate.probability, sigma_m)
        for candidate, sigma_m in zip(result.fix.candidates, sigmas_m, strict=True)
    ]
    answer = _of_a_fix(result.fix, look, dem, candidates)
    return answer.model_copy(
        update={
            "points": sum(int(frame.used.sum()) for frame in frames),
            "left_out": left_out or None,
            **(
                {
                    "evidence": round(errors.evidence, 3),
                    "inlier_share": round(errors.inlier_share, 4),
                    "dem_error_m": _significant(errors.dem_error_m, 5),
                    "correlation_columns": _significant(errors.correlation_columns, 5),
                    "prior_chi2": round(errors.prior_chi2, 3),
                }
                if errors is not None
                else {}
            ),
        }
    )


def _of_a_drive(looks: Sequence[Look], dem: Dem) -> tuple[Answer, ...]:
    tracker, answers = Tracker(), []
    for look in looks:
        step = tracker.step(look.measurement, dem, movement=look.movement)
        tracker = step.tracker
        places = [
            (place.easting_m, place.northing_m, place.probability, _larger_sigma_m(place.covariance_m2))
            for place in step.hypotheses
        ]
        answer = _of_a_fix(step.fix, look, dem, places)
        answers.append(
            answer.model_copy(
                update={
                    "searched": step.searched,
                    "left_out": step.left_out,
                    "elsewhere": round(step.elsewhere, 9),
                    "evidence": round(tracker.look_evidence, 3),
                }
            )
        )
    return tuple(answers)


def _of_a_fix(fix: Fix, look: Look, dem: Dem, candidates: Sequence[Candidate]) -> Answer:
    answer = Answer(
        status=fix.status,
        reason=fix.reason.code if fix.reason else None,
        probability=round(fix.probability, 9),
        elsewhere=round(fix.elsewhere, 9),
        candidates=tuple(
            (round(east, 2), round(north, 2), round(probability, 7), _significant(sigma_m, 5))
            for east, north, probability, sigma_m in candidates
        ),
    )
    at, covariance, errors = fix.position, fix.covariance_m2, fix.nuisance
    if at is None or covariance is None or errors is None:
        return answer
    off_m = None
    if look.truth is not None:
        true_x, true_y = rowcol_to_metric(dem, *lonlat_to_rowcol(dem, *look.truth))
        there = float(true_x), float(true_y)
        off_m = round(float(ground_distance_m(at.crs, at.easting_northing_m, there)), 2)
    return answer.model_copy(
        update={
            "crs": at.crs if len(at.crs) < 40 else at.crs[:40],
            "easting_m": round(at.easting_m, 3),
            "northing_m": round(at.northing_m, 3),
            "row": round(at.row, 4),
            "col": round(at.col, 4),
            "off_m": off_m,
            "covariance_m2": tuple(
                _significant(value, 6) for value in (covariance[0][0], covariance[0][1], covariance[1][1])
            ),
            "azimuth_bias_deg": round(errors.azimuth_bias_deg, 5),
            "tilt_bias_deg": round(errors.tilt_bias_deg, 5),
            "altitude_bias_m": round(errors.altitude_bias_m, 3),
        }
    )


def _larger_sigma_m(covariance_m2: ArrayLike) -> float:
    return float(np.sqrt(np.linalg.eigvalsh(np.asarray(covariance_m2, np.float64))[-1]))


def _significant(value: float, digits: int) -> float:
    return float(f"{value:.{digits}g}")
