"""The localizer's main job: from what was seen to where it was seen from."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from localizer.bundle import Bundle
from localizer.camera import camera_to_world, project
from localizer.dem.datum import UNKNOWN_DATUM_M
from localizer.dem.geodesy import lonlat_to_rowcol
from localizer.dem.horizon import Terrain, at_rim, horizon, horizon_around
from localizer.dem.lattice import Dem
from localizer.dem.prepared import prepared
from localizer.observation import FrameObservation, Observation, PriorCircle
from localizer.search.answer import Located, fix_of, metric_covariance
from localizer.search.contest import contest, sharpened
from localizer.search.contours import BINS, FrameContour, MeasuredSkyline, frame_contour, measured_skyline
from localizer.search.contradiction import Settled, settle_frames
from localizer.search.decide import Decision, answered_with, nowhere
from localizer.search.details import FrameDetail, LocateDetails, LocateResult, SolvedErrors
from localizer.search.doubts import altitude_as_trusted, without_altimeter
from localizer.search.fit.refine import Refined
from localizer.search.reasons import fits_nowhere, no_ground_at_altitude, no_skyline
from localizer.search.rounds import Ranked, likeliest_cells
from localizer.search.stage1 import Band, Stage1, bands, heading_offsets_deg, search_stage1
from localizer.search.stage2 import search_stage2
from localizer.skyline.find import CONFIDENT, ColumnState, Skyline, find_skyline
from localizer.skyline.upright import frame_skyline, upright

Floats = NDArray[np.float64]

SMALLEST_SIGMA_M = 0.01
"""Of an altimeter; less is a promise that nobody keeps and that the equations cannot be solved with."""
FIRST_CELLS = 30
"""Cells whose contest has been held: the same ones would come to the same."""
SMALLEST_SIGMA_PX = 0.15
"""No skyline in a picture is known better than this: lens, blur and the roundness of things."""


@dataclass
class _Watch:
    """Seconds spent in each part."""

    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        begin = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - begin


def locate_bundle(bundle: Bundle, dem: Dem) -> LocateResult:
    """Find the skyline in each frame of a bundle and the place in the DEM that has it."""
    watch = _Watch()
    with watch.part("prepare"):
        terrain = prepared(dem)
        load_kernels(terrain)
    with watch.part("horizon"):
        skylines = [frame_skyline(bundle, frame) for frame in bundle.frames]
    observation = altitude_as_trusted(observe(bundle, skylines), dem)
    located = locate(terrain, observation)
    timing = {**watch.seconds, **located.timing_s}
    with watch.part("frames"):
        settled = settle_frames(
            terrain, observation, located, lambda fewer: locate(terrain, fewer, everywhere=False)
        )
    timing["frames"] = watch.seconds["frames"]
    fix = fix_of(terrain, observation, settled.located, bundle.id, timing)
    fix = without_altimeter(terrain, observation, fix, lambda blind: locate(terrain, blind, everywhere=False))
    return LocateResult(fix, _details(terrain, bundle, observation, skylines, settled))


def load_kernels(terrain: Terrain) -> None:
    """Compile the search's kernels, or load them where that was done before, on no data at all.

    Once in a process; later calls cost nothing. Without it the first search would pay for it.
    """
    nowhere, nothing = np.zeros((0, 2), np.int64), np.zeros(0)
    blind = MeasuredSkyline(np.full(BINS, np.nan), np.full(BINS, np.nan), np.zeros(BINS), {})
    any_way = [Band("", 0.0, np.array([-np.inf]), np.array([np.inf]))]
    search_stage1(terrain, any_way, 0.0, 0.0, 0.0, 0.0, np.zeros(terrain.height_m.shape, bool))
    search_stage2(terrain, blind, nowhere, nothing, nothing, np.zeros(1), 1.0, 1.0, 90.0)
    horizon(terrain, nothing, nothing, nothing, nothing)
    horizon_around(terrain, 0.0, 0.0, 0.0, nothing)
    load_picture_kernels()


def load_picture_kernels() -> None:
    """Of these those that find a skyline, in a picture that has one: without it most have nothing to do."""
    picture = np.full((64, 64, 3), 200, np.uint8)
    picture[32:] = 60
    find_skyline(picture)


def observe(bundle: Bundle, skylines: list[Skyline]) -> Observation:
    """What the search is given: the confident columns of each frame, turned upright, and the bundle's readings."""
    frames = []
    for frame, skyline in zip(bundle.frames, skylines, strict=True):
        used = _usable(skyline)
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
                sigma_px=np.hypot(skyline.sigma_px[used], SMALLEST_SIGMA_PX),
            )
        )
    prior = bundle.prior
    return Observation(
        frames=tuple(frames),
        mast_height_m=bundle.mast_height_m,
        altitude_m=bundle.altitude.value_m if bundle.altitude else None,
        altitude_sigma_m=max(bundle.altitude.sigma_m, SMALLEST_SIGMA_M) if bundle.altitude else np.inf,
        azimuth_bias_sigma_deg=bundle.azimuth_bias_sigma_deg,
        tilt_bias_sigma_deg=bundle.tilt_bias_sigma_deg,
        prior=PriorCircle(prior.lat_deg, prior.lon_deg, prior.radius_m) if prior else None,
    )


