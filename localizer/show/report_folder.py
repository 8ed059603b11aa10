"""The report folder: HTML page and export files, each complete or absent."""

import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from localizer import output_files
from localizer.bundle import Bundle
from localizer.dem.lattice import Dem
from localizer.durable import sync, write_synced
from localizer.errors import SkyfixError
from localizer.search.details import LocateResult
from localizer.show.candidates import CandidatePlace, places
from localizer.show.geojson import candidates_geojson
from localizer.show.gpx import fix_gpx
from localizer.show.kml import fix_kml
from localizer.show.output_parts import OutputParts
from localizer.show.page import page
from localizer.show.posterior import Posterior, posterior, posterior_tif
from localizer.truth import Truth

PAGE = "report.html"
BESIDE_IT = (
    ("posterior.tif", "probability of each cell, GeoTIFF"),
    ("candidates.geojson", "places and 95 % ellipses"),
    ("fix.gpx", "waypoints for navigation devices"),
    ("fix.kml", "placemarks for globes"),
)


def prepare_folder(folder: Path) -> None:
    """Create the folder unless it is there, and make sure that the report can be written: before a search, not after it.

    Raises ``SkyfixError``.
    """
    output_files.prepare_folder("--report", folder)
    for name in (PAGE, *(name for name, _ in BESIDE_IT)):
        if (folder / name).is_dir():
            raise SkyfixError(
                f"--report: {folder / name}: is a folder where a file belongs; name another folder"
            )


def write_report(
    folder: Path,
    bundle: Bundle,
    images: Mapping[str, NDArray[np.uint8]],
    result: LocateResult,
    dem: Dem,
    truth: Truth | None = None,
) -> None:
    """Write the page and what belongs beside it into a folder that ``prepare_folder`` has seen.

    Where the result names no place there is only the page; files of an earlier report are removed, so that no old place
    lies beside a new page. A file that cannot be made costs none of the others: the page names it, and so does the
    ``SkyfixError`` that is raised when all others are written. ``images``: each frame's picture, BGR, by label.
    """
    parts = OutputParts()
    found: tuple[CandidatePlace, ...] = ()
    spread: Posterior | None = None
    with parts.part(f"--report: {folder}: the places"):
        found = places(result, dem)
    if found:
        with parts.part(f"--report: {folder / 'posterior.tif'}"):
            spread = posterior(found, dem)
    content: dict[str, bytes] = {}
    for name, contents in _exporters(found, spread, bundle, result, dem).items():
        with parts.part(f"--report: {folder / name}"):
            content[name] = contents()
    beside = [(name, what) for name, what in BESIDE_IT if name in content]
    missing = [note.replace(f"{folder}/", "") for note in parts.notes]
    with parts.part(f"--report: {folder / PAGE}"):
        html = page(bundle, images, result, dem, found, spread, beside, truth, missing)
        content[PAGE] = html.encode()
    _replace_all(folder, content)
    parts.end()


def files_beside(
    found: Sequence[CandidatePlace], spread: Posterior, bundle: Bundle, result: LocateResult, dem: Dem
) -> dict[str, bytes]:
    """The contents of all files but the page, by name."""
    return {name: contents() for name, contents in _exporters(found, spread, bundle, result, dem).items()}


def _exporters(
    found: Sequence[CandidatePlace], spread: Posterior | None, bundle: Bundle, result: LocateResult, dem: Dem
) -> dict[str, Callable[[], bytes]]:
    """What makes the contents of each file but the page, by name."""
    exporters: dict[str, Callable[[], bytes]] = {}
    if spread is not None:
        exporters["posterior.tif"] = lambda: posterior_tif(spread, dem)
    if found:
        exporters["candidates.geojson"] = lambda: candidates_geojson(found, result.fix, bundle, dem).encode()
        exporters["fix.gpx"] = lambda: fix_gpx(found, result.fix, bundle).encode()
        exporters["fix.kml"] = lambda: fix_kml(found, result.fix, bundle).encode()
    return exporters


def _replace_all(folder: Path, content: Mapping[str, bytes]) -> None:
    """Write all files to a temporary folder, then rename them one by one, so that no file is ever incomplete."""
    name = ""
    try:
        with tempfile.TemporaryDirectory(prefix=".report-", dir=folder) as aside:
            for name, data in content.items():
                write_synced(Path(aside) / name, data)
            for name in (PAGE, *(name for name, _ in BESIDE_IT)):
                if name not in content:
                    (folder / name).unlink(missing_ok=True)
            for name in content:
                (Path(aside) / name).replace(folder / name)
            sync(folder)
    except OSError as error:
        raise SkyfixError(f"--report: {folder / name}: {error.strerror}") from None
