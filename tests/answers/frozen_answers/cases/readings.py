"""What the sensors say: absent, wrong, more or less certain; few frames, and a circle that is known before."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from frozen_answers.ground import Ground, hills
from frozen_answers.inputs import Look, Question
from frozen_answers.looks import QUARTERS, Lens, Rig, circle, contours, place
from localizer import FrameObservation, Observation


def measured(
    folder: Path,
    *,
    rig: Rig | None = None,
    seed: int = 1,
    around_m: float | None = None,
    off_deg: tuple[float, float] = (0.0, 0.0),
) -> Question:
    """``around_m``, ``off_deg``: a circle beside the camera."""
    grid = hills(150, 300, 200)
    rig = rig or Rig()
    world = place(grid, folder, seed=seed, rig=rig)
    prior = circle(world, around_m, off_deg) if around_m else None
    return Question(Ground((grid,)), (contours(world, rig, seed, prior),))


def spoilt(folder: Path, *, how: str, seed: int = 2) -> Question:
    """Contours of which a part is wrong or missing."""
    question = measured(folder, seed=seed)
    look = question.looks[0]
    assert isinstance(look.measurement, Observation)
    frames = list(look.measurement.frames)
    rng = np.random.default_rng([seed, 6])
    match how:
        case "no-points":
            frames = [_some(frame, np.zeros(len(frame.u_px), bool)) for frame in frames]
        case "one-frame-without-points":
            frames[2] = _some(frames[2], np.zeros(len(frames[2].u_px), bool))
        case "every-tenth-column":
            frames = [_some(frame, frame.u_px % 10.0 == 0.0) for frame in frames]
        case "ten-columns":
            frames = [_some(frame, np.abs(frame.u_px - 120.0) < 5.0) for frame in frames]
        case "tree":
            frames[1] = _raised(frames[1], np.abs(frames[1].u_px - 100.0) < 15.0, 25.0)
        case "trees":
            frames = [_raised(frame, rng.random(len(frame.u_px)) < 0.3, 12.0) for frame in frames]
        case "one-frame-raised":
            frames[3] = _raised(frames[3], np.ones(len(frames[3].u_px), bool), 20.0)
        case "one-frame-flat":
            frames[0] = replace(frames[0], v_px=np.full_like(frames[0].v_px, 90.0))
        case "all-flat":
            frames = [replace(frame, v_px=np.full_like(frame.v_px, 90.0)) for frame in frames]
        case "outliers":
            for number, frame in enumerate(frames):
                wild = np.where(
                    rng.random(len(frame.v_px)) < 0.1, rng.normal(0.0, 30.0, len(frame.v_px)), 0.0
                )
                frames[number] = replace(frame, v_px=frame.v_px + wild)
        case "sigmas-too-small":
            frames = [replace(frame, sigma_px=0.1 * frame.sigma_px) for frame in frames]
        case "sigmas-too-large":
            frames = [replace(frame, sigma_px=10.0 * frame.sigma_px) for frame in frames]
        case "labels-swapped":
            frames[0], frames[2] = (
                replace(frames[0], azimuth_deg=frames[2].azimuth_deg),
                replace(frames[2], azimuth_deg=frames[0].azimuth_deg),
            )
        case _:
            frames = frames[::-1]
    changed = replace(look.measurement, frames=tuple(frames))
    return replace(question, looks=(Look(changed, look.truth),))


def _some(frame: FrameObservation, kept: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> FrameObservation:
    return replace(frame, u_px=frame.u_px[kept], v_px=frame.v_px[kept], sigma_px=frame.sigma_px[kept])


def _raised(
    frame: FrameObservation, where: np.ndarray[tuple[int], np.dtype[np.bool_]], by_px: float
) -> FrameObservation:
    return replace(frame, v_px=frame.v_px - np.where(where, by_px, 0.0))


NO_COMPASS = 180.0
CASES = {
    **{f"plain/{seed}": partial(measured, seed=seed) for seed in range(1, 5)},
    "no-altitude": partial(measured, rig=Rig(altitude_sigma_m=None)),
    "no-compass": partial(measured, rig=Rig(azimuth_bias_sigma_deg=NO_COMPASS)),
    "neither": partial(measured, rig=Rig(altitude_sigma_m=None, azimuth_bias_sigma_deg=NO_COMPASS)),
    "altitude-exact": partial(measured, rig=Rig(altitude_sigma_m=0.05)),
    "altitude-vague": partial(measured, rig=Rig(altitude_sigma_m=80.0)),
    **{
        f"altitude-wrong-{off:+g}-m": partial(measured, rig=Rig(wrong_altitude_m=off))
        for off in (15.0, -30.0, 60.0, -150.0, 3000.0)
    },
    **{
        f"heading-wrong-{off:+g}-deg": partial(measured, rig=Rig(wrong_azimuth_deg=off))
        for off in (3.0, -6.0, 12.0, 90.0)
    },
    **{
        f"tilt-wrong-{off:+g}-deg": partial(measured, rig=Rig(wrong_tilt_deg=off))
        for off in (0.15, -0.5, 3.0)
    },
    "compass-exact": partial(measured, rig=Rig(azimuth_bias_sigma_deg=0.01, azimuth_sigma_deg=0.01)),
    "compass-vague": partial(measured, rig=Rig(azimuth_bias_sigma_deg=15.0)),
    "tilt-vague": partial(measured, rig=Rig(tilt_bias_sigma_deg=1.0, tilt_sigma_deg=0.3)),
    "level-vague": partial(measured, rig=Rig(roll_sigma_deg=2.0)),
    "all-exact": partial(
        measured,
        rig=Rig(
            altitude_sigma_m=0.1,
            azimuth_bias_sigma_deg=0.005,
            tilt_bias_sigma_deg=0.005,
            azimuth_sigma_deg=0.005,
            tilt_sigma_deg=0.005,
            roll_sigma_deg=0.005,
            contour_px=0.0,
        ),
    ),
    "high-mast": partial(measured, rig=Rig(mast_m=15.0)),
    **{
        f"frames-{count}": partial(measured, rig=Rig(azimuths_deg=QUARTERS[:count]), seed=5)
        for count in (1, 2, 3)
    },
    "frames-12": partial(measured, rig=Rig(azimuths_deg=tuple(30.0 * k for k in range(12)))),
    "same-direction-twice": partial(measured, rig=Rig(azimuths_deg=(0.0, 0.0, 180.0, 180.0))),
    "one-frame-elsewhere": partial(measured, rig=Rig(wrong_frames={2: 60.0})),
    "two-frames-elsewhere": partial(measured, rig=Rig(wrong_frames={2: 60.0, 0: 140.0})),
    "narrow-view": partial(measured, rig=Rig(lens=Lens(view_deg=12.0))),
    "wide-view": partial(measured, rig=Rig(lens=Lens(view_deg=95.0, distortion=(0.0, 0.0, 0.0, 0.0, 0.0)))),
    "all-columns": partial(measured, rig=Rig(lens=Lens(width_px=640, height_px=480))),
    "noise-2-px": partial(measured, rig=Rig(contour_px=2.0)),
    "noise-8-px": partial(measured, rig=Rig(contour_px=8.0)),
    "prior-200-m": partial(measured, around_m=200.0),
    "prior-2-km": partial(measured, around_m=2000.0),
    "prior-all": partial(measured, around_m=50_000.0),
    "prior-one-cell": partial(measured, around_m=20.0),
    "prior-at-its-border": partial(measured, around_m=500.0, off_deg=(0.0055, 0.0)),
    "prior-beside": partial(measured, around_m=500.0, off_deg=(0.009, 0.0)),
    "prior-outside-the-dem": partial(measured, around_m=500.0, off_deg=(1.0, 0.0)),
    "prior-no-altitude": partial(measured, around_m=700.0, rig=Rig(altitude_sigma_m=None)),
    **{
        how: partial(spoilt, how=how)
        for how in (
            "no-points",
            "one-frame-without-points",
            "every-tenth-column",
            "ten-columns",
            "tree",
            "trees",
            "one-frame-raised",
            "one-frame-flat",
            "all-flat",
            "outliers",
            "sigmas-too-small",
            "sigmas-too-large",
            "labels-swapped",
            "frames-reversed",
        )
    },
}
