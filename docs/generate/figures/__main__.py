"""Draw all figures into ``docs/figures``, or those that are named."""

import sys
from collections.abc import Callable

from generate.figures import coverage, curvature, decision, errors, geometry, likelihood, stage1, stage2
from generate.figures.drawing import FOLDER

FIGURES: dict[str, Callable[[], None]] = {
    "geometry": geometry.draw,
    "curvature": curvature.draw,
    "stage1-profile": stage1.draw_profile,
    "stage1-map": stage1.draw_map,
    "stage2": stage2.draw,
    "likelihood": likelihood.draw,
    "errors": errors.draw,
    "ellipse": coverage.draw_ellipse_of_a_fix,
    "coverage": coverage.draw_coverage,
    "decision": decision.draw,
}


def main() -> int:
    """Status 2 where a name is of no figure."""
    names = sys.argv[1:] or list(FIGURES)
    unknown = [name for name in names if name not in FIGURES]
    if unknown:
        print(f"no figure {unknown[0]!r}; there are {', '.join(FIGURES)}", file=sys.stderr)
        return 2
    FOLDER.mkdir(exist_ok=True)
    for name in names:
        FIGURES[name]()
        print(name)
    return 0


if __name__ == "__main__":
    sys.exit(main())
