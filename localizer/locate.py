"""The localizer's main job: from what was seen to where it was seen from."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from localizer.bundle import Bundle, frame_image
from localizer.camera import camera_to_world, project
from localizer.contradiction import Settled, settle_frames
from localizer.dem import Dem
from localizer.details import FrameDetail, LocateDetails, LocateResult, SolvedErrors
from localizer.fix import Candidate, Fix, Nuisance, Position, Stage1Counts
from localizer.geodesy import enu_to_metric_jacobian, lonlat_to_rowcol, rowcol_to_lonlat, rowcol_to_metric
from localizer.horizon.from_image import CONFIDENT, ColumnState, Skyline, find_skyline
from localizer.horizon.from_terrain import Terrain, horizon, horizon_around, prepare_terrain
from localizer.observation import FrameObservation, Observation, PriorCircle
from localizer.search.contours import BINS, FrameContour, MeasuredSkyline, frame_contour, measured_skyline
from localizer.search.decide import Decision, decide, explains
from localizer.search.error_model import ErrorModel
from localizer.search.refine import (
    FIRST_LENGTH_CELLS,
    LIKELY_FROM,
    Noise,
    Problem,
    Refined,
    places_around,
    refine,
    usual_noise,
)
from localizer.search.stage1 import Band, Stage1, bands, half_cell_relief, heading_offsets_deg, search_stage1
from localizer.search.stage2 import Scored, apart, search_stage2

Floats = NDArray[np.float64]

LARGEST_DEM_ERROR = 4.0
"""A DEM's error is at most so many times what is usual for one of its kind."""
COLUMNS_EVERY_DEG = ((6.0, 600), (2.0, 150))
"""Stage 2's rounds: the columns' spacing, and how many cells go on to the next."""
MOST_CELLS = 30000
"""Where stage 1 leaves more, stage 2 first looks at every second cell, or third, and so on, and ..."""
PROMISING_CELLS = 1500
"""... then at all around the best of those."""
HEADING_STEP_DEG = 2.0
"""Stage 2's hypotheses for the heading lie no further apart."""
STARTS = 12
START_RADIUS_CELLS = 1.5
COARSE_COLUMNS = 120
"""Columns of all frames together in the first refinement of each start, and ..."""
CONTEST_COLUMNS = 480
"""... in the comparison of the contenders."""
CONTENDERS = 5
CONTEST_MARGIN = 0.5
"""A start whose columns are less likely than the best one's by this much each (in logarithms) is no contender."""
LOOK_ABOUT_CELLS = (2.4, 0.4)
"""How far around a fit other places are tried for a better one, and how far apart these are."""
LOOK_ABOUT_STARTS = 3
FINALISTS = 2
BLUNTING_PER_M = 10.0
"""By how much the log-likelihood of peaks close to each other is divided for each metre of the DEM's error: the error model is
only about right, and what a horizon does where one ridge hides another depends on details that it does not have."""
LOOK_ABOUT_ERRORS = (0.2, 1.5)
"""What is taken for a DEM's error in that, in terms of what is usual."""
SAME_PLACE_CELLS = 2.0
SMALLEST_SIGMA_M = 0.01
"""Of an altimeter; less is a promise that nobody keeps and that the equations cannot be solved with."""
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


@dataclass(frozen=True)
class Located:
    """The answer to an observation. ``best`` is None where no place fits."""

    decision: Decision
    best: Refined | None
    stage1: Stage1
    timing_s: dict[str, float]


def locate_bundle(bundle: Bundle, dem: Dem) -> LocateResult:
    """Find the skyline in each frame of a bundle and the place in the DEM that has it."""
    watch = _Watch()
    with watch.part("prepare"):
        terrain = prepare_terrain(dem)
        load_kernels(terrain)
    with watch.part("horizon"):
        skylines = [find_skyline(frame_image(bundle, frame)) for frame in bundle.frames]
    observation = observe(bundle, skylines)
    located = locate(terrain, observation)
    timing = {**watch.seconds, **located.timing_s}
    with watch.part("frames"):
        settled = settle_frames(
            terrain, observation, located, lambda fewer: locate(terrain, fewer, everywhere=False)
        )
    timing["frames"] = watch.seconds["frames"]
    fix = fix_of(terrain, observation, settled.located, bundle.id, timing)
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
    find_skyline(np.zeros((64, 64, 3), np.uint8))


