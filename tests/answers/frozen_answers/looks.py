"""What a rig observes from a place: contours or pictures by sim, readings with errors drawn from a seed."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

import sim
from frozen_answers.ground import Grid
from frozen_answers.inputs import Look
from localizer import (
    Altitude,
    Bundle,
    Camera,
    Frame,
    FrameObservation,
    Observation,
    Prior,
    PriorCircle,
    load_bundle,
)

Floats = NDArray[np.float64]
QUARTERS = (0.0, 90.0, 180.0, 270.0)
MAST_M = 2.0
TAKEN = datetime(2026, 11, 24, 12, 0, 0, tzinfo=UTC)
STEEPEST_DEG = 25.0


@dataclass(frozen=True)
class Lens:
    """A camera of 66 degrees. Fewer columns than the rig's, for speed."""

    width_px: int = 240
    height_px: int = 180
    view_deg: float = 66.0
    distortion: tuple[float, float, float, float, float] = (-0.06, 0.012, 0.0004, -0.0003, 0.0)

    @property
    def focal_px(self) -> float:
        return float(0.5 * self.width_px / np.tan(np.radians(0.5 * self.view_deg)))

    def intrinsics(self) -> dict[str, Any]:
        """As localizer's camera and sim's take them."""
        return {
            "width_px": self.width_px,
            "height_px": self.height_px,
            "fx_px": self.focal_px,
            "fy_px": self.focal_px,
            "cx_px": 0.5 * (self.width_px - 1),
            "cy_px": 0.5 * (self.height_px - 1),
            "distortion": self.distortion,
        }


@dataclass(frozen=True)
class Rig:
    """The sigmas that the rig states. ``wrong``: errors beside those that are drawn, as a broken sensor has them."""

    lens: Lens = Lens()
    azimuths_deg: Sequence[float] = QUARTERS
    altitude_sigma_m: float | None = 5.0
    azimuth_bias_sigma_deg: float = 1.0
    tilt_bias_sigma_deg: float = 0.05
    azimuth_sigma_deg: float = 0.1
    tilt_sigma_deg: float = 0.01
    roll_sigma_deg: float = 0.05
    contour_px: float = 0.3
    lean_deg: float = 2.0
    mast_m: float = MAST_M
    wrong_altitude_m: float = 0.0
    wrong_azimuth_deg: float = 0.0
    wrong_tilt_deg: float = 0.0
    wrong_frames: dict[int, float] = field(default_factory=dict)
    """Azimuth in degrees that a frame really looks at, by its number."""


@dataclass(frozen=True)
class Shot:
    """One frame: where the camera looks and what the sensors say; azimuth, tilt, roll in degrees."""

    label: str
    true: tuple[float, float, float]
    measured: tuple[float, float, float]


def place(
    grid: Grid,
    folder: Path,
    *,
    at: tuple[float, float] | None = None,
    seed: int = 1,
    rig: Rig | None = None,
    enclosed: float = 0.8,
    margin_m: float = 500.0,
    conditions: dict[str, Any] | None = None,
) -> sim.World:
    """A camera on the true surface: at a row and column, or at a place drawn from the seed."""
    rig = rig or Rig()
    where: dict[str, Any] = {"edge_margin_m": margin_m, "enclosed_fraction": enclosed}
    if at is not None:
        where["lon_deg"], where["lat_deg"] = grid.lonlat_deg(*at)
    scenario = sim.Scenario.model_validate(
        {
            **(conditions or {}),
            "place": where,
            "vehicle": {"mast_height_m": rig.mast_m},
            "camera": {**(conditions or {}).get("camera", {}), **rig.lens.intrinsics()},
        }
    )
    return sim.World.create([grid.write(folder / "truth.tif")], scenario, seed)


def contours(world: sim.World, rig: Rig, seed: int, prior: PriorCircle | None = None) -> Look:
    """The exact skyline with white noise, as the search takes it."""
    rng = np.random.default_rng([seed, 1])
    intrinsics = Camera(**rig.lens.intrinsics())
    frames = []
    for shot in _shots(world, rig, seed):
        rows_px = sim.true_skyline(world, *shot.true)
        rows_px = rows_px + rig.contour_px * rng.standard_normal(len(rows_px))
        seen = np.isfinite(rows_px)
        frames.append(
            FrameObservation(
                label=shot.label,
                camera=intrinsics,
                azimuth_deg=shot.measured[0],
                azimuth_sigma_deg=rig.azimuth_sigma_deg,
                tilt_deg=shot.measured[1],
                tilt_sigma_deg=rig.tilt_sigma_deg,
                roll_deg=shot.measured[2],
                roll_sigma_deg=rig.roll_sigma_deg,
                u_px=np.nonzero(seen)[0].astype(np.float64),
                v_px=rows_px[seen],
                sigma_px=np.full(int(seen.sum()), max(rig.contour_px, 0.05)),
            )
        )
    observation = Observation(
        frames=tuple(frames),
        mast_height_m=rig.mast_m,
        altitude_m=_altitude_m(world, rig, seed),
        altitude_sigma_m=rig.altitude_sigma_m or np.inf,
        azimuth_bias_sigma_deg=rig.azimuth_bias_sigma_deg,
        tilt_bias_sigma_deg=rig.tilt_bias_sigma_deg,
        prior=prior,
    )
    return Look(observation, (world.place.lon_deg, world.place.lat_deg))


