"""Options shared by commands of ``sim``."""

from pathlib import Path

from localizer.commands.command_line import dem_files_option

EMBEDDED_DEM = Path(__file__).parents[1] / "terrain" / "santa_cruz_srtm_1s.tif"

dem_option = dem_files_option(
    "Elevation raster; repeat it for files that adjoin. Default: the terrain that comes with skyfix."
)
