"""The estimation problem of one standpoint: observations, unknowns, and their priors (errata, gap 8).

The unknowns x are east and north (metres from a starting place), the altitude of the camera, the biases of azimuth and tilt
that all frames share, and azimuth, tilt and roll errors of each frame. The sensors give each of them but east and north
a Gaussian prior.
"""

import numpy as np
from numpy.typing import NDArray

from localizer.dem.horizon import Terrain
from localizer.observation import Observation
from localizer.search.contours import FrameContour

Floats = NDArray[np.float64]

EAST, NORTH, ALTITUDE, AZIMUTH_BIAS, TILT_BIAS, FIRST_FRAME = range(6)
PER_FRAME = 3  # azimuth, tilt, roll
CONTOUR_DISTANCE_CELLS = 330.0
"""In an exact DEM the correlated error of neighbouring columns is that of the contour, whatever the distance. It is modelled
as a DEM error seen at this distance, where a cell subtends about a pixel. Tuned on ``sim evaluate --estimator-only``.
Sensitivity: not measured yet (``sim sensitivity``)."""
USUAL_CONTOUR_SHARE = 0.05
"""In an exact DEM, the initial correlated error as a share of the contour's sigma. Tuned on ``sim evaluate --estimator-only``.
Sensitivity: not measured yet (``sim sensitivity``)."""
LARGEST_CONTOUR_SHARE = 0.5
"""A larger correlated error means that the DEM is not exact. Tuned on ``sim evaluate --estimator-only``.
Sensitivity: not measured yet (``sim sensitivity``)."""
SECTOR_RAD = np.radians(6.0)
"""Sector of the horizon over which the skyline of an unrelated place has about the same residual. Tuned on the scenario
``dem_error``. Sensitivity: halved, 1 of 5 statuses changes, 1 wrong fix; doubled, 2 of 5 statuses change
(docs/sensitivity.md)."""


class Problem:
    """The observations and priors of one standpoint, thinned to every ``stride``-th column.

    ``uses_edge_columns``: columns whose predicted horizon lies at the DEM edge count like all others. ``sector_columns``: the
    number of columns in a full sector of SECTOR_RAD; that of the fullest sector if not given.
    """

    def __init__(
        self,
        terrain: Terrain,
        observation: Observation,
        contours: tuple[FrameContour, ...],
        stride: int = 1,
        *,
        uses_edge_columns: bool = False,
        sector_columns: int | None = None,
    ) -> None:
        self.terrain = terrain
        self.uses_edge_columns = uses_edge_columns or terrain.exact
        self.stride = stride
        self.observation = observation
        self.contours = [
            FrameContour(c.frame, np.ascontiguousarray(c.rays[::stride]), c.sigma_rad[::stride])
            for c in contours
        ]
        self.frame_of = np.repeat(np.arange(len(contours)), [len(c.rays) for c in self.contours])
        self.sigma_rad = np.concatenate([c.sigma_rad for c in self.contours])
        self.order, self.step_rad = self._along_the_horizon()
        self.sectors = self._sectors()
        fullest = max(len(block) for block in self.sectors)
        self.sector_columns = -(-sector_columns // stride) if sector_columns else fullest
        self.size = FIRST_FRAME + PER_FRAME * len(contours)
        prior = np.full(self.size, np.inf)
        prior[AZIMUTH_BIAS] = observation.azimuth_bias_sigma_deg
        prior[TILT_BIAS] = observation.tilt_bias_sigma_deg
        for i, c in enumerate(contours):
            f = c.frame
            prior[FIRST_FRAME + PER_FRAME * i :][:PER_FRAME] = (
                f.azimuth_sigma_deg,
                f.tilt_sigma_deg,
                f.roll_sigma_deg,
            )
        # A sigma of zero would make the normal equations singular.
        self.prior_sigma_deg = np.maximum(prior, 1e-3)

    @property
    def contour_distance_m(self) -> float:
        """Distance at which the correlated error of an exact DEM is modelled, metres."""
        return CONTOUR_DISTANCE_CELLS * self.terrain.cell_m

    @property
    def nominal_error_m(self) -> float:
        """Initial standard deviation of the correlated error, metres: of the DEM, or of the contour in an exact DEM."""
        if self.terrain.exact:
            return USUAL_CONTOUR_SHARE * self._contour_sigma_m
        return self.terrain.nominal_error_m

    @property
    def largest_error_m(self) -> float:
        """Largest plausible standard deviation of the correlated error, metres."""
        return (
            LARGEST_CONTOUR_SHARE * self._contour_sigma_m
            if self.terrain.exact
            else self.terrain.largest_error_m
        )

    @property
    def _contour_sigma_m(self) -> float:
        return float(np.median(self.sigma_rad)) * self.contour_distance_m

    def _along_the_horizon(self) -> tuple[NDArray[np.int64], Floats]:
        """Indices of all columns by azimuth, regardless of their frame, and the azimuth steps between them (the first
        infinite).

        Frames that overlap see the same ridge, so that their columns are neighbours.
        """
        azimuth = np.concatenate(
            [
                c.directions(c.frame.azimuth_deg, c.frame.tilt_deg, c.frame.roll_deg)[0] % (2.0 * np.pi)
                for c in self.contours
            ]
        )
        order = np.argsort(azimuth, kind="stable")
        step = np.diff(azimuth[order], prepend=azimuth[order[-1]] - 2.0 * np.pi)
        widest = int(step.argmax())
        order, step = np.roll(order, -widest), np.roll(step, -widest)
        step[0] = np.inf
        return order, step

    def _sectors(self) -> list[NDArray[np.int64]]:
        """Indices of the columns in each sector of SECTOR_RAD that has any."""
        place = np.cumsum(np.where(np.isfinite(self.step_rad), self.step_rad, 0.0)) // SECTOR_RAD
        return np.split(self.order, np.flatnonzero(np.diff(place)) + 1)

    def directions(self, x: Floats) -> tuple[Floats, Floats, Floats]:
        """Azimuth and elevation (n,) in radians under the biases in ``x``, and their derivatives by tilt and roll (n, 4)."""
        azimuths, elevations, derivatives = [], [], []
        step = 0.01
        for i, contour in enumerate(self.contours):
            f = contour.frame
            own = x[FIRST_FRAME + PER_FRAME * i :][:PER_FRAME]
            attitude = (
                np.array([f.azimuth_deg - x[AZIMUTH_BIAS], f.tilt_deg - x[TILT_BIAS], f.roll_deg]) - own
            )
            azimuth, elevation = contour.directions(*attitude)
            tilted = contour.directions(attitude[0], attitude[1] - step, attitude[2])
            rolled = contour.directions(attitude[0], attitude[1], attitude[2] - step)
            azimuths.append(azimuth)
            elevations.append(elevation)
            derivatives.append(
                np.column_stack(
                    [
                        _wrapped(tilted[0] - azimuth),
                        tilted[1] - elevation,
                        _wrapped(rolled[0] - azimuth),
                        rolled[1] - elevation,
                    ]
                )
                / step
            )
        return (np.concatenate(azimuths), np.concatenate(elevations), np.concatenate(derivatives))


def _wrapped(radians: Floats) -> Floats:
    return (radians + np.pi) % (2.0 * np.pi) - np.pi
