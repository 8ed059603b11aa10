"""The evaluation on photographs: skylines of all pictures and of degraded ones, and position searches."""

import math
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

from localizer import find_skyline
from sim.errors import SimulationError
from sim.evaluate.photos import tables
from sim.evaluate.photos.degraded_pictures import degraded_pictures
from sim.evaluate.photos.position_search import Trial, search, terrain_of
from sim.evaluate.photos.skyline_score import PictureScore, score_skyline
from sim.evaluate.photos.source import existing
from sim.evaluate.photos.standpoints import standpoints
from sim.evaluate.photos.traced_pictures import TracedPicture, traced_pictures


@dataclass(frozen=True)
class PhotoEvaluation:
    """The results of the evaluation."""

    pictures: Sequence[tables.Scored]
    degraded: Sequence[tuple[str, PictureScore]]
    trials: Sequence[Trial]

    @property
    def wrong_fixes(self) -> list[Trial]:
        """The searches with a fix at a wrong place."""
        return [t for t in self.trials if t.verdict == "WRONG"]

    def fields(self) -> dict[str, Any]:
        """Every picture and every search as JSON values; null for what is not a number."""
        return {
            "pictures": [
                {"dataset": dataset, "name": name, "half": half, **score.figures()}
                for dataset, name, half, score in self.pictures
            ],
            "made_harder": [{"change": change, **score.figures()} for change, score in self.degraded],
            "places": [_json_values(asdict(trial)) for trial in self.trials],
        }

    def markdown(self) -> str:
        """All tables with their summaries."""
        return "\n\n".join(
            [
                "## Skylines: found against known, px at 1000 px width",
                "Confident columns but for those headed 'all columns'.",
                tables.skyline_summary(self.pictures),
                "Pictures that failed:",
                tables.skyline_failures(self.pictures),
                "Made harder on purpose:",
                tables.degraded_table(self.degraded),
                "## Places: the whole DEM searched",
                tables.position_summary(self.trials),
                tables.position_table(self.trials),
            ]
        )


def _json_values(values: dict[str, Any]) -> dict[str, Any]:
    return {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in values.items()}


def evaluate_photos(
    data_dir: Path, out_dir: Path | None, progress: Callable[[str], None] = lambda line: None
) -> PhotoEvaluation:
    """Run the evaluation on a data folder, which is only read.

    `out_dir`: folder for photos.md, photos_skylines.csv and photos_places.csv, if any. `progress` is called for each
    step.

    Raises SimulationError for data that are missing or broken, and if `out_dir` cannot be written.
    """
    existing(data_dir)
    traced = list(traced_pictures(data_dir))
    pictures = []
    for picture in traced:
        score = _score(picture)
        pictures.append((picture.dataset, picture.name, picture.half, score))
        progress(f"{picture.dataset} {picture.name}: skyline {score.verdict}")
    degraded = []
    for change, picture in degraded_pictures(traced):
        degraded.append((change, _score(picture)))
        progress(f"{picture.dataset} {picture.name}, {change}: skyline {degraded[-1][1].verdict}")
    evaluation = PhotoEvaluation(pictures, degraded, _search_all(data_dir, progress))
    if out_dir is not None:
        _write(evaluation, out_dir)
    return evaluation


def _score(picture: TracedPicture) -> PictureScore:
    return score_skyline(find_skyline(picture.image_bgr), picture.true_row_px, picture.image_bgr.shape[0])


def _search_all(data_dir: Path, progress: Callable[[str], None]) -> list[Trial]:
    trials = []
    with tempfile.TemporaryDirectory(prefix="skyfix-photos-") as work:
        places = standpoints(data_dir, Path(work))
        for _, same_dem in groupby(places, key=lambda place: (place.dem, place.dem_nodata)):
            terrain = None
            for place in same_dem:
                terrain = terrain or terrain_of(place)
                for trial in search(place, terrain):
                    trials.append(trial)
                    progress(
                        f"{trial.dataset} {trial.name}, skyline {trial.skyline}, heading {trial.heading},"
                        f" altitude {trial.altitude}: {trial.verdict}"
                    )
    return trials


def _write(evaluation: PhotoEvaluation, out_dir: Path) -> None:
    try:
        out_dir.mkdir(parents=True, exist_ok=True)
        (out_dir / "photos.md").write_text(evaluation.markdown() + "\n", encoding="utf-8")
        tables.write_skyline_csv(out_dir / "photos_skylines.csv", evaluation.pictures)
        tables.write_position_csv(out_dir / "photos_places.csv", evaluation.trials)
    except OSError as error:
        raise SimulationError(f"{out_dir}: {error.strerror or error}; choose another --out") from error