def pictures(
    world: sim.World,
    rig: Rig,
    seed: int,
    folder: Path,
    *,
    quarter_turns: int = 0,
    fog: Sequence[int] = (),
    prior: PriorCircle | None = None,
) -> Look:
    """A bundle with pictures. ``quarter_turns``: how the camera is mounted; ``fog``: frames that show nothing."""
    bundle = folder / "bundle"
    (bundle / "frames").mkdir(parents=True)
    panorama = sim.render_panorama(world)
    frames = []
    for number, shot in enumerate(_shots(world, rig, seed)):
        picture = sim.render_view(world, *shot.true, panorama=panorama)
        if number in fog:
            picture = np.full_like(picture, 190)
        picture = np.ascontiguousarray(np.rot90(picture, quarter_turns))  # the camera turned clockwise
        content = cv2.imencode(".png", picture)[1].tobytes()
        name = f"frames/{shot.label}.png"
        (bundle / name).write_bytes(content)
        frames.append(
            Frame(
                label=shot.label,
                file=name,
                sha256=hashlib.sha256(content).hexdigest(),
                time=TAKEN,
                azimuth_deg=shot.measured[0],
                azimuth_sigma_deg=rig.azimuth_sigma_deg,
                tilt_deg=shot.measured[1],
                tilt_sigma_deg=rig.tilt_sigma_deg,
                roll_deg=(shot.measured[2] + 90.0 * quarter_turns + 180.0) % 360.0 - 180.0,
                roll_sigma_deg=rig.roll_sigma_deg,
            )
        )
    intrinsics = rig.lens.intrinsics()
    if quarter_turns % 2:
        intrinsics |= {"width_px": intrinsics["height_px"], "height_px": intrinsics["width_px"]}
        intrinsics |= {"cx_px": intrinsics["cy_px"], "cy_px": intrinsics["cx_px"]}
    altitude_m = _altitude_m(world, rig, seed)
    written = Bundle(
        id="bundle",
        created=TAKEN,
        camera=Camera(**intrinsics),
        mast_height_m=rig.mast_m,
        altitude=None
        if altitude_m is None or rig.altitude_sigma_m is None
        else Altitude(value_m=altitude_m, sigma_m=rig.altitude_sigma_m),
        azimuth_bias_sigma_deg=rig.azimuth_bias_sigma_deg,
        tilt_bias_sigma_deg=rig.tilt_bias_sigma_deg,
        frames=tuple(frames),
        prior=Prior(lat_deg=prior.lat_deg, lon_deg=prior.lon_deg, radius_m=prior.radius_m) if prior else None,
    )
    (bundle / "bundle.json").write_text(written.to_json(), encoding="utf-8")
    return Look(load_bundle(bundle), (world.place.lon_deg, world.place.lat_deg))


def circle(world: sim.World, radius_m: float, off_deg: tuple[float, float] = (0.0, 0.0)) -> PriorCircle:
    """Around the camera, or beside it by degrees of longitude and latitude."""
    return PriorCircle(world.place.lat_deg + off_deg[1], world.place.lon_deg + off_deg[0], radius_m)


def _shots(world: sim.World, rig: Rig, seed: int) -> list[Shot]:
    rng = np.random.default_rng([seed, 2])
    azimuth_bias_deg = rig.wrong_azimuth_deg + rig.azimuth_bias_sigma_deg * rng.standard_normal()
    tilt_bias_deg = rig.wrong_tilt_deg + rig.tilt_bias_sigma_deg * rng.standard_normal()
    lean_azimuth_deg = rng.uniform(0.0, 360.0)
    shots = []
    for number, azimuth_deg in enumerate(rig.azimuths_deg):
        own = rng.standard_normal(3) * (rig.azimuth_sigma_deg, rig.tilt_sigma_deg, rig.roll_sigma_deg)
        azimuth_deg += float(rng.uniform(-0.5, 0.5))
        looked_deg = rig.wrong_frames.get(number, azimuth_deg)
        tilt_deg = _aimed_tilt_deg(world, rig.lens, looked_deg)
        roll_deg = float(rig.lean_deg * np.sin(np.radians(lean_azimuth_deg - azimuth_deg)))
        measured = (
            float((azimuth_deg + azimuth_bias_deg + own[0]) % 360.0),
            float(tilt_deg + tilt_bias_deg + own[1]),
            float(roll_deg + own[2]),
        )
        shots.append(Shot(f"{number}", (looked_deg, tilt_deg, roll_deg), measured))
    return shots


def _altitude_m(world: sim.World, rig: Rig, seed: int) -> float | None:
    if rig.altitude_sigma_m is None:
        return None
    drawn_m = rig.altitude_sigma_m * np.random.default_rng([seed, 3]).standard_normal()
    return float(world.place.altitude_m + rig.wrong_altitude_m + drawn_m)


def _aimed_tilt_deg(world: sim.World, lens: Lens, azimuth_deg: float) -> float:
    """The tilt that puts the skyline about the middle of the picture; 0 where no skyline is seen."""
    tilt_deg = 0.0
    for _ in range(2):
        rows_px = sim.true_skyline(world, azimuth_deg, tilt_deg)
        if not np.isfinite(rows_px).any():
            return 0.0
        off_px = 0.5 * (lens.height_px - 1) - float(np.nanmedian(rows_px))
        tilt_deg += float(np.degrees(np.arctan(off_px / lens.focal_px)))
        tilt_deg = round(float(np.clip(tilt_deg, -STEEPEST_DEG, STEEPEST_DEG)), 1)
    return tilt_deg
