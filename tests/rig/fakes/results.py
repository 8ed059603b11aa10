"""Fabricated search results: places as a test needs them."""

import numpy as np

from localizer.dem.geodesy import rowcol_to_lonlat, rowcol_to_metric
from localizer.fix import Candidate, Fix, Nuisance, Position, Stage1Counts
from localizer.search.details import FrameDetail, LocateDetails, LocateResult, SolvedErrors


def a_result(dem, spots, status=None, covariance_m2=((25.0, 8.0), (8.0, 9.0))):
    """A result with a place at each (row, col, probability) of ``spots``."""
    candidates = []
    for row, col, probability in spots:
        easting_m, northing_m = (float(v) for v in rowcol_to_metric(dem, row, col))
        candidates.append(
            Candidate(easting_m=easting_m, northing_m=northing_m, probability=probability, rms_px=0.8)
        )
    position = None
    if spots:
        row, col, _ = spots[0]
        lon_deg, lat_deg = (float(v) for v in rowcol_to_lonlat(dem, row, col))
        position = Position(
            easting_m=candidates[0].easting_m,
            northing_m=candidates[0].northing_m,
            crs=dem.metric_crs.to_string(),
            lat_deg=lat_deg,
            lon_deg=lon_deg,
            ground_m=float(np.nan_to_num(dem.ground_m(row, col))),
            row=row,
            col=col,
        )
    u_px = np.arange(16.0)
    predicted = u_px if spots else np.zeros(0)
    frames = tuple(
        FrameDetail(
            label, u_px, np.full(16, 5.5), u_px < 12, predicted, predicted * 0 + 5.0, (0.05, -0.002, 0.1)
        )
        for label in ("N", "E")
    )
    fix = Fix(
        bundle="20261123T043151Z-3f9a",
        status=status or {0: "none", 1: "fix"}.get(len(spots), "ambiguous"),
        position=position,
        covariance_m2=covariance_m2 if spots else None,
        probability=spots[0][2] if spots else 0.0,
        candidates=tuple(candidates),
        stage1=Stage1Counts(cells=4764, after_altitude=20, after={"E": 5, "N": 2}, points_explored=34567),
        residual={"N": 0.7, "E": 0.9} if spots else {},
        nuisance=Nuisance(azimuth_bias_deg=2.4, tilt_bias_deg=-0.01, altitude_bias_m=2.1) if spots else None,
        timing_s={"horizon": 0.05, "stage1": 0.02},
    )
    errors = SolvedErrors(1434.0, 4.5, 12.5, 0.93, 8.0, 200.0) if spots else None
    survivors = {name: np.argwhere(np.ones((n, 2))) for name, n in (("altitude", 20), ("E", 5), ("N", 2))}
    return LocateResult(
        fix,
        LocateDetails(
            frames,
            survivors,
            np.array([[row, col] for row, col, _ in spots]).reshape(-1, 2),
            np.array([covariance_m2 for _ in spots]).reshape(-1, 2, 2),
            errors,
        ),
    )
