"""Trial of the calibrations: uncalibrated simulated rigs, calibrated by the real ``rig calibrate`` and judged by their
bundles.

Each rig is calibrated in the documented order at a place recommended by ``rig calibrate sites``, takes a bundle there,
and another one at a random place after some driving.
"""

import csv
import json
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass, fields
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sim.documents import toml_file
from sim.errors import SimulationError
from sim.launch.launcher import SimulatedRig, simulated_rig
from sim.launch.operator import Done, operate, turn_asked_deg
from sim.render.calibration_target import CalibrationTargetPictures
from sim.render.panorama import render_panorama
from sim.render.renderer import Renderer
from sim.rigs.bundle_deviation import BundleDeviation, CameraLog, bundle_deviation
from sim.rigs.parallel import run_in_parallel
from sim.world.mechanics import Rotation
from sim.world.scenario import Scenario
from sim.world.truth import World

DRIVE_H = 0.25
TAKE_UP_DEG = 1.5
CAMERA_TIMEOUT_S = 15.0
STEERING_SIGMA_DEG = 8.0
LIMITS = {
    "tilt_deg": 0.02,
    "roll_deg": 0.05,
    "relative_azimuth_deg": 0.1,
    "azimuth_by_compass_deg": 0.5,
    "azimuth_by_boresight_deg": 0.05,
    "altitude_m": 3.0,
}
"""Limits of the errors of a calibrated rig's bundle."""


@dataclass(frozen=True)
class RigResult:
    """One rig: its initial errors, the remaining ones in its bundles, or why it was rejected.

    Tilt, roll and relative azimuth are the larger error of both bundles; azimuth by compass and altitude are those of
    the other place, azimuth by boresight that of the known place.
    """

    seed: int
    refused: str
    boresight_azimuth_deg: float = np.nan
    boresight_tilt_deg: float = np.nan
    boresight_roll_deg: float = np.nan
    inclinometer_zero_mg: float = np.nan
    tilt_deg: float = np.nan
    roll_deg: float = np.nan
    relative_azimuth_deg: float = np.nan
    azimuth_by_compass_deg: float = np.nan
    azimuth_by_boresight_deg: float = np.nan
    altitude_m: float = np.nan
    claimed_tilt_deg: float = np.nan
    claimed_azimuth_deg: float = np.nan
    claimed_altitude_m: float = np.nan

    @property
    def within(self) -> bool:
        """Whether every error is within its limit."""
        return not self.refused and all(abs(getattr(self, name)) <= limit for name, limit in LIMITS.items())


class _CameraScene:
    """The camera's scene: the world, or the calibration target while it is held up. Logs the camera's attitude."""

    def __init__(self, world: World) -> None:
        self.log = CameraLog()
        self._renderer = Renderer(world, render_panorama(world))
        self._target = CalibrationTargetPictures(world.scenario.camera, world.rng("board"))
        self.board_is_up = False

    def picture(self, rotation: Rotation, rng: np.random.Generator) -> NDArray[np.uint8]:
        """A picture of ``launcher.Picture``."""
        if self.board_is_up:
            return self._target.frame()
        self.log.note(rotation)
        return self._renderer.frame(rotation, rng)


def calibrate_rigs(
    dem_paths: Sequence[Path],
    scenario: Scenario,
    seeds: Sequence[int],
    jobs: int,
    on_result: Callable[[RigResult], None],
    keep: Path | None,
) -> list[RigResult]:
    """Calibrate one rig for each seed, ``jobs`` at a time.

    ``on_result`` is called for each finished rig, ``keep`` is a folder for files and bundles. An early end stops the
    running ones.
    """
    one = partial(calibrate_rig, list(dem_paths), scenario, keep=keep)
    results = []
    with closing(run_in_parallel(one, seeds, jobs)) as done:
        for result in done:
            on_result(result)
            results.append(result)
    return sorted(results, key=lambda result: result.seed)


def calibrate_rig(
    dem_paths: Sequence[Path], scenario: Scenario, seed: int, keep: Path | None = None
) -> RigResult:
    """Calibrate one rig and judge its bundles."""
    try:
        world = World.create(dem_paths, _at_good_site(dem_paths, scenario, seed), seed)
    except SimulationError as error:
        return RigResult(seed, str(error))
    with tempfile.TemporaryDirectory(prefix="skyfix-rigs-") as scratch:
        folder = Path(scratch)
        try:
            errors = _errors(dem_paths, scenario, world, folder)
        except SimulationError as error:
            return RigResult(seed, str(error), **_initial_errors(world))
        else:
            _write_errors(folder / "errors.json", world, *errors)
        finally:
            if keep is not None:
                shutil.copytree(folder, keep / f"rig-{seed}", dirs_exist_ok=True)
    return _result(seed, world, *errors)


