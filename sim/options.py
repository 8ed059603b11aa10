"""Options that several commands of ``sim`` share."""

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import click

EMBEDDED_DEM = Path(__file__).parent / "terrain" / "santa_cruz_srtm_1s.tif"

F = TypeVar("F", bound=Callable[..., object])


def dem_files(meaning: str) -> Callable[[F], F]:
    """``--dem FILE``, as often as wanted; ``meaning`` says for the help what several are."""
    return click.option(
        "--dem",
        "dem_paths",
        type=click.Path(path_type=Path),
        multiple=True,
        metavar="FILE",
        help=f"Elevation raster; {meaning}",
    )


dem_option = dem_files("repeat it for files that adjoin. Default: the terrain that comes with skyfix.")
