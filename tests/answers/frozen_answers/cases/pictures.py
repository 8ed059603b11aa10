"""Bundles with pictures that sim renders: weather, cameras, mountings, and frames that show something else."""

from functools import partial
from pathlib import Path
from typing import Any

from frozen_answers.ground import Ground, hills
from frozen_answers.inputs import Question
from frozen_answers.looks import QUARTERS, Lens, Rig, circle, pictures, place

SMALL = Lens(width_px=240, height_px=180)
PLAIN = Lens(width_px=240, height_px=180, distortion=(0.0, 0.0, 0.0, 0.0, 0.0))


def rendered(
    folder: Path,
    *,
    seed: int,
    rig: Rig | None = None,
    sees: dict[str, Any] | None = None,
    searched: Ground | None = None,
    around_m: float | None = None,
    **how: Any,
) -> Question:
    """``sees``: weather and camera of sim's scenario; ``around_m``: radius of a prior circle."""
    grid = hills(200, 40 * seed % 600, 70 * seed % 600)
    rig = rig or Rig(lens=SMALL)
    world = place(grid, folder, seed=seed, rig=rig, conditions=sees)
    prior = circle(world, around_m) if around_m else None
    return Question(searched or Ground((grid,)), (pictures(world, rig, seed, folder, prior=prior, **how),))


def _weather(**weather: Any) -> dict[str, Any]:
    return {"weather": weather}


def _camera(**camera: Any) -> dict[str, Any]:
    return {"camera": camera}


CASES = {
    **{f"drawn/{seed}": partial(rendered, seed=seed) for seed in range(1, 9)},
    **{
        f"sky-{sky}": partial(rendered, seed=seed, sees=_weather(sky=sky))
        for seed, sky in enumerate(("clear", "scattered", "broken", "overcast"), 10)
    },
    "haze-5-km": partial(rendered, seed=14, sees=_weather(visibility_km=5.0)),
    "haze-15-km": partial(rendered, seed=15, sees=_weather(visibility_km=15.0, sky="overcast")),
    "snow": partial(rendered, seed=16, sees=_weather(snow_line_m=300.0, sky="overcast")),
    "low-sun": partial(rendered, seed=17, sees=_weather(sun_elevation_deg=3.0, sky="clear")),
    "night-noise": partial(rendered, seed=18, sees=_camera(noise=12.0, exposure=0.4)),
    "overexposed": partial(rendered, seed=19, sees=_camera(exposure=2.2)),
    "blurred": partial(rendered, seed=20, sees=_camera(blur_px=2.5)),
    "vignetting": partial(rendered, seed=21, sees=_camera(vignetting=0.7)),
    "wide-lens": partial(rendered, seed=22, rig=Rig(lens=Lens(view_deg=90.0))),
    "long-lens": partial(rendered, seed=23, rig=Rig(lens=Lens(view_deg=30.0))),
    "large-pictures": partial(rendered, seed=24, rig=Rig(lens=Lens(width_px=640, height_px=480))),
    "turned-left": partial(rendered, seed=25, rig=Rig(lens=PLAIN), quarter_turns=1),
    "upside-down": partial(rendered, seed=26, rig=Rig(lens=PLAIN), quarter_turns=2),
    "turned-right": partial(rendered, seed=27, rig=Rig(lens=PLAIN), quarter_turns=3),
    "leaning": partial(rendered, seed=28, rig=Rig(lens=SMALL, lean_deg=8.0)),
    "one-frame-in-fog": partial(rendered, seed=29, fog=(2,)),
    "all-in-fog": partial(rendered, seed=30, fog=(0, 1, 2, 3)),
    "one-frame-elsewhere": partial(rendered, seed=31, rig=Rig(lens=SMALL, wrong_frames={1: 215.0})),
    "eight-frames": partial(
        rendered, seed=32, rig=Rig(lens=SMALL, azimuths_deg=tuple(45.0 * k for k in range(8)))
    ),
    "two-frames": partial(rendered, seed=33, rig=Rig(lens=SMALL, azimuths_deg=QUARTERS[:2])),
    "one-frame": partial(rendered, seed=34, rig=Rig(lens=SMALL, azimuths_deg=(130.0,))),
    "no-altitude": partial(rendered, seed=35, rig=Rig(lens=SMALL, altitude_sigma_m=None)),
    "no-compass": partial(rendered, seed=36, rig=Rig(lens=SMALL, azimuth_bias_sigma_deg=180.0)),
    "prior": partial(rendered, seed=37, around_m=800.0),
    "another-dem": partial(rendered, seed=38, searched=Ground((hills(80, 700, 700),))),
}
