"""The search from end to end: from a bundle, or an observation, to a result. See ``localizer.search`` for its stages."""

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from localizer.bundle import Bundle
from localizer.dem.horizon import Terrain, horizon, horizon_around
from localizer.dem.lattice import Dem
from localizer.dem.prepared import prepared
from localizer.fix import Fix
from localizer.observation import FrameObservation, Observation, PriorCircle
from localizer.search.altitude_reference import diagnose_altimeter, with_datum_uncertainty
from localizer.search.answer import Located, fix_of
from localizer.search.coarse_to_fine import RankedCells, likeliest_cells
from localizer.search.contours import BINS, FrameContour, MeasuredSkyline, frame_contour, measured_skyline
from localizer.search.decide import Decision, no_place, with_refined_best
from localizer.search.details import LocateResult
from localizer.search.fit.refine import Refined
from localizer.search.frame_details import details_of, usable_columns
from localizer.search.leave_one_out import CheckedAnswer, check_frames
from localizer.search.prior_circle import cells_within_prior
from localizer.search.reasons import no_ground_at_altitude, no_match, no_skyline
from localizer.search.selection import refined_on_exact_dem, select_place
from localizer.search.stage1 import Band, Stage1, bands, heading_offsets_deg, search_stage1
from localizer.search.stage2 import search_stage2
from localizer.skyline.find import Skyline, find_skyline
from localizer.skyline.upright import frame_skyline, upright

Floats = NDArray[np.float64]

LEAST_ALTITUDE_SIGMA_M = 0.01
"""Least sigma of an altitude; a smaller one is implausible and makes the normal equations singular."""
LEADING_CELLS = 30
"""If these leading cells are the same, so is the selection among them."""
LEAST_SIGMA_PX = 0.15
"""Least sigma of a skyline point in a picture: lens calibration, blur and rounded crests."""


@dataclass
class _Stopwatch:
    """Wall time of each part of the search, seconds."""

    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        begin = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - begin


def locate_bundle(bundle: Bundle, dem: Dem) -> LocateResult:
    """Find the skyline in each frame of a bundle, and the place in the DEM from which it is seen."""
    stopwatch = _Stopwatch()
    with stopwatch.part("prepare"):
        terrain = prepared(dem)
        load_kernels(terrain)
    with stopwatch.part("horizon"):
        skylines = [frame_skyline(bundle, frame) for frame in bundle.frames]
    observation = with_datum_uncertainty(observe(bundle, skylines), dem)
    located = locate(terrain, observation)
    timing = {**stopwatch.seconds, **located.timing_s}
    with stopwatch.part("frames"):
        checked = check_located(terrain, observation, located)
    timing["frames"] = stopwatch.seconds["frames"]
    fix = diagnosed_fix(terrain, observation, checked.located, bundle.id, timing)
    return LocateResult(fix, details_of(terrain, bundle, observation, skylines, checked))


def check_located(terrain: Terrain, observation: Observation, located: Located) -> CheckedAnswer:
    """How each frame fits the answer of a search, and the answer without a frame that contradicts the others."""
    return check_frames(terrain, observation, located, partial(_locate_once, terrain))


def diagnosed_fix(
    terrain: Terrain,
    observation: Observation,
    located: Located,
    name: str,
    timing_s: dict[str, float],
    within_s: float = math.inf,
) -> Fix:
    """The fix of a search; where that found no place, its reason says whether the altitude is to blame.

    ``name``: what the fix calls the bundle. ``within_s``: as of ``diagnose_altimeter``.
    """
    fix = fix_of(terrain, observation, located, name, timing_s)
    return diagnose_altimeter(terrain, observation, fix, partial(_locate_once, terrain), within_s)


def _locate_once(terrain: Terrain, observation: Observation) -> Located:
    """For a search that is tried again with less: one that fits nowhere is not repeated over all cells."""
    return locate(terrain, observation, retry_all_cells=False)


def load_kernels(terrain: Terrain) -> None:
    """Compile the search's kernels, or load compiled ones from the disk, by calls with empty input.

    Later calls in a process cost nothing. Without this the first search would take longer.
    """
    no_cells, empty = np.zeros((0, 2), np.int64), np.zeros(0)
    no_skyline_seen = MeasuredSkyline(np.full(BINS, np.nan), np.full(BINS, np.nan), np.zeros(BINS), {})
    unbounded = [Band("", 0.0, np.array([-np.inf]), np.array([np.inf]))]
    search_stage1(terrain, unbounded, 0.0, 0.0, 0.0, 0.0, np.zeros(terrain.height_m.shape, bool))
    search_stage2(terrain, no_skyline_seen, no_cells, empty, empty, np.zeros(1), 1.0, 1.0, 90.0)
    horizon(terrain, empty, empty, empty, empty)
    horizon_around(terrain, 0.0, 0.0, 0.0, empty)
    load_picture_kernels()


def load_picture_kernels() -> None:
    """The same for the kernels of the skyline detector, by a small picture that has a skyline."""
    picture = np.full((64, 64, 3), 200, np.uint8)
    picture[32:] = 60
    find_skyline(picture)


