"""The predicted skyline in one direction from a place: elevation, distance, and where it is unreliable."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import find_peaks

from localizer.dem.at_place import rowcol_inside
from localizer.dem.geodesy import geodesic_end, rowcol_to_lonlat
from localizer.dem.horizon import NEAR_CELLS, Terrain, at_dem_edge, horizon
from localizer.dem.lattice import Dem
from localizer.errors import SkyfixError

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

STEP_DEG = 0.05
MARCH_STEPS = 512
LEAST_PROMINENCE_DEG = 0.2
MOST_SUMMITS = 8


@dataclass(frozen=True)
class Standpoint:
    """Where the camera is put.

    Attributes
    ----------
    lat_deg, lon_deg : float
        WGS84.
    row, col : float
        The same in the DEM's cells, centres at whole numbers.
    ground_m : float
        Elevation of the ground above the DEM's vertical datum.
    altitude_m : float
        Of the optical centre, above the same.
    """

    lat_deg: float
    lon_deg: float
    row: float
    col: float
    ground_m: float
    altitude_m: float


@dataclass(frozen=True)
class Summit:
    """A point of the skyline that stands out.

    Attributes
    ----------
    azimuth_deg : float
        True azimuth, 0 to 360.
    elevation_deg : float
        Angle above the horizontal.
    distance_m : float
        Along the ground.
    lat_deg, lon_deg : float
        Of the terrain there, WGS84.
    height_m : float
        Of the terrain there, above the DEM's vertical datum.
    """

    azimuth_deg: float
    elevation_deg: float
    distance_m: float
    lat_deg: float
    lon_deg: float
    height_m: float


@dataclass(frozen=True)
class View:
    """The skyline in one direction. All arrays are (n,), from left to right."""

    azimuth_deg: float
    """Of the middle."""
    width_deg: float
    offset_deg: Floats
    """Azimuths from the middle, so that they run on through north."""
    elevation_deg: Floats
    """-90 where a ray meets no terrain."""
    distance_m: Floats
    """NaN there."""
    at_edge: Flags
    """The skyline lies at the DEM edge or a void, or there is none: the search does not use it."""
    too_near: Flags
    """Nearer than NEAR_CELLS cells, which the DEM does not resolve."""
    may_be_overtopped: Flags
    """Terrain beyond the DEM, no higher than the DEM's highest point, would be above the skyline."""
    summits: tuple[Summit, ...]
    """By azimuth."""

    @property
    def azimuths_deg(self) -> Floats:
        """True azimuths, 0 to 360."""
        return np.asarray((self.azimuth_deg + self.offset_deg) % 360.0)

    @property
    def range_deg(self) -> tuple[float, float]:
        """Lowest and highest elevation of the skyline away from the DEM edge; 0 if all of it is at the edge."""
        chosen = self.elevation_deg[~self.at_edge]
        return (float(chosen.min()), float(chosen.max())) if chosen.size else (0.0, 0.0)


def standpoint(dem: Dem, lat_deg: float, lon_deg: float, mast_height_m: float) -> Standpoint:
    """A camera on a mast at a place. Raises ``SkyfixError`` where the DEM knows no ground there."""
    row, col = (float(value) for value in rowcol_inside(dem, np.asarray(lat_deg), np.asarray(lon_deg)))
    ground_m = float(dem.ground_m(row, col))
    if np.isnan(ground_m):
        raise SkyfixError(
            f"{lat_deg:.5f},{lon_deg:.5f} lies in a void of the DEM (row {row:.1f}, col {col:.1f}); name a place beside it"
        )
    return Standpoint(lat_deg, lon_deg, row, col, ground_m, ground_m + mast_height_m)


