"""A result as files to look at and to hand on."""

from os import PathLike
from pathlib import Path

from localizer.bundle import Bundle, frame_image
from localizer.dem.lattice import Dem
from localizer.search.details import LocateResult
from localizer.show.report_folder import prepare_folder, write_report
from localizer.truth import Truth


def save_report(
    folder: str | PathLike[str], result: LocateResult, bundle: Bundle, dem: Dem, *, truth: Truth | None = None
) -> None:
    """Write what is known of a result into a folder.

    Parameters
    ----------
    folder : path-like
        Created if it does not exist. Files of an earlier report are replaced.
    result : LocateResult
        What `locate` returned for the bundle.
    bundle : Bundle
        The measurement.
    dem : Dem
        The elevation model that was searched.
    truth : Truth, optional
        The known position, to be shown beside the one found.

    Raises
    ------
    SkyfixError
        A file cannot be written. All others are.

    See Also
    --------
    locate : The search.

    Notes
    -----
    ``report.html`` is one page without anything from elsewhere. Where there is a position, ``posterior.tif`` (probability of
    each cell), ``candidates.geojson``, ``fix.gpx`` and ``fix.kml`` lie beside it.

    Examples
    --------
    >>> dem, bundle = localizer.load_dem("terrain.tif"), localizer.load_bundle("bundles/first")
    >>> localizer.save_report("report", result, bundle, dem)  # the result of locate(bundle, dem)
    >>> sorted(file.name for file in Path("report").iterdir())
    ['candidates.geojson', 'fix.gpx', 'fix.kml', 'posterior.tif', 'report.html']
    """
    folder = Path(folder)
    prepare_folder(folder)
    images = {frame.label: frame_image(bundle, frame) for frame in bundle.frames}
    write_report(folder, bundle, images, result, dem, truth)
