"""Lines of sight over triangles, against closed forms and against brute force."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from sim.world.surface import EARTH_RADIUS_M, GEOD, Surface
from sim.world.terrain import read_terrain
from sim.world.truth import World

WriteDem = Callable[..., Path]

DROP = 0.87 / (2.0 * EARTH_RADIUS_M)
GEOGRAPHIC = {"crs": "EPSG:4326", "cell": 1.0 / 1200.0, "corner": (9.0, 61.0)}
SLANTING = {"crs": "EPSG:32632", "cell": 40.0, "corner": (690000.0, 6700000.0)}  # convergence of some 3 deg


def rolling(seed: int, size: int = 120) -> np.ndarray:
    noise = np.random.default_rng(seed).standard_normal((size, size))
    return 800.0 + 4000.0 * ndimage.gaussian_filter(noise, 5.0) + 10.0 * noise


def test_heights_are_those_of_the_triangles(write_dem: WriteDem) -> None:
    surface = Surface(read_terrain([write_dem(np.array([[0.0, 10.0], [20.0, 60.0]]))]))
    assert surface.height(0.0, 1.0) == 10.0
    assert (
        surface.height(0.5, 0.5) == 30.0
    )  # on the diagonal from north-west to south-east, not the mean of four
    assert surface.height(0.25, 0.75) == pytest.approx(0.75 * 10.0 + 0.25 * 50.0)
    assert surface.height(0.75, 0.25) == pytest.approx(0.75 * 20.0 + 0.25 * 40.0)
    assert np.isnan(surface.height(1.01, 0.5))


def test_horizon_of_a_wall(write_dem: WriteDem) -> None:
    heights = np.zeros((201, 201))
    heights[40] = 300.0
    surface = Surface(read_terrain([write_dem(heights)]))
    azimuth_deg = np.linspace(-40.0, 40.0, 81)
    elevation_deg, distance_m = surface.horizon(surface.observer(100.0, 100.0, 2.0), azimuth_deg)
    away_m = 60 * 30.0 / np.cos(np.radians(azimuth_deg))
    np.testing.assert_allclose(distance_m, away_m, rtol=1e-6)
    np.testing.assert_allclose(np.tan(np.radians(elevation_deg)), 298.0 / away_m - DROP * away_m, atol=1e-7)


def test_horizon_of_a_cone(write_dem: WriteDem) -> None:
    """tan = (h cos a - |sin a| sqrt(m^2 D^2 - h^2)) / D: the sight lines that touch the cone, on a flat Earth."""
    rows, cols = np.mgrid[:301, :301]
    top_m, slope, away_m = 500.0, 0.6, 1200.0
    heights = top_m - slope * 10.0 * np.hypot(rows - 90.0, cols - 150.0)
    surface = Surface(read_terrain([write_dem(heights, cell=10.0)]), refraction=1.0)
    eye_m = heights[210, 150] + 5.0
    azimuth_deg = np.linspace(-25.0, 25.0, 51)
    elevation_deg, _ = surface.horizon(surface.observer(210.0, 150.0, eye_m), azimuth_deg)
    azimuth, rise = np.radians(azimuth_deg), top_m - eye_m
    flank = np.sqrt((slope * away_m) ** 2 - rise**2)
    tangent = (rise * np.cos(azimuth) - np.abs(np.sin(azimuth)) * flank) / away_m
    np.testing.assert_allclose(np.tan(np.radians(elevation_deg)), tangent, atol=1e-4)
    assert elevation_deg[25] == pytest.approx(np.degrees(np.arctan(rise / away_m)), abs=1e-6)


@pytest.mark.parametrize("eye_m", [0.5, 2.0, 3.5])
def test_horizon_of_a_sphere(write_dem: WriteDem, eye_m: float) -> None:
    """Over the sea the horizon dips by 2 sqrt(h d) at sqrt(h / d), d being the drop per square metre."""
    surface = Surface(read_terrain([write_dem(np.zeros((401, 401)), cell=45.0)]))
    elevation_deg, distance_m = surface.horizon(
        surface.observer(200.0, 200.0, eye_m), np.arange(0.0, 360.0, 7.0)
    )
    np.testing.assert_allclose(np.tan(np.radians(elevation_deg)), -2.0 * np.sqrt(eye_m * DROP), rtol=1e-9)
    np.testing.assert_allclose(distance_m, np.sqrt(eye_m / DROP), rtol=1e-9)


@pytest.mark.parametrize("grid", [GEOGRAPHIC, SLANTING], ids=["geographic", "projected"])
def test_horizon_is_that_of_dense_sampling(write_dem: WriteDem, grid: dict) -> None:
    """True azimuths, geodesics, every triangle: points looked up one by one by pyproj see nothing higher or lower."""
    surface = Surface(read_terrain([write_dem(rolling(1), **grid)]))
    row, col = 61.3, 55.8
    eye_m = surface.height(row, col) + 2.0
    lon, lat = surface.terrain.lonlat_deg(row, col)
    azimuth_deg = np.arange(3.0, 360.0, 13.0)
    elevation_deg, distance_m = surface.horizon(surface.observer(row, col, eye_m), azimuth_deg)
    for azimuth, elevation, distance in zip(azimuth_deg, elevation_deg, distance_m, strict=True):
        s = np.concatenate([np.arange(0.5, 5000.0, 0.5), distance + np.linspace(-0.5, 0.5, 101)])
        s = s[s > 0.0]
        lons, lats, _ = GEOD.fwd(np.full_like(s, lon), np.full_like(s, lat), np.full_like(s, azimuth), s)
        z = np.array(
            [surface.height(*place) for place in zip(*surface.terrain.row_col(lons, lats), strict=True)]
        )
        tangent = np.nanmax((z - eye_m) / s - DROP * s)
        off_m = (np.tan(np.radians(elevation)) - tangent) * distance
        assert abs(off_m) < 0.002, "the track is straight for a few cells: a millimetre or so aside"


@given(azimuth_deg=st.floats(0.0, 360.0), row=st.floats(20.0, 780.0), col=st.floats(20.0, 780.0))
@settings(max_examples=40)
def test_a_profile_is_the_surface_and_holds_the_horizon(
    world: World, azimuth_deg: float, row: float, col: float
) -> None:
    surface = world.surface
    observer = surface.observer(row, col, surface.height(row, col) + 2.0)
    distance_m, height_m = surface.profile(observer, azimuth_deg)
    assert np.all(np.diff(distance_m) > 0.0)
    # Halfway between crossings the polyline meets the triangle: nothing between them was missed.
    middle_m, between_m = 0.5 * (distance_m[1:] + distance_m[:-1]), 0.5 * (height_m[1:] + height_m[:-1])
    rows, cols = surface.lattice(observer, np.full_like(middle_m, azimuth_deg), middle_m)
    some = slice(0, len(middle_m) - 2, max(len(middle_m) // 50, 1))
    met = [surface.height(*place) for place in zip(rows[some], cols[some], strict=True)]
    np.testing.assert_allclose(between_m[some], met, atol=0.01)
    elevation_deg, _ = surface.horizon(observer, np.array([azimuth_deg]))
    s, z = distance_m[1:], height_m[1:]
    highest = np.degrees(np.arctan(np.max((z - observer.altitude_m) / s - DROP * s)))
    assert highest <= elevation_deg[0] + 1e-9
    assert elevation_deg[0] == pytest.approx(
        highest, abs=1e-3
    )  # the Earth's curve may top between two crossings


def test_voids_are_no_terrain(write_dem: WriteDem) -> None:
    heights = np.zeros((101, 101))
    heights[20] = 300.0
    heights[30] = 500.0
    heights[29:32, 40:61] = -9999.0
    surface = Surface(read_terrain([write_dem(heights, void=-9999.0)]))
    observer = surface.observer(50.0, 50.0, 2.0)
    elevation_deg, distance_m = surface.horizon(observer, np.array([0.0]))
    assert distance_m[0] == pytest.approx(900.0, rel=1e-6)  # the near wall is missing there, the far one seen
    assert np.tan(np.radians(elevation_deg[0])) == pytest.approx(298.0 / 900.0 - DROP * 900.0, abs=1e-7)
    distance_m, height_m = surface.profile(observer, 0.0)
    gap = np.flatnonzero(np.isnan(height_m))
    assert len(gap) == 1
    np.testing.assert_allclose(distance_m[gap[0] + np.array([-1, 1])], [18 * 30.0, 22 * 30.0], rtol=1e-6)


def test_where_all_is_void_there_is_no_horizon(write_dem: WriteDem) -> None:
    heights = np.full((50, 50), -9999.0)
    heights[30:] = 10.0
    surface = Surface(read_terrain([write_dem(heights, void=-9999.0)]))
    elevation_deg, distance_m = surface.horizon(surface.observer(29.0, 25.0, 12.0), np.array([0.0, 180.0]))
    assert np.isnan([elevation_deg[0], distance_m[0]]).all()
    assert np.isfinite([elevation_deg[1], distance_m[1]]).all()
