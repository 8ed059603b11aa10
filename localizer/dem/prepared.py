"""What rays need of a DEM (`horizon.Terrain`), computed once and kept with the DEM."""

from dataclasses import replace

from localizer.dem.horizon import EARTH_RADIUS_M, REFRACTION, Terrain, prepare_terrain
from localizer.dem.lattice import Dem

_KEPT = "_prepared_terrain"


def prepared(dem: Dem, refraction_coefficient: float = REFRACTION) -> Terrain:
    """The DEM made ready for rays. The first call computes it, and from then on ``dem.z_m`` cannot be written."""
    terrain: Terrain | None = vars(dem).get(_KEPT)
    if terrain is None:
        dem.z_m.setflags(write=False)  # a change would go unseen: what is kept was computed before it
        terrain = vars(dem)[_KEPT] = prepare_terrain(dem)
    if refraction_coefficient == REFRACTION:
        return terrain
    return replace(terrain, drop_per_m2=(1.0 - refraction_coefficient) / (2.0 * EARTH_RADIUS_M))
