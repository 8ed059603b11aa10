"""A result as files to look at and to hand on."""

from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from localizer import output_files
from localizer.bundle import Bundle, frame_image
from localizer.dem.lattice import Dem
from localizer.search.details import LocateResult
from localizer.show.plot import draw_fix
from localizer.show.report_folder import prepare_folder, write_report
from localizer.show.text import notes
from localizer.truth import Truth


def result_notes(result: LocateResult, bundle: Bundle, dem: Dem) -> list[str]:
    """Say what to know beside the fix of a bundle.

    Parameters
    ----------
    result : LocateResult
        What `locate` returned for the bundle.
    bundle : Bundle
        The measurement.
    dem : Dem
        The elevation model that was searched.

    Returns
    -------
    list of str
        One line each: a frame that contradicts the others, an altimeter that is off, why there is no position. Empty in the
        ordinary case.

    See Also
    --------
    dem_notes : What to know of the DEM.

    Examples
    --------
    >>> dem, bundle = localizer.load_dem("terrain.tif"), localizer.load_bundle("bundles/first")
    >>> localizer.result_notes(result, bundle, dem)  # the result of locate(bundle, dem)
    []
    """
    return notes(result, bundle, dem)


def save_figure(
    file: str | PathLike[str], result: LocateResult, bundle: Bundle, dem: Dem, *, truth: Truth | None = None
) -> None:
    """Draw the frames with their skylines, the map and the fix.

    Parameters
    ----------
    file : path-like
        Where to; its suffix names the format (png, svg, pdf).
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
        The file cannot be written, or has another suffix.

    Examples
    --------
    >>> dem, bundle = localizer.load_dem("terrain.tif"), localizer.load_bundle("bundles/first")
    >>> localizer.save_figure("fix.png", result, bundle, dem)  # the result of locate(bundle, dem)
    """
    file = Path(file)
    output_files.check_picture_path("file", file)
    with output_files.writing("file", file):
        draw_fix(file, _images(bundle), result, dem, truth)


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
    output_files.prepare_folder("folder", folder)
    prepare_folder(folder)
    write_report(folder, bundle, _images(bundle), result, dem, truth)


def _images(bundle: Bundle) -> dict[str, NDArray[np.uint8]]:
    return {frame.label: frame_image(bundle, frame) for frame in bundle.frames}
