"""The prior circle as cells, uncertain vertical references, and the reasons' words."""

import dataclasses
import warnings
from types import SimpleNamespace

import numpy as np
import pytest
from affine import Affine
from pyproj import CRS, Geod

from localizer.dem.datum import UNKNOWN_DATUM_M
from localizer.dem.geodesy import rowcol_to_lonlat
from localizer.dem.horizon import Terrain, prepare_terrain
from localizer.dem.lattice import dem_from_array
from localizer.fix import Fix, Nuisance, Reason, Stage1Counts
from localizer.observation import FrameObservation, Observation, PriorCircle
from localizer.search import reasons
from localizer.search.altitude_reference import (
    altitude_note,
    diagnose_altimeter,
    reason_note,
    with_datum_uncertainty,
)
from localizer.search.prior_circle import cells_within_prior

GEOD = Geod(ellps="WGS84")


def terrain_of(crs: str, cell: float, west: float, north: float, side: int = 121) -> Terrain:
    transform = Affine.translation(west, north) @ Affine.scale(cell, -cell)
    return prepare_terrain(
        dem_from_array(np.zeros((side, side), np.float32), transform, CRS.from_user_input(crs))
    )


def seeing(prior: PriorCircle | None = None, **changes: object) -> Observation:
    return dataclasses.replace(Observation((), 2.0, 500.0, 5.0, 1.0, 0.02, prior), **changes)


def by_geodesics(terrain: Terrain, prior: PriorCircle) -> np.ndarray:
    """Distance (rows, cols) of each cell's centre from the prior's, by pyproj."""
    row, col = np.mgrid[: terrain.dem.rows, : terrain.dem.cols]
    lon_deg, lat_deg = rowcol_to_lonlat(terrain.dem, row.ravel().astype(float), col.ravel().astype(float))
    _, _, away_m = GEOD.inv(
        np.full(row.size, prior.lon_deg),
        np.full(row.size, prior.lat_deg),
        np.asarray(lon_deg),
        np.asarray(lat_deg),
    )
    return np.asarray(away_m).reshape(row.shape)


@pytest.mark.parametrize(
    ("terrain", "off_cells"),
    [
        (
            terrain_of("EPSG:32632", 300.0, 800_000.0, 5_200_000.0),
            (60.3, 60.7),
        ),  # far from the zone's middle: turned
        (terrain_of("EPSG:4326", 1.0 / 360.0, 9.0, 66.0), (60.3, 60.7)),  # cells twice as high as wide
        (terrain_of("EPSG:4326", 1.0 / 360.0, 9.0, 66.0), (2.2, 118.8)),  # beside the corner
    ],
)
def test_the_cells_are_those_within_the_radius(terrain, off_cells):
    lon_deg, lat_deg = rowcol_to_lonlat(terrain.dem, *off_cells)
    prior = PriorCircle(float(lat_deg), float(lon_deg), 5000.0)
    inside = cells_within_prior(terrain, seeing(prior))
    away_m = by_geodesics(terrain, prior)
    assert inside[away_m < 4995.0].all()
    assert not inside[away_m > 5005.0].any()
    assert inside.any()


def test_in_a_circle_of_60_km_meridians_converge():
    """At 66 deg north a parallel bends away from the geodesic by 600 m in 60 km."""
    terrain = terrain_of("EPSG:4326", 1.0 / 60.0, 9.0, 67.0)
    lon_deg, lat_deg = rowcol_to_lonlat(terrain.dem, 60.3, 60.7)
    prior = PriorCircle(float(lat_deg), float(lon_deg), 40_000.0)
    inside, away_m = cells_within_prior(terrain, seeing(prior)), by_geodesics(terrain, prior)
    assert inside[away_m < 39_950.0].all()
    assert not inside[away_m > 40_050.0].any()
    assert 0.05 < inside.mean() < 0.95