def locate(terrain: Terrain, observation: Observation, *, everywhere: bool = True) -> Located:
    """Search the whole DEM for the place from which the terrain has the observed skyline.

    Not ``everywhere``: only the cells that stage 1 leaves, which is quick. In a DEM that is said to be the terrain itself the
    place is first looked for as in any other.
    """
    if terrain.exact:
        return _with_its_word(
            terrain, observation, locate(terrain.doubted(), observation, everywhere=everywhere)
        )
    watch = _Watch()
    seen = _contours(observation)
    if not seen:
        nothing = Stage1(int(np.isfinite(terrain.dem.z_m).sum()), {"altitude": np.zeros((0, 2), np.int64)}, 0)
        return Located(nowhere(no_skyline()), None, nothing, watch.seconds)
    skyline = measured_skyline(observation, seen)
    offsets = heading_offsets_deg(observation.azimuth_bias_sigma_deg)
    with watch.part("stage1"):
        stage1 = search_stage1(
            terrain,
            bands(skyline, offsets),
            observation.mast_height_m,
            observation.altitude_m,
            observation.altitude_sigma_m,
            terrain.usual_error_m,
            _within_prior(terrain, observation),
        )
    if observation.altitude_m is not None and len(stage1.survivors["altitude"]) == 0:
        return Located(nowhere(no_ground_at_altitude(observation.altitude_m)), None, stage1, watch.seconds)
    ranked = _ranked(terrain, observation, skyline, stage1.last, offsets, watch)
    decision, best = _decided(terrain, observation, seen, ranked, watch)
    if everywhere and decision.status == "none" and len(stage1.last) < len(stage1.survivors["altitude"]):
        # A central column may show a cloud or a tree: let whole curves speak about every cell at the right altitude.
        anew = _ranked(terrain, observation, skyline, stage1.survivors["altitude"], offsets, watch)
        if ranked is None or anew is None or not _same_cells(anew, ranked):
            decision, best = _decided(terrain, observation, seen, anew, watch)
    return Located(decision, best, stage1, watch.seconds)


def _with_its_word(terrain: Terrain, observation: Observation, found: Located) -> Located:
    """What was found with doubts about the DEM, with the DEM taken at its word."""
    if found.best is None:
        return found
    watch = _Watch(found.timing_s)
    with watch.part("refine"):
        best = sharpened(terrain, observation, _contours(observation), found.best)
    decision = answered_with(found.decision, best, terrain.cell_m)
    return replace(found, decision=decision, best=best, timing_s=watch.seconds)


def _contours(observation: Observation) -> tuple[FrameContour, ...]:
    """Of the frames that have any."""
    return tuple(frame_contour(frame) for frame in observation.frames if len(frame.u_px) > 1)


def _ranked(
    terrain: Terrain,
    observation: Observation,
    skyline: MeasuredSkyline,
    cells: NDArray[np.int64],
    offsets: Floats,
    watch: _Watch,
) -> Ranked | None:
    """Stage 2 among the given cells, if there are any."""
    if len(cells) == 0:
        return None
    with watch.part("stage2"):
        return likeliest_cells(terrain, observation, skyline, cells, offsets)


def _same_cells(one: Ranked, other: Ranked) -> bool:
    """Whether the contest would be the same again."""
    return np.array_equal(one.scored.cells[:FIRST_CELLS], other.scored.cells[:FIRST_CELLS])


def _decided(
    terrain: Terrain,
    observation: Observation,
    contours: tuple[FrameContour, ...],
    ranked: Ranked | None,
    watch: _Watch,
) -> tuple[Decision, Refined | None]:
    """Refinement and decision among the cells that stage 2 found best."""
    if ranked is None:
        return nowhere(fits_nowhere(360.0)), None
    with watch.part("refine"):
        return contest(terrain, observation, contours, ranked)