def view(terrain: Terrain, place: Standpoint, azimuth_deg: float, width_deg: float) -> View:
    """The skyline ``width_deg`` wide around a true azimuth."""
    half = int(np.ceil(0.5 * width_deg / STEP_DEG))
    offset_deg = np.linspace(-0.5, 0.5, 2 * half + 1) * width_deg
    azimuths_deg = azimuth_deg + offset_deg
    elevation, distance = horizon(terrain, place.row, place.col, place.altitude_m, azimuths_deg)
    elevation_deg, distance_m = elevation[0], distance[0]
    end_m = _end_of_terrain_m(terrain, place, azimuths_deg)
    hidden_up_to_m = (
        place.altitude_m + np.tan(np.radians(elevation_deg)) * end_m + terrain.drop_per_m2 * end_m**2
    )
    at_edge = at_dem_edge(terrain, place.row, place.col, np.radians(azimuths_deg), distance_m)
    return View(
        azimuth_deg=azimuth_deg,
        width_deg=width_deg,
        offset_deg=offset_deg,
        elevation_deg=elevation_deg,
        distance_m=distance_m,
        at_edge=at_edge,
        too_near=distance_m < NEAR_CELLS * terrain.cell_m,
        may_be_overtopped=~at_edge & (hidden_up_to_m < terrain.highest_m),
        summits=_summits(terrain, place, azimuths_deg, elevation_deg, distance_m, at_edge),
    )


def along(
    terrain: Terrain, place: Standpoint, azimuth_deg: Floats, distance_m: Floats
) -> tuple[Floats, Floats]:
    """Row and col, elementwise, at distances along geodesics in true azimuths from a place."""
    coefficients = terrain.geodesics.at(place.row, place.col)[0]
    azimuth = np.radians(azimuth_deg)
    return geodesic_end(
        coefficients, place.row, place.col, distance_m * np.sin(azimuth), distance_m * np.cos(azimuth)
    )


def _end_of_terrain_m(terrain: Terrain, place: Standpoint, azimuth_deg: Floats) -> Floats:
    """Distance at which each ray leaves the lattice, to a fraction of a per cent of the DEM's size."""
    dem = terrain.dem
    step_m = np.hypot(dem.rows * dem.spacing_ns_m, dem.cols * dem.spacing_ew_m) / MARCH_STEPS
    distance_m = np.arange(MARCH_STEPS + 1) * step_m
    row, col = along(terrain, place, azimuth_deg[:, None], distance_m[None, :])
    outside = (row < 0.0) | (row > dem.rows - 1) | (col < 0.0) | (col > dem.cols - 1)
    outside[:, -1] = True
    return np.asarray(distance_m[np.argmax(outside, axis=1)])


def _summits(
    terrain: Terrain,
    place: Standpoint,
    azimuths_deg: Floats,
    elevation_deg: Floats,
    distance_m: Floats,
    at_edge: Flags,
) -> tuple[Summit, ...]:
    """The most prominent peaks of the skyline; its highest point where it has none. The DEM's edge has no summits."""
    known = np.where(at_edge, -90.0, elevation_deg)
    if at_edge.all():
        return ()
    peaks, facts = find_peaks(elevation_deg, prominence=LEAST_PROMINENCE_DEG)
    kept = ~at_edge[peaks]
    peaks, prominences = peaks[kept], facts["prominences"][kept]
    peaks = np.sort(peaks[np.argsort(-prominences, kind="stable")[:MOST_SUMMITS]])
    if len(peaks) == 0:
        peaks = np.array([int(np.argmax(known))])
    row, col = along(terrain, place, azimuths_deg[peaks], distance_m[peaks])
    lon_deg, lat_deg = rowcol_to_lonlat(terrain.dem, row, col)
    height_m = terrain.dem.ground_m(row, col)
    return tuple(
        Summit(
            azimuth_deg=float(azimuths_deg[peak] % 360.0),
            elevation_deg=float(elevation_deg[peak]),
            distance_m=float(distance_m[peak]),
            lat_deg=float(lat_deg[i]),
            lon_deg=float(lon_deg[i]),
            height_m=float(height_m[i]),
        )
        for i, peak in enumerate(peaks)
    )


def warnings(seen: View) -> list[str]:
    """Warnings about unreliable parts, as sentences."""
    out = []
    if (share := float(seen.at_edge.mean())) > 0.0:
        out.append(
            f"{share:.0%} of the skyline is the edge of the DEM or of a void: the terrain beyond is unknown; "
            "take a DEM that reaches farther"
        )
    if (share := float(seen.too_near.mean())) > 0.0:
        out.append(
            f"{share:.0%} of the skyline is nearer than {NEAR_CELLS:.0f} cells: this DEM is too coarse to tell its shape"
        )
    if (share := float(seen.may_be_overtopped.mean())) > 0.0:
        out.append(
            f"land beyond the DEM's edge, were it as high as the DEM's highest, would stand above {share:.0%} of the skyline"
        )
    return out