@pytest.mark.parametrize(("width", "height"), [(30.0, 120.0), (120.0, 30.0)])
def test_cells_may_be_longer_than_wide(width, height):
    transform = Affine.translation(500_000.0, 5_200_000.0) @ Affine.scale(width, -height)
    terrain = prepare_terrain(
        dem_from_array(np.zeros((81, 81), np.float32), transform, CRS.from_user_input("EPSG:32632"))
    )
    lon_deg, lat_deg = rowcol_to_lonlat(terrain.dem, 40.3, 39.7)
    prior = PriorCircle(float(lat_deg), float(lon_deg), 1000.0)
    inside, away_m = cells_within_prior(terrain, seeing(prior)), by_geodesics(terrain, prior)
    assert inside[away_m < 999.5].all()
    assert not inside[away_m > 1000.5].any()


def test_a_small_circle_holds_the_cells_that_lie_in_it():
    terrain = terrain_of("EPSG:32632", 30.0, 500_000.0, 5_200_000.0)
    lon_deg, lat_deg = rowcol_to_lonlat(terrain.dem, 60.0, 40.0)
    for radius_m, count in ((29.5, 1), (31.0, 5), (42.0, 5), (43.0, 9)):  # 30 m; 42.4 m
        inside = cells_within_prior(terrain, seeing(PriorCircle(float(lat_deg), float(lon_deg), radius_m)))
        assert np.count_nonzero(inside) == count
        assert inside[60, 40]


def test_an_unknown_datum_widens_the_circle_by_its_uncertainty():
    """A datum that is not named may be off by some hundred metres."""
    known = terrain_of("EPSG:32632", 30.0, 500_000.0, 5_200_000.0)
    shift = dataclasses.replace(known.dem.shift, known=False)
    unknown = dataclasses.replace(known, dem=dataclasses.replace(known.dem, shift=shift))
    lon_deg, lat_deg = rowcol_to_lonlat(known.dem, 60.0, 60.0)
    prior = PriorCircle(float(lat_deg), float(lon_deg), 100.0)
    assert UNKNOWN_DATUM_M > 50.0
    away_m = by_geodesics(known, prior)
    inside = cells_within_prior(unknown, seeing(prior))
    assert inside[away_m < 100.0 + UNKNOWN_DATUM_M - 1.0].all()
    assert not inside[away_m > 100.0 + UNKNOWN_DATUM_M + 1.0].any()


def test_a_circle_beside_the_dem_holds_no_cell_and_none_is_no_limit():
    terrain = terrain_of("EPSG:32632", 30.0, 500_000.0, 5_200_000.0)
    assert cells_within_prior(terrain, seeing()) is None
    assert not cells_within_prior(terrain, seeing(PriorCircle(40.0, 9.0, 5000.0))).any()
    for lat_deg, lon_deg in ((-40.0, -171.0), (0.0, 99.0), (90.0, 0.0), (0.0, -81.0)):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            assert not cells_within_prior(terrain, seeing(PriorCircle(lat_deg, lon_deg, 5000.0))).any()


# ---- altitude


def heights(sigma_m: float, name: str = "EGM96") -> SimpleNamespace:
    return SimpleNamespace(heights=SimpleNamespace(altitude_sigma_m=sigma_m, name=name))


def test_the_sigma_of_the_vertical_datum_is_added_in_quadrature():
    assert with_datum_uncertainty(seeing(altitude_sigma_m=3.0), heights(4.0)).altitude_sigma_m == 5.0  # type: ignore[arg-type]
    same = seeing()
    assert with_datum_uncertainty(same, heights(0.0)) is same  # type: ignore[arg-type]
    none = seeing(altitude_m=None, altitude_sigma_m=np.inf)
    assert with_datum_uncertainty(none, heights(4.0)) is none  # type: ignore[arg-type]


def fix_of(
    status: str = "none", reason: Reason | None = None, bias_m: float | None = None, **changes: object
) -> Fix:
    fields = {
        "bundle": "b",
        "status": status,
        "position": None,
        "covariance_m2": None,
        "probability": 0.0,
        "reason": reason,
        "candidates": (),
        "stage1": Stage1Counts(cells=1, after_altitude=0, after={}, points_explored=0),
        "residual": {},
        "nuisance": None
        if bias_m is None
        else Nuisance(azimuth_bias_deg=0.0, tilt_bias_deg=0.0, altitude_bias_m=bias_m),
        "timing_s": {"stage1": 20.0, "stage2": 9.0},
    }
    return Fix(**{**fields, **changes})


