"""The search for a program: a bundle, or contours that come from elsewhere, and a DEM."""

from collections.abc import Sequence
from dataclasses import replace

from localizer.bundle import Bundle, Prior
from localizer.dem.crs import wrapped_lon_deg
from localizer.dem.lattice import Dem
from localizer.dem.prepared import prepared
from localizer.observation import Observation, PriorCircle
from localizer.search.altitude_reference import with_datum_uncertainty
from localizer.search.details import LocateResult
from localizer.search.frame_details import details_of_contours
from localizer.search.locate import check_located, diagnosed_fix, load_kernels, locate_bundle, observe
from localizer.search.locate import locate as locate_contours
from localizer.skyline.find import Skyline
from localizer.skyline.upright import frame_skyline

NO_MEASUREMENT = "measurement: is a {}; give a Bundle, as load_bundle reads it, or an Observation"


def locate(
    measurement: Bundle | Observation,
    dem: Dem,
    *,
    prior: PriorCircle | None = None,
    name: str = "observation",
) -> LocateResult:
    """Search a DEM for the place from which the terrain has the measured skyline.

    Parameters
    ----------
    measurement : Bundle or Observation
        A bundle, in whose pictures the skylines are found first, or contours that you have found yourself.
    dem : Dem
        The elevation model. Its error, where you know it, is an option of `load_dem`.
    prior : PriorCircle, optional
        Search only within this circle. It takes the place of the measurement's own prior.
    name : str, optional
        What the result calls an observation; a bundle goes by its id.

    Returns
    -------
    LocateResult
        The fix, and what led to it.

    Raises
    ------
    BundleError
        A picture of the bundle cannot be read.
    TypeError
        The measurement is something else, as the name of a bundle.

    See Also
    --------
    Tracker : For several bundles of a drive.
    observation_from_bundle : The contours of a bundle, to be changed before the search.

    Notes
    -----
    Look at ``result.fix.status`` before you use a position. Only ``fix`` says that one place stands out; ``ambiguous`` has
    several candidates, ``none`` has no position. A frame that contradicts all others is left out, if there are three or more.

    The method is that of Talluri and Aggarwal, "Position Estimation for an Autonomous Mobile Robot in an Outdoor
    Environment", 1992, with a robust fit of position, biases and DEM error in place of its grid search; see "How it works" in
    the documentation.

    Examples
    --------
    >>> dem = localizer.load_dem("terrain.tif")
    >>> result = localizer.locate(localizer.load_bundle("bundles/first"), dem)
    >>> result.fix.status
    'fix'
    >>> truth = localizer.load_truth("truth.json")
    >>> truth.distance_m(result.fix.position, dem) < 5.0
    True
    """
    if isinstance(measurement, Bundle):
        if prior is not None:
            circle = Prior(
                lat_deg=prior.lat_deg, lon_deg=wrapped_lon_deg(prior.lon_deg), radius_m=prior.radius_m
            )
            measurement = measurement.model_copy(update={"prior": circle})
        return locate_bundle(measurement, dem)
    if not isinstance(measurement, Observation):
        raise TypeError(NO_MEASUREMENT.format(type(measurement).__name__))
    terrain = prepared(dem)
    load_kernels(terrain)
    observation = with_datum_uncertainty(
        measurement if prior is None else replace(measurement, prior=prior), dem
    )
    located = locate_contours(terrain, observation)
    checked = check_located(terrain, observation, located)
    fix = diagnosed_fix(terrain, observation, checked.located, name, located.timing_s)
    return LocateResult(fix, details_of_contours(terrain, observation, checked))


def observation_from_bundle(bundle: Bundle, skylines: Sequence[Skyline] | None = None) -> Observation:
    """Take the contours of a bundle, and its readings, as the search is given them.

    Parameters
    ----------
    bundle : Bundle
        The measurement.
    skylines : sequence of Skyline, optional
        One for each frame, in the bundle's order, as from a finder of your own; by default `find_skyline` looks for them. The
        picture of a frame whose roll is nearest to 90, 180 or 270 degrees counts as turned upright.

    Returns
    -------
    Observation
        Of each frame the columns whose state is ``OK`` and whose confidence is at least 0.5.

    Raises
    ------
    BundleError
        A picture of the bundle cannot be read.
    ValueError
        There are more or fewer skylines than frames.

    Examples
    --------
    >>> observation = localizer.observation_from_bundle(localizer.load_bundle("bundles/first"))
    >>> [(frame.label, frame.v_px.shape) for frame in observation.frames]
    [('N', (640,)), ('E', (640,)), ('S', (640,)), ('W', (640,))]
    """
    found = [frame_skyline(bundle, frame) for frame in bundle.frames] if skylines is None else list(skylines)
    if len(found) != len(bundle.frames):
        raise ValueError(f"skylines: are {len(found)} for {len(bundle.frames)} frames; give one for each")
    return observe(bundle, found)
