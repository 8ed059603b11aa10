"""Options that several commands of ``sim`` share."""

from pathlib import Path

import click

EMBEDDED_DEM = Path(__file__).parent / "terrain" / "santa_cruz_srtm_1s.tif"

dem_option = click.option(
    "--dem",
    "dem_paths",
    type=click.Path(path_type=Path),
    multiple=True,
    metavar="FILE",
    help="Elevation raster; repeat it for files that adjoin. Default: the terrain that comes with skyfix.",
)