def a_frame(points: int) -> FrameObservation:
    return FrameObservation("N", None, 0, 1, 0, 1, 0, 1, np.zeros(points), np.zeros(points), np.ones(points))  # type: ignore[arg-type]


WITH_SKYLINE = {"frames": (a_frame(2),)}


@pytest.fixture
def diagnosed():
    """What ``diagnose_altimeter`` makes of a fix, if the search without the altitude finds ``found``; and what was searched."""

    def of(fix: Fix, observation: Observation, found: SimpleNamespace | None = None, **options: float):
        searched = []
        terrain = terrain_of("EPSG:32632", 30.0, 500_000.0, 5_200_000.0)

        def search(seen: Observation):
            searched.append((seen.altitude_m, seen.altitude_sigma_m))
            return found

        return diagnose_altimeter(terrain, observation, fix, search, **options), searched  # type: ignore[arg-type]

    return of


def located(status: str, altitude_m: float = 465.0) -> SimpleNamespace:
    best = None if status == "none" else SimpleNamespace(row=60.0, col=60.0, altitude_m=altitude_m)
    return SimpleNamespace(best=best, decision=SimpleNamespace(status=status))


def test_without_the_altimeter_the_terrain_fits_somewhere_and_the_reason_says_where(diagnosed):
    found, searched = diagnosed(fix_of(), seeing(**WITH_SKYLINE), located("fix"))
    assert searched == [(None, np.inf)]
    assert (found.status, found.reason.code) == ("none", "no_ground_at_altitude")
    # cell 60: easting 500000 + 60.5 * 30, of UTM zone 32
    assert found.reason.text.startswith("without the altimeter the terrain fits at 46.93")
    assert ", 9.02" in found.reason.text
    assert "with the altitude off by +35 m (7.0 sigma)" in found.reason.text  # 500 - 465, of 5 m
    several, _ = diagnosed(fix_of(), seeing(**WITH_SKYLINE), located("ambiguous", 540.0))
    assert "fits, among others, at" in several.reason.text
    assert "off by -40 m (8.0 sigma)" in several.reason.text


def test_if_it_fits_nowhere_either_the_reason_stays_or_says_so(diagnosed):
    contradicted = Reason(code="contradicted", text="x")
    assert (
        diagnosed(fix_of(reason=contradicted), seeing(**WITH_SKYLINE), located("none"))[0].reason
        == contradicted
    )
    assert diagnosed(fix_of(), seeing(**WITH_SKYLINE), located("none"))[0].reason.code == "outside"
    unbelieved = located("fix")
    unbelieved.decision.status = "none"
    assert diagnosed(fix_of(), seeing(**WITH_SKYLINE), unbelieved)[0].reason.code == "outside"


@pytest.mark.parametrize(
    ("fix", "changes", "options", "is_searched"),
    [
        (fix_of(), WITH_SKYLINE, {"within_s": 29.1}, True),  # took 29 s
        (fix_of(), WITH_SKYLINE, {"within_s": 28.9}, False),
        (fix_of("ambiguous"), WITH_SKYLINE, {}, False),
        (fix_of(), {**WITH_SKYLINE, "altitude_m": None}, {}, False),
        (fix_of(), {"frames": (a_frame(1),)}, {}, False),
        (fix_of(), {"frames": (a_frame(1), a_frame(2))}, {}, True),
    ],
)
def test_the_search_is_repeated_where_that_can_tell_something(diagnosed, fix, changes, options, is_searched):
    found, searched = diagnosed(fix, seeing(**changes), located("fix"), **options)
    assert bool(searched) == is_searched
    assert (found is fix) != is_searched


