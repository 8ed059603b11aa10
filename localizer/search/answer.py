"""The result of a search, and its translation into the contract's ``skyfix.fix/1``."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from localizer.dem.crs import short_name
from localizer.dem.datum import unknown_datum_note
from localizer.dem.geodesy import map_metres_at, rowcol_to_lonlat, rowcol_to_metric
from localizer.dem.horizon import Terrain
from localizer.dem.lattice import Dem
from localizer.fix import Candidate, Fix, Nuisance, Position, Reason, Stage1Counts
from localizer.observation import Observation
from localizer.search.decide import Decision
from localizer.search.fit.refine import Refined
from localizer.search.stage1 import Stage1

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Located:
    """The result for an observation. ``best``: the most probable place, None if no place is believed."""

    decision: Decision
    best: Refined | None
    stage1: Stage1
    timing_s: dict[str, float]


def fix_of(
    terrain: Terrain, observation: Observation, located: Located, bundle_id: str, timing_s: dict[str, float]
) -> Fix:
    """The result as ``skyfix.fix/1``."""
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
            crs=short_name(dem.metric_crs),
            lat_deg=float(lat),
            lon_deg=float(lon),
            ground_m=ground if np.isfinite(ground) else best.altitude_m - observation.mast_height_m,
            row=best.row,
            col=best.col,
        )
        c = metric_covariance(terrain, best)
        covariance = ((float(c[0, 0]), float(c[0, 1])), (float(c[1, 0]), float(c[1, 1])))
        nuisance = Nuisance(
            azimuth_bias_deg=best.azimuth_bias_deg,
            tilt_bias_deg=best.tilt_bias_deg,
            altitude_bias_m=0.0
            if observation.altitude_m is None
            else observation.altitude_m - best.altitude_m,
        )
    fix = Fix(
        bundle=bundle_id,
        status=decision.status,
        position=position,
        covariance_m2=covariance,
        probability=float(decision.probabilities[0]) if len(decision.probabilities) else 0.0,
        elsewhere=decision.elsewhere,
        reason=decision.reason,
        candidates=tuple(candidates),
        stage1=counts,
        residual=best.residual_px if best else {},
        nuisance=nuisance,
        timing_s=timing_s,
    )
    return without_known_datum(fix, dem)


def without_known_datum(fix: Fix, dem: Dem) -> Fix:
    """Not ``fix`` but ``ambiguous`` if the DEM's datum is unknown: the place is right in the DEM's grid, not on WGS84."""
    if dem.shift.known or fix.status != "fix":
        return fix
    reason = Reason(code="unknown_datum", text=unknown_datum_note(dem.crs, dem.shift))
    return fix.model_copy(update={"status": "ambiguous", "reason": reason})


def metric_covariance(terrain: Terrain, refined: Refined) -> Floats:
    """(2, 2) of easting and northing, metres on the ground; includes the accuracy of the datum transformation."""
    here = map_metres_at(terrain.dem, refined.row, refined.col)
    datums_m2 = terrain.dem.metric_accuracy_m**2 * np.eye(2)
    return here.ground_covariance(refined.covariance_enu_m2) + datums_m2
