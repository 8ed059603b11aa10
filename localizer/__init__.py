"""Find where pictures of the horizon were taken: what ``localizer`` does on the command line, for a program.

>>> import localizer
>>> dem = localizer.load_dem("terrain.tif")
>>> skyline = localizer.predict_skyline(dem, 37.25, -122.15)
>>> f"from {skyline.elevation_deg.min():.1f} to {skyline.elevation_deg.max():.1f} deg above the horizontal"
'from -1.9 to 19.4 deg above the horizontal'

Names carry their units. Angles are degrees; azimuths are true, clockwise from north; latitudes and longitudes are WGS84.
Altitudes are metres above the DEM's vertical datum. Arrays are numpy arrays; pixel centres lie at whole numbers.

Elevations
    `load_dem`, `dem_from_array`, `dem_info`, `dem_notes`, `ground_elevation_m`, `horizon`, `predict_skyline`, and
    `lonlat_to_rowcol`, `rowcol_to_lonlat`, `metric_to_rowcol`, `rowcol_to_metric` between coordinates and cells.
Measurements
    `load_bundle`, `frame_image`, `find_skyline`, `observation_from_bundle`, or contours of your own as an `Observation`.
Camera
    `camera_to_world`, `pixel_rays`, `project`, `azimuth_elevation_deg`.
Search
    `locate`; `Tracker` for a drive; `Movement` and `load_odometry` for what lies between two stops.
Results
    `LocateResult`, `Fix`, `TrackStep`, `PredictedSkyline`; `result_notes` says what to know beside a fix; `save_figure`
    and `save_report` write files to look at; `load_truth` reads a known position to compare with.

An expected failure, such as a file that cannot be read, raises `SkyfixError`; its message is one line. A wrong argument
raises ``ValueError``.

The names in ``__all__`` are the public interface. `localizer.experiments` has the stages of the search by themselves, for
experiments; it may change from version to version. All else is private.

Nothing is imported until it is used: ``import localizer`` alone is quick.
"""

import lazy_loader

# The stub beside this file says where each name is; type checkers read it, too.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
__all__.remove("__version__")  # ``import *`` leaves the importing module's own
