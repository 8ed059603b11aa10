"""The scenario of an evaluation's cases.

At contour level there are no devices: errors are given as the sigmas of the localizer's input. The drawn errors
(``errors``) and the sigmas given to the localizer (``told``) are the same unless a scenario separates them.
"""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from sim.shipped_files import SCENARIOS
from sim.world.scenario import CameraOptics, Finite, NonNegative, Place, Positive, Section, Weather, read_toml

Share = Annotated[float, Field(ge=0.0, le=1.0)]


class Vehicle(Section):
    """The base under the camera."""

    mast_height_m: Positive = 2.0
    max_tilt_deg: Annotated[float, Field(ge=0.0, le=30.0)] = (
        0.0  # lean of the base; the camera's roll follows
    )


class View(Section):
    """Directions of the camera; its tilt centres the skyline in the image."""

    azimuths_deg: tuple[Finite, ...] = (0.0, 90.0, 180.0, 270.0)
    drawn_frames: tuple[int, int] | None = None  # that many (from, to) at any azimuths instead

    @model_validator(mode="after")
    def _some_frames(self) -> "View":
        least, most = self.drawn_frames or (len(self.azimuths_deg),) * 2
        if not 1 <= least <= most <= 32:
            raise ValueError("1 to 32 frames, the smaller number first")
        return self


class Errors(Section):
    """Sigmas of what is drawn for each case (bias) and for each frame or column."""

    altimeter: bool = True
    altitude_sigma_m: Positive = 5.0
    azimuth_bias_sigma_deg: NonNegative = 0.005  # 180: any heading at all
    tilt_bias_sigma_deg: NonNegative = 0.005
    azimuth_sigma_deg: NonNegative = 0.005
    tilt_sigma_deg: NonNegative = 0.005
    roll_sigma_deg: NonNegative = 0.005
    contour_sigma_px: NonNegative = 0.0  # of each column by itself
    contour_correlated_sigma_px: NonNegative = 0.0  # of errors that neighbours share, ...
    contour_correlation_px: Positive = 10.0  # ... over about so many columns


class AssumedSigmas(Section):
    """Sigmas given to the localizer if they differ from ``errors``."""

    altitude_sigma_m: Positive | None = None
    azimuth_bias_sigma_deg: NonNegative | None = None
    tilt_bias_sigma_deg: NonNegative | None = None
    azimuth_sigma_deg: NonNegative | None = None
    tilt_sigma_deg: NonNegative | None = None
    roll_sigma_deg: NonNegative | None = None
    contour_sigma_px: Positive | None = None


class DemError(Section):
    """Error of the searched DEM: a random field of heights added to the truth's."""

    rms_m: Positive
    correlation_m: Positive = 200.0  # where the correlation has fallen to 1/e


class Twins(Section):
    """The DEM holds a crop of itself twice; the copy differs by a random field of heights, its size drawn for each case."""

    cells: Annotated[int, Field(ge=100, le=4000)] = 500  # a side, of the crop
    relief_m: Annotated[tuple[NonNegative, ...], Field(min_length=1)] = (0.0, 1.0, 3.0, 10.0)  # rms
    correlation_m: Positive = 200.0


class Foreground(Section):
    """Foreground objects (bushes, boulders, masts) above the terrain's skyline."""

    per_frame: NonNegative = 1.5  # mean number
    width_deg: Positive = 4.0  # median
    height_deg: Positive = 1.5  # mean, above the skyline
    noticed: Share = 0.5  # of them are declared untrustworthy, that is, dropped


class Occlusion(Section):
    """Occlusion of whole frames: a wall, a slope of rubble, trees."""

    frames: Annotated[int, Field(ge=1)] = 1
    missing: Share = 0.5  # of them have no contour; the others have the wrong thing's
    height_deg: Positive = 6.0  # mean, above the skyline


class Cloud(Section):
    """Clouds over intervals of the skyline: terrain above the base is hidden, and a lower edge is taken for the
    skyline.
    """

    per_frame: NonNegative = 1.0
    width_deg: Positive = 15.0  # median
    lowest_share: Share = (
        0.3  # base: from this share of the way from the camera up to the highest peak in view to ...
    )
    highest_share: Share = 1.0  # ... this share
    noticed: Share = 0.5  # of the stretches are declared untrustworthy


class EvaluationScenario(Section):
    """The whole scenario. Absent sections have no effect."""

    place: Place = Place()
    vehicle: Vehicle = Vehicle()
    view: View = View()
    camera: CameraOptics = CameraOptics()
    weather: Weather = Weather()  # of pictures
    errors: Errors = Errors()
    told: AssumedSigmas = AssumedSigmas()
    dem_error: DemError | None = None
    twins: Twins | None = None
    foreground: Foreground | None = None
    occlusion: Occlusion | None = None
    cloud: Cloud | None = None
    searched: Literal["all", "other half"] = (
        "all"  # of the DEM; in the other half the truth is not to be found
    )
    outside_margin_m: NonNegative = 1000.0  # the truth stays this far from what is searched

    @model_validator(mode="after")
    def _twins_are_a_dem_of_their_own(self) -> "EvaluationScenario":
        if self.twins is not None and (self.dem_error is not None or self.searched != "all"):
            raise ValueError("[twins] goes neither with [dem_error] nor with half of the DEM")
        return self

    def assumed_sigma(self, name: str) -> float:
        """The sigma given to the localizer, by the name of its error."""
        told = getattr(self.told, name)
        return float(getattr(self.errors, name) if told is None else told)


def load_evaluation_scenario(path: Path) -> EvaluationScenario:
    """Read a scenario from a TOML file.

    Raises:
        SimulationError: the file cannot be read, is no TOML, or has an unknown key or a bad value.
    """
    return read_toml(path, EvaluationScenario, SCENARIOS / "evaluate" / "realistic.toml")
