"""The stages of the search by themselves, for experiments. They may change from version to version.

`localizer.locate` is the whole search. What is here lets an experiment prepare a terrain once, search contours without the
check of single frames, look at the cells that stage 1 leaves, and put the answer into the terms of a fix.

Terrain
    `Terrain` and `prepare_terrain`: a DEM made ready for rays; `horizon_around`: the horizon of one observer, in radians and
    tangents; `load_kernels`: compiles what is slow the first time.
Search
    `search_observation` (terrain, observation) gives a `Located`; its ``best`` is a `Refined`, the fit of one place;
    `search_bundle` (bundle, dem) is the whole search; `grid_only_estimate` is the paper's own.
Skyline
    `CONFIDENT`: columns with at least this confidence are used.
Answer
    `fix_of`, `metric_covariance`.
Geometry
    `ground_distance_m`, `ground_offset_m` on the ground between map coordinates; `transform_xy` between CRSs.
"""

from localizer.dem.crs import transform_xy
from localizer.dem.ground import ground_distance_m, ground_offset_m
from localizer.dem.horizon import Terrain, horizon_around, prepare_terrain
from localizer.search.answer import Located, fix_of, metric_covariance
from localizer.search.fit.refine import Refined
from localizer.search.grid_only import grid_only_estimate
from localizer.search.locate import load_kernels
from localizer.search.locate import locate as search_observation
from localizer.search.locate import locate_bundle as search_bundle
from localizer.skyline.find import CONFIDENT

__all__ = [
    "CONFIDENT",
    "Located",
    "Refined",
    "Terrain",
    "fix_of",
    "grid_only_estimate",
    "ground_distance_m",
    "ground_offset_m",
    "horizon_around",
    "load_kernels",
    "metric_covariance",
    "prepare_terrain",
    "search_bundle",
    "search_observation",
    "transform_xy",
]
