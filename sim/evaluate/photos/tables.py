"""The result tables, as markdown (for screen and documentation) and CSV."""

import csv
import io
import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import asdict, fields
from pathlib import Path

import numpy as np

from sim.evaluate.photos.position_search import Trial
from sim.evaluate.photos.skyline_score import FAR_OFF_PX, PictureScore, combined_score
from sim.evaluate.photos.traced_pictures import HELD_OUT, TUNED_ON

Scored = tuple[str, str, str, PictureScore]
"""Dataset, name, half, score."""

_SKYLINE_FIGURES = ("median", "95 %", f"> {FAR_OFF_PX:.0f} px", "far above", "far below", "confident")


def markdown(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A markdown table."""
    lines = [headings, ["---"] * len(headings), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def skyline_summary(pictures: Sequence[Scored]) -> str:
    """One row per dataset and half, for all columns and for the confident ones."""
    groups: dict[tuple[str, str], list[PictureScore]] = {}
    for dataset, _, half, score in pictures:
        for key in ((dataset, half), (dataset, ""), ("all", half), ("all", "")):
            groups.setdefault(key, []).append(score)
    order = [*dict.fromkeys(dataset for dataset, *_ in pictures), "all"]
    rows = []
    for dataset in order:
        for half in (TUNED_ON, HELD_OUT, ""):
            scores = groups.get((dataset, half))
            if scores:
                total = combined_score(scores)
                head = [dataset, half or "both", str(len(scores))]
                rows.append([*head, *_errors(total.size_px(confident_only=False)), *_figures(total)])
    every = [f"all columns: {figure}" for figure in _SKYLINE_FIGURES[:3]]
    return markdown(["pictures", "half", "number", *every, *_SKYLINE_FIGURES], rows)


def skyline_failures(pictures: Sequence[Scored]) -> str:
    """The pictures with defects."""
    rows = [
        [dataset, name, half, *_figures(score), score.verdict]
        for dataset, name, half, score in pictures
        if score.verdict != "ok"
    ]
    return markdown(["pictures", "name", "half", *_SKYLINE_FIGURES, "verdict"], rows)


def degraded_table(degraded: Sequence[tuple[str, PictureScore]]) -> str:
    """One row per degradation, for the confident columns of its pictures."""
    groups: dict[str, list[PictureScore]] = {}
    for name, score in degraded:
        groups.setdefault(name, []).append(score)
    rows = [[name, str(len(scores)), *_figures(combined_score(scores))] for name, scores in groups.items()]
    return markdown(["change", "number", *_SKYLINE_FIGURES], rows)


def position_table(trials: Sequence[Trial]) -> str:
    """One row per search; wrong ones are emphasised."""
    rows = []
    for t in trials:
        verdict = f"**{t.verdict}**" if t.verdict == "WRONG" else t.verdict
        rows.append(
            [
                t.dataset,
                t.name,
                t.skyline,
                t.heading,
                t.altitude,
                t.status,
                _number(t.error_m, 0),
                _number(t.sigma_m, 0),
                _number(t.truth_probability, 2),
                str(t.candidates),
                _number(t.evidence, 0),
                _number(t.inlier_share, 2),
                _number(t.dem_error_m, 1),
                _number(t.seconds, 1),
                verdict,
            ]
        )
    headings = [
        "pictures",
        "name",
        "skyline",
        "heading",
        "altitude",
        "status",
        "error m",
        "sigma m",
        "p(truth)",
    ]
    return markdown([*headings, "candidates", "evidence", "inliers", "DEM error m", "s", "verdict"], rows)


def position_summary(trials: Sequence[Trial]) -> str:
    """Number of each verdict, by dataset, skyline and known quantities."""
    groups: dict[tuple[str, str, str, str], Counter[str]] = {}
    for t in trials:
        groups.setdefault((t.dataset, t.skyline, t.heading, t.altitude), Counter())[t.verdict] += 1
    verdicts = ("right", "fair", "missed", "none", "WRONG")
    rows = [[*key, *(str(count[v]) for v in verdicts)] for key, count in groups.items()]
    return markdown(["pictures", "skyline", "heading", "altitude", *verdicts], rows)


def write_skyline_csv(path: Path, pictures: Sequence[Scored]) -> None:
    """Every picture's figures."""
    rows = [
        [dataset, name, half, score.columns, *_figures(score), score.verdict]
        for dataset, name, half, score in pictures
    ]
    _write_csv(path, ["pictures", "name", "half", "columns", *_SKYLINE_FIGURES, "verdict"], rows)


def write_position_csv(path: Path, trials: Sequence[Trial]) -> None:
    """Every search, all digits."""
    _write_csv(path, [f.name for f in fields(Trial)], [list(asdict(t).values()) for t in trials])


def _figures(score: PictureScore) -> list[str]:
    return [
        *_errors(score.size_px(confident_only=True)),
        _percent(score.above_share),
        _percent(score.below_share),
        _percent(score.confident_share),
    ]


def _errors(size_px: np.ndarray) -> list[str]:
    if not size_px.size:
        return ["-"] * 3
    return [
        f"{np.median(size_px):.2f}",
        f"{np.percentile(size_px, 95):.2f}",
        _percent(float(np.mean(size_px > FAR_OFF_PX))),
    ]


def _percent(share: float) -> str:
    return "-" if math.isnan(share) else f"{100.0 * share:.1f} %"


def _number(value: float, digits: int) -> str:
    return "-" if math.isnan(value) else f"{value:.{digits}f}"


def _write_csv(path: Path, headings: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(headings)
    writer.writerows(rows)
    path.write_text(text.getvalue(), encoding="utf-8")
