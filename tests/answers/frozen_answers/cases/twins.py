"""Two or three valleys that look the same: as likely as each other, or told apart by a detail."""

from functools import partial
from pathlib import Path

import numpy as np

from frozen_answers.ground import CRATER, Grid, Ground, crater, side_by_side
from frozen_answers.inputs import Question
from frozen_answers.looks import Rig, circle, contours, place

HILLOCK = (50.0, 72.0)
"""Row and column in a crater, in view of all of its floor."""


def valleys(
    folder: Path,
    *,
    seed: int,
    copies: int = 2,
    stands_in: int = 0,
    hillock_in: tuple[int, ...] = (),
    relief_m: float = 0.0,
    gap: bool = False,
    rig: Rig | None = None,
    around_m: float | None = None,
) -> Question:
    """``relief_m``: rms of random heights added to all copies but the first; ``gap``: another crater between them."""
    craters = [crater(seed, [HILLOCK] if copy in hillock_in else []) for copy in range(copies)]
    rng = np.random.default_rng([seed, 5])
    craters[1:] = [height_m + relief_m * rng.standard_normal(height_m.shape) for height_m in craters[1:]]
    if gap:
        craters = [craters[0], *[part for other in craters[1:] for part in (crater(seed + 500), other)]]
    grid = side_by_side(craters)
    rig = rig or Rig()
    step = 2 if gap else 1
    spot = 44.0 + 8.0 * rng.random(), 44.0 + 8.0 * rng.random() + CRATER * stands_in * step
    world = place(grid, folder, at=spot, seed=seed, rig=rig)
    prior = circle(world, around_m) if around_m else None
    return Question(Ground((grid,)), (contours(world, rig, seed, prior),))


def in_a_row_of_files(folder: Path, *, seed: int, order: tuple[int, ...]) -> Question:
    """Equal valleys, each in a file of its own, named in this order."""
    grid = side_by_side([crater(seed)] * len(order))
    world = place(grid, folder, at=(47.3, 46.1 + CRATER), seed=seed)
    parts = [grid.piece(slice(None), slice(CRATER * k, CRATER * (k + 1))) for k in order]
    return Question(Ground(tuple(parts)), (contours(world, Rig(), seed),))


def one_above_the_other(folder: Path, *, seed: int) -> Question:
    """From north to south: to be as likely as from west to east."""
    beside = side_by_side([crater(seed)] * 2)
    grid = Grid(np.vstack([crater(seed)] * 2), beside.transform)
    world = place(grid, folder, at=(45.5 + CRATER, 50.2), seed=seed)
    return Question(Ground((grid,)), (contours(world, Rig(), seed),))


CASES = {
    **{f"two/{seed}": partial(valleys, seed=seed, stands_in=seed % 2) for seed in (1, 2, 3)},
    **{f"three/{seed}": partial(valleys, seed=seed, copies=3, stands_in=seed % 3) for seed in (11, 12)},
    **{f"two-apart/{seed}": partial(valleys, seed=seed, gap=True, stands_in=1) for seed in (21,)},
    **{
        f"three-hillock/{seed}": partial(
            valleys, seed=seed, copies=3, stands_in=seed % 3, hillock_in=(seed % 2, 2)
        )
        for seed in (31, 32)
    },
    **{
        f"relief-{relief:g}-m/{seed}": partial(valleys, seed=seed, stands_in=seed % 2, relief_m=relief)
        for relief in (1.0, 3.0, 10.0)
        for seed in (41, 42)
    },
    **{
        f"noise-{px:g}-px": partial(valleys, seed=51, stands_in=1, rig=Rig(contour_px=px))
        for px in (0.05, 1.0, 3.0)
    },
    "no-altitude": partial(valleys, seed=52, rig=Rig(altitude_sigma_m=None)),
    "no-compass": partial(valleys, seed=53, rig=Rig(azimuth_bias_sigma_deg=180.0)),
    "prior-around-one": partial(valleys, seed=54, stands_in=1, around_m=1000.0),
    "prior-around-all": partial(valleys, seed=55, stands_in=1, around_m=9000.0),
    "one-frame": partial(valleys, seed=56, rig=Rig(azimuths_deg=(100.0,))),
    "six": partial(valleys, seed=57, copies=6, stands_in=4),
    "files-in-order": partial(in_a_row_of_files, seed=58, order=(0, 1, 2)),
    "files-out-of-order": partial(in_a_row_of_files, seed=58, order=(2, 0, 1)),
    "one-above-the-other": partial(one_above_the_other, seed=59),
}