def test_a_note_gives_the_reason_of_none_and_of_an_unknown_datum():
    outside, datum = (
        Reason(code="outside", text="no place"),
        Reason(code="unknown_datum", text="which datum?"),
    )
    assert reason_note(fix_of(reason=outside)) == "no place"
    assert reason_note(fix_of("ambiguous", reason=datum)) == "which datum?"
    assert reason_note(fix_of("ambiguous", reason=Reason(code="several_places", text="x"))) is None
    assert reason_note(fix_of()) is None


def bundle(sigma_m: float | None = 5.0) -> SimpleNamespace:
    return SimpleNamespace(altitude=None if sigma_m is None else SimpleNamespace(sigma_m=sigma_m))


@pytest.mark.parametrize(
    ("bias_m", "sigma_m", "datum_sigma_m", "noted"),
    [
        (19.9, 5.0, 0.0, False),  # four sigma
        (20.1, 5.0, 0.0, True),
        (-20.1, 5.0, 0.0, True),
        (19.9, 3.0, 4.0, False),
        (20.1, 3.0, 4.0, True),
        (0.039, 0.0, 0.0, False),  # a centimetre at least
        (0.041, 0.0, 0.0, True),
    ],
)
def test_an_altitude_beyond_four_sigma_is_noted(bias_m, sigma_m, datum_sigma_m, noted):
    note = altitude_note(fix_of("ambiguous", bias_m=bias_m), bundle(sigma_m), heights(datum_sigma_m))  # type: ignore[arg-type]
    assert (note is not None) == noted


def test_the_note_says_by_how_much_and_what_would_mend_it():
    note = altitude_note(fix_of("ambiguous", bias_m=35.0), bundle(), heights(0.0))  # type: ignore[arg-type]
    assert "reads +35 m off the place found, 7.0 of its sigmas" in note
    assert "(EGM96)" in note
    assert note.endswith("say --geoid-offset -35")
    low = altitude_note(fix_of("ambiguous", bias_m=-35.0), bundle(), heights(0.0))  # type: ignore[arg-type]
    assert "reads -35 m off the place found, 7.0 of its sigmas" in low
    assert low.endswith("say --geoid-offset 35")
    nameless = altitude_note(fix_of("ambiguous", bias_m=35.0), bundle(), heights(0.0, ""))  # type: ignore[arg-type]
    assert "(of no stated vertical datum)" in nameless


def test_without_an_altimeter_or_a_place_nothing_is_noted():
    assert altitude_note(fix_of("ambiguous", bias_m=99.0), bundle(None), heights(0.0)) is None  # type: ignore[arg-type]
    assert altitude_note(fix_of("none", bias_m=99.0), bundle(), heights(0.0)) is None  # type: ignore[arg-type]
    assert altitude_note(fix_of("ambiguous"), bundle(), heights(0.0)) is None  # type: ignore[arg-type]


# ---- reasons


@pytest.mark.parametrize(
    ("reason", "code", "words"),
    [
        (reasons.no_skyline(), "too_little_skyline", "No frame shows a skyline"),
        (reasons.no_ground_at_altitude(1234.4), "no_ground_at_altitude", "altitude of 1234 m"),
        (reasons.no_match(39.9), "too_little_skyline", "Only 40 deg of skyline"),
        (reasons.no_match(40.0), "outside", "fits no place in this DEM"),
        (reasons.beyond_dem(), "outside", "beyond the end of the DEM"),
        (reasons.large_dem_error(12.4), "dem_error", "off by 12 m or more"),
        (reasons.several_places(2), "several_places", "2 places fit"),
        (reasons.several_places(1), "several_places", "others that were not compared"),
        (reasons.weak_evidence(17.26, 25.0), "too_little_skyline", "evidence of 17.3 where 25"),
        (reasons.large_uncertainty(151.4), "too_little_skyline", "known to 151 m"),
        (reasons.excluded_by_track(), "contradicted", "none of the places that the drive allows"),
    ],
)
def test_a_reason_says_what_is_wrong(reason, code, words):
    assert reason.code == code
    assert words in reason.text
