"""Compares a found skyline with the known one, in px at a width of 1000 px."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from localizer import ColumnState, Skyline
from localizer.experiments import CONFIDENT

Floats = NDArray[np.float64]

REFERENCE_WIDTH_PX = 1000.0
FAR_OFF_PX = 10.0
"""At REFERENCE_WIDTH_PX: smaller errors are tracing accuracy, larger ones another line in the picture."""
MOSTLY = 0.05
"""Share of far-off columns from which a picture counts as failed, by their position."""


@dataclass(frozen=True)
class PictureScore:
    """One picture, or several together.

    Attributes:
        error_px: (n,) found minus true row of the columns that both have, px at REFERENCE_WIDTH_PX, down is positive.
        confident: (n,) which of these were declared confident.
        columns: columns in which sky is seen over terrain and the truth is known.
    """

    error_px: Floats
    confident: NDArray[np.bool_]
    columns: int

    def size_px(self, *, confident_only: bool) -> Floats:
        """Sizes of the errors."""
        return np.abs(self.error_px[self.confident] if confident_only else self.error_px)

    @property
    def confident_share(self) -> float:
        """Share of the columns with sky over terrain that are declared confident."""
        return float(self.confident.sum() / self.columns) if self.columns else float("nan")

    @property
    def above_share(self) -> float:
        """Share of the confident columns far above the truth: a cloud, haze, a streak in the sky."""
        return self._share(self.error_px < -FAR_OFF_PX)

    @property
    def below_share(self) -> float:
        """Share of the confident columns far below the truth: a nearer ridge, the edge of snow or shade."""
        return self._share(self.error_px > FAR_OFF_PX)

    def _share(self, which: NDArray[np.bool_]) -> float:
        number = int(self.confident.sum())
        return float((which & self.confident).sum() / number) if number else 0.0

    def figures(self) -> dict[str, float | int | str | None]:
        """As JSON values: the confident columns' errors in px at REFERENCE_WIDTH_PX, and shares; None where there are none."""
        size_px = self.size_px(confident_only=True)
        some = size_px.size > 0
        return {
            "columns": self.columns,
            "confident_share": self.confident_share if self.columns else None,
            "median_px": float(np.median(size_px)) if some else None,
            "p95_px": float(np.percentile(size_px, 95)) if some else None,
            "far_off_share": float(np.mean(size_px > FAR_OFF_PX)) if some else None,
            "above_share": self.above_share,
            "below_share": self.below_share,
            "verdict": self.verdict,
        }

    @property
    def verdict(self) -> str:
        """The verdict in two words."""
        if self.above_share >= MOSTLY and self.above_share >= self.below_share:
            return "above it"
        if self.below_share >= MOSTLY:
            return "below it"
        return "ok" if self.confident_share >= 0.5 else "mostly silent"


def score_skyline(found: Skyline, true_row_px: Floats, height_px: int) -> PictureScore:
    """Compare a found skyline with the true rows (width,), NaN where unknown.

    Columns whose true row lies outside the picture show no skyline and do not count.
    """
    with np.errstate(invalid="ignore"):
        known = (true_row_px >= 0.0) & (true_row_px <= height_px - 1.0)
    both = known & np.isfinite(found.row_px)
    scale = REFERENCE_WIDTH_PX / len(true_row_px)
    confident = (found.confidence >= CONFIDENT) & (found.state == ColumnState.OK)
    return PictureScore(
        error_px=(found.row_px - true_row_px)[both] * scale,
        confident=confident[both],
        columns=int(known.sum()),
    )


def combined_score(scores: Sequence[PictureScore]) -> PictureScore:
    """The score of all columns of several pictures."""
    return PictureScore(
        error_px=np.concatenate([s.error_px for s in scores]),
        confident=np.concatenate([s.confident for s in scores]),
        columns=sum(s.columns for s in scores),
    )