def observe(bundle: Bundle, skylines: list[Skyline]) -> Observation:
    """The search's input: the confident columns of each frame, turned upright, and the bundle's readings."""
    frames = []
    for frame, skyline in zip(bundle.frames, skylines, strict=True):
        used = usable_columns(skyline)
        turned = upright(bundle.camera, frame.roll_deg)
        frames.append(
            FrameObservation(
                label=frame.label,
                camera=turned.camera,
                azimuth_deg=frame.azimuth_deg,
                azimuth_sigma_deg=frame.azimuth_sigma_deg,
                tilt_deg=frame.tilt_deg,
                tilt_sigma_deg=frame.tilt_sigma_deg,
                roll_deg=turned.roll_deg,
                roll_sigma_deg=frame.roll_sigma_deg,
                u_px=np.nonzero(used)[0].astype(float),
                v_px=skyline.row_px[used],
                sigma_px=np.hypot(skyline.sigma_px[used], LEAST_SIGMA_PX),
            )
        )
    prior = bundle.prior
    return Observation(
        frames=tuple(frames),
        mast_height_m=bundle.mast_height_m,
        altitude_m=bundle.altitude.value_m if bundle.altitude else None,
        altitude_sigma_m=max(bundle.altitude.sigma_m, LEAST_ALTITUDE_SIGMA_M) if bundle.altitude else np.inf,
        azimuth_bias_sigma_deg=bundle.azimuth_bias_sigma_deg,
        tilt_bias_sigma_deg=bundle.tilt_bias_sigma_deg,
        prior=PriorCircle(prior.lat_deg, prior.lon_deg, prior.radius_m) if prior else None,
    )


def locate(terrain: Terrain, observation: Observation, *, retry_all_cells: bool = True) -> Located:
    """Search the whole DEM for the place from which the terrain has the observed skyline.

    ``retry_all_cells``: if nothing fits, stage 2 is repeated over all cells at the right altitude, which takes longer. An exact
    DEM is first searched with the default error model.
    """
    if terrain.exact:
        return _refined_on_exact_dem(
            terrain,
            observation,
            locate(terrain.with_error_model(), observation, retry_all_cells=retry_all_cells),
        )
    stopwatch = _Stopwatch()
    contours = _contours(observation)
    if not contours:
        nothing = Stage1(int(np.isfinite(terrain.dem.z_m).sum()), {"altitude": np.zeros((0, 2), np.int64)}, 0)
        return Located(no_place(no_skyline()), None, nothing, stopwatch.seconds)
    skyline = measured_skyline(observation, contours)
    offsets = heading_offsets_deg(observation.azimuth_bias_sigma_deg)
    with stopwatch.part("stage1"):
        stage1 = search_stage1(
            terrain,
            bands(skyline, offsets),
            observation.mast_height_m,
            observation.altitude_m,
            observation.altitude_sigma_m,
            terrain.nominal_error_m,
            cells_within_prior(terrain, observation),
        )
    if observation.altitude_m is not None and len(stage1.survivors["altitude"]) == 0:
        return Located(
            no_place(no_ground_at_altitude(observation.altitude_m)), None, stage1, stopwatch.seconds
        )
    ranked = _ranked_by_stage2(terrain, observation, skyline, stage1.last, offsets, stopwatch)
    decision, best = _decided(terrain, observation, contours, ranked, stopwatch)
    if retry_all_cells and decision.status == "none" and len(stage1.last) < len(stage1.survivors["altitude"]):
        # A central column may show a cloud or a tree: compare whole curves at every cell at the right altitude.
        retried = _ranked_by_stage2(
            terrain, observation, skyline, stage1.survivors["altitude"], offsets, stopwatch
        )
        if ranked is None or retried is None or not _same_leading_cells(retried, ranked):
            decision, best = _decided(terrain, observation, contours, retried, stopwatch)
    return Located(decision, best, stage1, stopwatch.seconds)


def _refined_on_exact_dem(terrain: Terrain, observation: Observation, found: Located) -> Located:
    """The result of the search with an error model, its best place refitted with the DEM as exact."""
    if found.best is None:
        return found
    stopwatch = _Stopwatch(found.timing_s)
    with stopwatch.part("refine"):
        best = refined_on_exact_dem(terrain, observation, _contours(observation), found.best)
    decision = with_refined_best(found.decision, best, terrain.cell_m)
    return replace(found, decision=decision, best=best, timing_s=stopwatch.seconds)


def _contours(observation: Observation) -> tuple[FrameContour, ...]:
    """The contours of the frames that have one."""
    return tuple(frame_contour(frame) for frame in observation.frames if len(frame.u_px) > 1)


def _ranked_by_stage2(
    terrain: Terrain,
    observation: Observation,
    skyline: MeasuredSkyline,
    cells: NDArray[np.int64],
    offsets: Floats,
    stopwatch: _Stopwatch,
) -> RankedCells | None:
    """Stage 2 among the given cells; None without any."""
    if len(cells) == 0:
        return None
    with stopwatch.part("stage2"):
        return likeliest_cells(terrain, observation, skyline, cells, offsets)


def _same_leading_cells(one: RankedCells, other: RankedCells) -> bool:
    """Whether the selection would be the same."""
    return np.array_equal(one.scored.cells[:LEADING_CELLS], other.scored.cells[:LEADING_CELLS])


def _decided(
    terrain: Terrain,
    observation: Observation,
    contours: tuple[FrameContour, ...],
    ranked: RankedCells | None,
    stopwatch: _Stopwatch,
) -> tuple[Decision, Refined | None]:
    """Refinement and decision among the best cells of stage 2."""
    if ranked is None:
        return no_place(no_match(360.0)), None
    with stopwatch.part("refine"):
        return select_place(terrain, observation, contours, ranked)
