"""Options shared by commands of ``sim``."""

from localizer.commands.command_line import dem_files_option
from sim.shipped_files import EMBEDDED_DEM as EMBEDDED_DEM

dem_option = dem_files_option(
    "Elevation raster; repeat it for files that adjoin. Default: the terrain that comes with skyfix."
)