def write_csv(results: Sequence[RigResult], path: Path) -> None:
    """Write one row per rig."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, [field.name for field in fields(RigResult)])
            writer.writeheader()
            writer.writerows(asdict(result) for result in results)
    except OSError as error:
        raise SimulationError(f"{path}: cannot be written: {error.strerror}; choose another --csv") from error


def _errors(
    dem_paths: Sequence[Path], scenario: Scenario, world: World, folder: Path
) -> tuple[BundleDeviation, BundleDeviation]:
    """Errors of the bundle at the known place, and of that at the other place."""
    with _running(world, None) as (rig, sight):
        files = _calibrate(rig, sight, world, dem_paths, folder)
        known = _capture(rig, sight, world, folder / "known")
    elsewhere = World.create(dem_paths, _at_next_stop(scenario), world.seed)
    with _running(elsewhere, files) as (rig, sight):
        other = _capture(rig, sight, elsewhere, folder / "other")
    return known, other


@contextmanager
def _running(
    world: World, calibration: dict[str, Path] | None
) -> Iterator[tuple[SimulatedRig, _CameraScene]]:
    sight = _CameraScene(world)
    with simulated_rig(world, picture=sight.picture, calibration=calibration) as rig:
        config = rig.config_path.read_text(encoding="utf-8")
        # As a careful installer configures it: backlash stays on one side.
        config = config.replace("[pan_tilt]\n", f"[pan_tilt]\ntake_up_deg = {TAKE_UP_DEG}\n")
        # Parallel rigs render slowly; camera timeouts are not tested here.
        config = config.replace(
            "[camera]\n",
            f"[camera]\nopen_timeout_s = {CAMERA_TIMEOUT_S}\nread_timeout_s = {CAMERA_TIMEOUT_S}\n",
        )
        rig.config_path.write_text(config)
        yield rig, sight


def _at_good_site(dem_paths: Sequence[Path], scenario: Scenario, seed: int) -> Scenario:
    """The scenario at the best nearby place recommended by the tool."""
    start = World.create(dem_paths, scenario, seed).place
    dem = [word for path in dem_paths for word in ("--dem", str(path))]
    near = f"{start.lat_deg:.5f},{start.lon_deg:.5f}"
    command = [
        "rig",
        "calibrate",
        "sites",
        "--near",
        near,
        *dem,
        "--mast",
        str(scenario.vehicle.mast_height_m),
    ]
    done = operate([*command, "--count", "1", "--json"], {}, lambda line: None, lambda line: None)
    _require(done)
    best = json.loads(done.out)[0]
    place = scenario.place.model_copy(update={key: best[key] for key in ("lat_deg", "lon_deg")})
    return scenario.model_copy(update={"place": place})


def _at_next_stop(scenario: Scenario) -> Scenario:
    """The scenario of the next stop of the same trip."""
    place = scenario.place.model_copy(
        update={"stop": scenario.place.stop + 1, "lat_deg": None, "lon_deg": None}
    )
    age_h = scenario.altimeter.reference_age_h + DRIVE_H
    altimeter = scenario.altimeter.model_copy(update={"reference_age_h": age_h})
    return scenario.model_copy(update={"place": place, "altimeter": altimeter})


def _calibrate(
    rig: SimulatedRig, sight: _CameraScene, world: World, dem_paths: Sequence[Path], folder: Path
) -> dict[str, Path]:
    """Run all five calibrations in order; their files by kind."""
    driving = world.rng("steering")
    air_c = world.air_temperature_c + world.biases.reference_temperature_error_c
    at = ["--at", f"{world.place.lat_deg:.7f},{world.place.lon_deg:.7f}"]
    dem = [word for path in dem_paths for word in ("--dem", str(path))]

    def act(line: str) -> None:
        turn_deg = turn_asked_deg(line)
        if turn_deg is not None:
            world.mechanics.turn_vehicle(turn_deg + float(driving.normal(0.0, STEERING_SIGMA_DEG)))

    for kind, *options in (
        ("camera",),
        ("inclinometer",),
        ("compass", "--headings", "6", "--angles", "5"),
        ("altimeter", *at, *dem, "--air", f"{air_c:.1f}"),
        ("boresight", *at, *dem),
    ):
        sight.board_is_up = kind == "camera"
        command = ["rig", "calibrate", kind, *options, "--out", str(folder / "calibration")]
        _require(operate(command, rig.environment, act, lambda line: None))
    named = toml_file("configuration", rig.config_path)["calibration"]
    return {kind: (rig.config_path.parent / file).resolve() for kind, file in named.items()}


def _capture(rig: SimulatedRig, sight: _CameraScene, world: World, out: Path) -> BundleDeviation:
    done = operate(
        ["rig", "capture", "--out", str(out)], rig.environment, lambda line: None, lambda line: None
    )
    _require(done)
    return bundle_deviation(Path(done.out.splitlines()[-1]), world, sight.log)


def _require(done: Done) -> None:
    if done.status:
        raise SimulationError(done.last_line)


def _write_errors(path: Path, world: World, known: BundleDeviation, other: BundleDeviation) -> None:
    """Write the rig's initial errors and the remaining ones of each frame, to trace an error to its step."""
    content = {"biases": asdict(world.biases), "known": asdict(known), "other": asdict(other)}
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def _initial_errors(world: World) -> dict[str, float]:
    biases = world.biases
    return {
        "boresight_azimuth_deg": biases.boresight.heading_deg,
        "boresight_tilt_deg": biases.boresight.pitch_deg,
        "boresight_roll_deg": biases.boresight.roll_deg,
        "inclinometer_zero_mg": float(np.linalg.norm(biases.inclinometer_offset_mg)),
    }


def _result(seed: int, world: World, known: BundleDeviation, other: BundleDeviation) -> RigResult:
    return RigResult(
        seed,
        "",
        **_initial_errors(world),
        tilt_deg=max(known.tilt_deg, other.tilt_deg, key=abs),
        roll_deg=max(known.roll_deg, other.roll_deg, key=abs),
        relative_azimuth_deg=max(known.relative_azimuth_deg, other.relative_azimuth_deg, key=abs),
        azimuth_by_compass_deg=other.azimuth_bias_deg,
        azimuth_by_boresight_deg=known.azimuth_bias_deg,
        altitude_m=other.altitude_m,
        claimed_tilt_deg=other.claimed_tilt_deg,
        claimed_azimuth_deg=other.claimed_azimuth_deg,
        claimed_altitude_m=other.claimed_altitude_m,
    )