def observe(bundle: Bundle, skylines: list[Skyline]) -> Observation:
    """What the search is given: the confident columns of each frame and the bundle's readings."""
    frames = []
    for frame, skyline in zip(bundle.frames, skylines, strict=True):
        used = _usable(skyline)
        frames.append(
            FrameObservation(
                label=frame.label,
                camera=bundle.camera,
                azimuth_deg=frame.azimuth_deg,
                azimuth_sigma_deg=frame.azimuth_sigma_deg,
                tilt_deg=frame.tilt_deg,
                tilt_sigma_deg=frame.tilt_sigma_deg,
                roll_deg=frame.roll_deg,
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

    Not ``everywhere``: only the cells that stage 1 leaves, which is quick.
    """
    watch = _Watch()
    seen = tuple(frame_contour(frame) for frame in observation.frames if len(frame.u_px) > 1)
    if not seen:
        nothing = Stage1(int(np.isfinite(terrain.dem.z_m).sum()), {"altitude": np.zeros((0, 2), np.int64)}, 0)
        return Located(Decision("none", [], np.zeros(0)), None, nothing, watch.seconds)
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
    decision, best = _among(terrain, observation, seen, skyline, stage1.last, offsets, watch)
    if everywhere and decision.status == "none" and len(stage1.last) < len(stage1.survivors["altitude"]):
        # A central column may show a cloud or a tree: let whole curves speak about every cell at the right altitude.
        decision, best = _among(
            terrain, observation, seen, skyline, stage1.survivors["altitude"], offsets, watch
        )
    return Located(decision, best, stage1, watch.seconds)


def _among(
    terrain: Terrain,
    observation: Observation,
    contours: tuple[FrameContour, ...],
    skyline: MeasuredSkyline,
    cells: NDArray[np.int64],
    offsets: Floats,
    watch: _Watch,
) -> tuple[Decision, Refined | None]:
    """Stage 2, refinement and decision among the given cells."""
    if len(cells) == 0:
        return Decision("none", [], np.zeros(0)), None
    with watch.part("stage2"):
        scored = _stage2(terrain, observation, skyline, cells, offsets)
    with watch.part("refine"):
        return _settle(terrain, observation, contours, scored)


def _stage2(
    terrain: Terrain,
    observation: Observation,
    skyline: MeasuredSkyline,
    cells: NDArray[np.int64],
    offsets: Floats,
) -> Scored:
    """Few columns for all cells, many for the best of them."""
    relief = half_cell_relief(terrain.height_m)
    if len(offsets) > 1 and offsets[1] - offsets[0] > HEADING_STEP_DEG:
        offsets = np.arange(offsets[0], offsets[-1], HEADING_STEP_DEG)

    def best(cells: NDArray[np.int64], every_deg: float, keep: int, spread: float = 1.0) -> Scored:
        at = cells[:, 0], cells[:, 1]
        eye = terrain.height_m[at].astype(float) + observation.mast_height_m
        slack = spread * relief[at].astype(float)
        if observation.altitude_m is not None:
            eye = np.clip(observation.altitude_m, eye - slack, eye + slack)
        scored = search_stage2(
            terrain,
            skyline,
            cells,
            eye,
            slack,
            offsets,
            observation.azimuth_bias_sigma_deg,
            terrain.usual_error_m,
            every_deg,
        )
        return Scored(scored.cells[:keep], scored.disparity[:keep], scored.azimuth_bias_deg[:keep])

    if len(cells) > MOST_CELLS:
        stride = int(np.ceil(np.sqrt(len(cells) / MOST_CELLS)))
        sparse = cells[(cells % stride == stride // 2).all(axis=1)]
        promising = best(sparse, COLUMNS_EVERY_DEG[0][0], PROMISING_CELLS, spread=float(stride)).cells
        cells = _around(cells, promising, terrain.height_m.shape, stride)
    for every_deg, keep in COLUMNS_EVERY_DEG:
        scored = best(cells, every_deg, keep)
        cells = scored.cells
    return scored


def _around(
    cells: NDArray[np.int64], centres: NDArray[np.int64], shape: tuple[int, ...], stride: int
) -> NDArray[np.int64]:
    """Those of ``cells`` (n, 2) that lie in the squares of ``stride`` cells a side around the centres (m, 2)."""
    near = np.zeros((shape[0] // stride + 1, shape[1] // stride + 1), bool)
    near[centres[:, 0] // stride, centres[:, 1] // stride] = True
    return cells[near[cells[:, 0] // stride, cells[:, 1] // stride]]


def _settle(
    terrain: Terrain, observation: Observation, contours: tuple[FrameContour, ...], scored: Scored
) -> tuple[Decision, Refined | None]:
    """Refine the best cells, coarsely all, then the contenders under one error model, then the winner with all columns."""
    largest = LARGEST_DEM_ERROR * terrain.usual_error_m
    columns = sum(len(c.rays) for c in contours)
    coarse = Problem(terrain, observation, contours, stride=max(1, columns // COARSE_COLUMNS))
    refined = []
    for i in apart(scored, STARTS, START_RADIUS_CELLS):
        row, col = scored.cells[i].astype(float)
        refined.append(
            refine(
                coarse,
                row,
                col,
                _first_altitude(terrain, observation, row, col),
                float(scored.azimuth_bias_deg[i]),
                iterations=4,
                noise=usual_noise(terrain, 2.0 * terrain.usual_error_m),
                largest_dem_error_m=largest,
                settle=True,
            )
        )
    refined.sort(key=lambda r: r.misfit_per_column)
    promising = _distinct(refined, SAME_PLACE_CELLS)[:CONTENDERS]
    refined = [_again(coarse, start, largest, settle=True, iterations=8) for start in promising]
    refined.sort(key=lambda r: r.misfit_per_column)
    contenders = [
        c
        for c in _distinct(refined, SAME_PLACE_CELLS)
        if c.misfit_per_column < refined[0].misfit_per_column + CONTEST_MARGIN
    ]
    full = Problem(terrain, observation, contours)
    stride = max(1, columns // CONTEST_COLUMNS)
    middle = Problem(terrain, observation, contours, stride)
    best = _best_nearby(full, middle, coarse, _again(full, contenders[0], largest, settle=True), largest)
    held = Noise(best.dem_error_m, max(1.0, best.correlation_columns / stride), best.error_model)
    compared = [_again(middle, best, largest, held=held)] + [
        _nearby(middle, coarse, _again(middle, c, largest, held=held), held, largest) for c in contenders[1:]
    ]
    compared = _distinct(sorted(compared, key=lambda r: r.cost), SAME_PLACE_CELLS)
    priors = 2 + 2 + 3 * len(contours)
    decision = decide(compared, best.evidence, terrain.cell_m)
    winner = decision.candidates[0]
    if np.hypot(winner.row - best.row, winner.col - best.col) > SAME_PLACE_CELLS:
        best = _best_nearby(full, middle, coarse, _again(full, winner, largest, settle=True), largest)
    if not explains(best, largest, priors):
        return Decision("none", [], np.zeros(0)), None
    return decision, best


def _best_nearby(full: Problem, middle: Problem, coarse: Problem, found: Refined, largest: float) -> Refined:
    """The best place around a fit, with all columns, its noise estimated there.

    A fit beside the best place may have taken its misfit for the DEM's error, and a larger error leaves it no reason to move.
    So the search about it takes several sizes for granted, each of the places found has its own noise estimated, and the
    likeliest under its own counts.
    """
    usual = full.terrain.usual_error_m
    length_m = FIRST_LENGTH_CELLS * full.terrain.cell_m
    ratio = len(middle.sigma_rad) / len(full.sigma_rad)
    correlation = max(1.0, found.correlation_columns * ratio)
    noises = [Noise(found.dem_error_m, correlation, found.error_model)] + [
        Noise(share * usual, correlation, ErrorModel(0.1 * share * usual, share * usual, length_m))
        for share in LOOK_ABOUT_ERRORS
    ]
    around = places_around(coarse, found, noises, *LOOK_ABOUT_CELLS, LOOK_ABOUT_STARTS)
    fits = [
        refine(
            middle,
            row,
            col,
            altitude_m,
            found.azimuth_bias_deg,
            iterations=8,
            noise=noise,
            largest_dem_error_m=largest,
            settle=True,
            likely_from=0,
        )
        for row, col, altitude_m, noise in around
    ]
    starts = _distinct(sorted(fits, key=lambda r: r.fit_cost), LOOK_ABOUT_CELLS[1])[:FINALISTS]
    finals = [found, *(_again(full, start, largest, settle=True, likely_from=0) for start in starts)]
    return _doubted(min(finals, key=lambda r: r.fit_cost), fits, full.terrain)


def _doubted(best: Refined, others: list[Refined], terrain: Terrain) -> Refined:
    """The best fit, its covariance widened by the other peaks close by that may be the right one."""
    if not others:
        return best
    cost = np.array([best.fit_cost, *(r.fit_cost for r in others)])
    cost[0] = cost[1:].min()  # of all columns, the others of some
    share = np.exp((cost.min() - cost) / (1.0 + BLUNTING_PER_M * best.error_model.smooth_m))
    share /= share.sum()
    off_m = np.array(
        [
            [
                (r.col - best.col) * terrain.dem.spacing_ew_m,
                (best.row - r.row) * terrain.dem.spacing_ns_m,
            ]
            for r in (best, *others)
        ]
    )
    return replace(best, covariance_enu_m2=best.covariance_enu_m2 + (share[:, None] * off_m).T @ off_m)


def _nearby(middle: Problem, coarse: Problem, found: Refined, noise: Noise, largest: float) -> Refined:
    """The best fit with held noise that starts from one of the likeliest places around another."""
    around = [
        refine(
            middle,
            row,
            col,
            altitude_m,
            found.azimuth_bias_deg,
            iterations=8,
            noise=noise,
            largest_dem_error_m=largest,
            settle=False,
        )
        for row, col, altitude_m, _ in places_around(
            coarse, found, [noise], *LOOK_ABOUT_CELLS, LOOK_ABOUT_STARTS
        )
    ]
    return min(around or [found], key=lambda r: r.fit_cost)


def _again(
    problem: Problem,
    start: Refined,
    largest: float,
    *,
    settle: bool = False,
    held: Noise | None = None,
    iterations: int = 24,
    likely_from: int = LIKELY_FROM,
) -> Refined:
    """Refine once more from where a coarser refinement ended; ``held``: the noise not to estimate anew."""
    return refine(
        problem,
        start.row,
        start.col,
        start.altitude_m,
        start.azimuth_bias_deg,
        iterations=iterations,
        noise=held or Noise(start.dem_error_m, start.correlation_columns, start.error_model),
        largest_dem_error_m=largest,
        settle=settle,
        likely_from=likely_from,
    )


def _distinct(candidates: list[Refined], radius_cells: float) -> list[Refined]:
    """The first of each group of candidates that lie within ``radius_cells`` of each other."""
    kept: list[Refined] = []
    for c in candidates:
        if all(np.hypot(c.row - k.row, c.col - k.col) > radius_cells for k in kept):
            kept.append(c)
    return kept


def _first_altitude(terrain: Terrain, observation: Observation, row: float, col: float) -> float:
    ground = float(terrain.dem.ground_m(row, col)) + observation.mast_height_m
    if observation.altitude_m is None:
        return ground
    weight = 1.0 / np.array([terrain.usual_error_m, observation.altitude_sigma_m]) ** 2
    return float(weight @ [ground, observation.altitude_m] / weight.sum())


def _within_prior(terrain: Terrain, observation: Observation) -> NDArray[np.bool_] | None:
    """Cells (rows, cols) inside the prior's circle; None without a prior."""
    prior = observation.prior
    if prior is None:
        return None
    dem = terrain.dem
    row, col = lonlat_to_rowcol(dem, prior.lon_deg, prior.lat_deg)
    south = (np.arange(dem.rows) - float(row))[:, None] * dem.spacing_ns_m
    east = (np.arange(dem.cols) - float(col))[None, :] * dem.spacing_ew_m
    return np.asarray(np.hypot(south, east) <= prior.radius_m)


def fix_of(
    terrain: Terrain, observation: Observation, located: Located, bundle_id: str, timing_s: dict[str, float]
) -> Fix:
    """The answer in the contract's terms."""
    dem = terrain.dem
    decision, best, stage1 = located.decision, located.best, located.stage1
    after = {label: len(cells) for label, cells in stage1.survivors.items()}
    counts = Stage1Counts(
        cells=stage1.cells,
        after_altitude=after.pop("altitude"),
        after=after,
        points_explored=stage1.points_explored,
    )
    candidates = []
    for refined, probability in zip(decision.candidates, decision.probabilities, strict=True):
        easting, northing = rowcol_to_metric(dem, refined.row, refined.col)
        rms = float(np.sqrt(np.mean(np.square(list(refined.residual_px.values())))))
        candidates.append(
            Candidate(
                easting_m=float(easting),
                northing_m=float(northing),
                probability=float(probability),
                rms_px=rms,
            )
        )
    position = covariance = nuisance = None
    if best is not None:
        easting, northing = rowcol_to_metric(dem, best.row, best.col)
        lon, lat = rowcol_to_lonlat(dem, best.row, best.col)
        ground = float(dem.ground_m(best.row, best.col))
        position = Position(
            easting_m=float(easting),
            northing_m=float(northing),
            crs=dem.metric_crs.to_string(),
            lat_deg=float(lat),
            lon_deg=float(lon),
            ground_m=ground if np.isfinite(ground) else best.altitude_m - observation.mast_height_m,
            row=best.row,
            col=best.col,
        )
        c = _metric_covariance(terrain, best)
        covariance = ((float(c[0, 0]), float(c[0, 1])), (float(c[1, 0]), float(c[1, 1])))
        nuisance = Nuisance(
            azimuth_bias_deg=best.azimuth_bias_deg,
            tilt_bias_deg=best.tilt_bias_deg,
            altitude_bias_m=0.0
            if observation.altitude_m is None
            else observation.altitude_m - best.altitude_m,
        )
    return Fix(
        bundle=bundle_id,
        status=decision.status,
        position=position,
        covariance_m2=covariance,
        probability=float(decision.probabilities[0]) if len(decision.probabilities) else 0.0,
        candidates=tuple(candidates),
        stage1=counts,
        residual=best.residual_px if best else {},
        nuisance=nuisance,
        timing_s=timing_s,
    )


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
    for frame, skyline in zip(observation.frames, skylines, strict=True):
        found = np.isfinite(skyline.row_px)
        u = v = np.zeros(0)
        left_out = frame.label == settled.left_out
        solved = best is not None and len(frame.u_px) > 1 and not left_out
        own = next(errors) if solved else np.zeros(3)
        if best is not None:
            attitude = (
                frame.azimuth_deg - best.azimuth_bias_deg - own[0],
                frame.tilt_deg - best.tilt_bias_deg - own[1],
                frame.roll_deg - own[2],
            )
            half_view = np.degrees(np.arctan(bundle.camera.width_px / bundle.camera.fx_px)) + 5.0
            azimuth = attitude[0] + np.arange(-half_view, half_view, 0.05)
            elevation, _ = horizon(terrain, best.row, best.col, best.altitude_m, azimuth)
            u, v = project(bundle.camera, camera_to_world(*attitude), azimuth, elevation[0])
            inside = (u >= -1.0) & (u <= bundle.camera.width_px)
            u, v = u[inside], v[inside]
        frames.append(
            FrameDetail(
                label=frame.label,
                found_u_px=np.nonzero(found)[0].astype(float),
                found_v_px=skyline.row_px[found],
                used=_usable(skyline)[found],
                predicted_u_px=u,
                predicted_v_px=v,
                errors_deg=(float(own[0]), float(own[1]), float(own[2])) if solved else None,
                agreement=settled.agreement.get(frame.label),
                left_out=left_out,
            )
        )
    # the best one has been refined once more, with all columns
    candidates = [best, *located.decision.candidates[1:]] if best is not None else []
    return LocateDetails(
        tuple(frames),
        located.stage1.survivors,
        np.array([[c.row, c.col] for c in candidates]).reshape(-1, 2),
        np.array([_metric_covariance(terrain, c) for c in candidates]).reshape(-1, 2, 2),
        None if best is None else _solved_errors(best),
    )


def _metric_covariance(terrain: Terrain, refined: Refined) -> Floats:
    """(2, 2) of easting and northing."""
    turn = enu_to_metric_jacobian(terrain.dem, refined.row, refined.col)
    return np.asarray(turn @ refined.covariance_enu_m2 @ turn.T)


def _solved_errors(best: Refined) -> SolvedErrors:
    return SolvedErrors(
        altitude_m=best.altitude_m,
        dem_error_m=best.dem_error_m,
        correlation_columns=best.correlation_columns,
        inlier_share=best.inlier_share,
        prior_chi2=best.prior_chi2,
        evidence=best.evidence,
    )