def _within_prior(terrain: Terrain, observation: Observation) -> NDArray[np.bool_] | None:
    """Cells (rows, cols) inside the prior's circle; None without a prior."""
    prior = observation.prior
    if prior is None:
        return None
    dem = terrain.dem
    row, col = (float(value) for value in lonlat_to_rowcol(dem, prior.lon_deg, prior.lat_deg))
    within = np.zeros((dem.rows, dem.cols), bool)
    if not np.isfinite([row, col]).all():
        return within
    frame = terrain.frames.at(np.clip(row, 0, dem.rows), np.clip(col, 0, dem.cols))[0]
    to_ground = np.linalg.inv(
        frame[:, :2]
    )  # from rows and columns to metres east and north, as it is at the centre
    doubt_m = 0.0 if dem.shift.known else UNKNOWN_DATUM_M  # the circle is told on WGS84
    radius_m = prior.radius_m + doubt_m
    reach = 1.5 * radius_m * np.abs(frame[:, :2]).sum(axis=1) + 2.0
    first = np.clip(np.floor([row - reach[0], col - reach[1]]), 0, (dem.rows, dem.cols)).astype(int)
    end = np.clip(np.ceil([row + reach[0], col + reach[1]]) + 1, 0, (dem.rows, dem.cols)).astype(int)
    if (end <= first).any():
        return within
    steps = np.stack(
        np.meshgrid(np.arange(first[0], end[0]) - row, np.arange(first[1], end[1]) - col, indexing="ij")
    )
    off_m = np.tensordot(to_ground, steps, axes=1)
    for _ in range(2):  # of a circle of many kilometres the second order counts
        e, n = off_m
        bent = np.tensordot(frame[:, 2:], np.array([e * e, e * n, n * n]), axes=1)
        off_m = np.tensordot(to_ground, steps - bent, axes=1)
    within[first[0] : end[0], first[1] : end[1]] = np.hypot(*off_m) <= radius_m
    return within


def _usable(skyline: Skyline) -> NDArray[np.bool_]:
    return np.asarray(
        (skyline.state == ColumnState.OK) & (skyline.confidence >= CONFIDENT) & np.isfinite(skyline.row_px)
    )


def _details(
    terrain: Terrain,
    bundle: Bundle,
    observation: Observation,
    skylines: list[Skyline],
    settled: Settled,
) -> LocateDetails:
    """What the picture shows: found and predicted skylines, survivors and candidates."""
    located = settled.located
    best = located.best
    errors = iter(best.frame_errors_deg) if best else iter(())
    frames = []
    for recorded, frame, skyline in zip(bundle.frames, observation.frames, skylines, strict=True):
        turned = upright(bundle.camera, recorded.roll_deg)
        camera = turned.camera
        found = np.isfinite(skyline.row_px)
        u = v = np.zeros(0)
        rim_share = 0.0
        left_out = frame.label == settled.left_out
        solved = best is not None and len(frame.u_px) > 1 and not left_out
        own = next(errors) if solved else np.zeros(3)
        if best is not None:
            attitude = (
                frame.azimuth_deg - best.azimuth_bias_deg - own[0],
                frame.tilt_deg - best.tilt_bias_deg - own[1],
                frame.roll_deg - own[2],
            )
            half_view = np.degrees(np.arctan(camera.width_px / camera.fx_px)) + 5.0
            azimuth = attitude[0] + np.arange(-half_view, half_view, 0.05)
            elevation, distance_m = horizon(terrain, best.row, best.col, best.altitude_m, azimuth)
            u, v = project(camera, camera_to_world(*attitude), azimuth, elevation[0])
            inside = (u >= -1.0) & (u <= camera.width_px)
            u, v = u[inside], v[inside]
            if inside.any() and not terrain.exact:
                seen_m = distance_m[0][inside]
                rim_share = float(
                    at_rim(terrain, best.row, best.col, np.radians(azimuth[inside]), seen_m).mean()
                )
        found_u, found_v = turned.as_recorded(np.nonzero(found)[0].astype(float), skyline.row_px[found])
        u, v = turned.as_recorded(u, v)
        frames.append(
            FrameDetail(
                label=frame.label,
                found_u_px=found_u,
                found_v_px=found_v,
                used=_usable(skyline)[found],
                predicted_u_px=u,
                predicted_v_px=v,
                errors_deg=(float(own[0]), float(own[1]), float(own[2])) if solved else None,
                agreement=settled.agreement.get(frame.label),
                left_out=left_out,
                rim_share=rim_share,
                quarters=turned.quarters,
            )
        )
    candidates = located.decision.candidates
    return LocateDetails(
        tuple(frames),
        located.stage1.survivors,
        np.array([[c.row, c.col] for c in candidates]).reshape(-1, 2),
        np.array([metric_covariance(terrain, c) for c in candidates]).reshape(-1, 2, 2),
        None if best is None else _solved_errors(best),
    )


def _solved_errors(best: Refined) -> SolvedErrors:
    return SolvedErrors(
        altitude_m=best.altitude_m,
        dem_error_m=best.dem_error_m,
        correlation_columns=best.correlation_columns,
        inlier_share=best.inlier_share,
        prior_chi2=best.prior_chi2,
        evidence=best.evidence,
    )
