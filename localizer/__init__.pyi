from .bundle import (
    Altitude,
    Bundle,
    BundleError,
    Camera,
    Frame,
    Prior,
    frame_image,
    load_bundle,
)
from .camera import azimuth_elevation_deg, camera_to_world, pixel_rays, project
from .dem.at_place import Horizon, ground_elevation_m, horizon
from .dem.geodesy import lonlat_to_rowcol, metric_to_rowcol, rowcol_to_lonlat, rowcol_to_metric
from .dem.info import DemInfo, dem_info, dem_notes
from .dem.lattice import Dem, dem_from_array, load_dem
from .dem.open import DemError
from .errors import SkyfixError
from .fix import Candidate, ErrorEllipse, Fix, Nuisance, Position, Reason, Stage1Counts
from .observation import FrameObservation, Observation, PriorCircle
from .predict.at_place import PredictedSkyline, predict_skyline
from .predict.views import Standpoint, Summit
from .search.details import FrameDetail, LocateDetails, LocateResult, SolvedErrors
from .search.measurement import locate, observation_from_bundle
from .show.results import result_notes, save_figure, save_report
from .skyline.find import ColumnState, Skyline, find_skyline
from .track.document import TrackHypothesis
from .track.odometry import Movement, OdometryError, load_odometry
from .track.tracker import Tracker, TrackerError, TrackStep
from .truth import Truth, load_truth
from .version import __version__ as __version__

__all__ = [
    "Altitude",
    "Bundle",
    "BundleError",
    "Camera",
    "Candidate",
    "ColumnState",
    "Dem",
    "DemError",
    "DemInfo",
    "ErrorEllipse",
    "Fix",
    "Frame",
    "FrameDetail",
    "FrameObservation",
    "Horizon",
    "LocateDetails",
    "LocateResult",
    "Movement",
    "Nuisance",
    "Observation",
    "OdometryError",
    "Position",
    "PredictedSkyline",
    "Prior",
    "PriorCircle",
    "Reason",
    "SkyfixError",
    "Skyline",
    "SolvedErrors",
    "Stage1Counts",
    "Standpoint",
    "Summit",
    "TrackHypothesis",
    "TrackStep",
    "Tracker",
    "TrackerError",
    "Truth",
    "azimuth_elevation_deg",
    "camera_to_world",
    "dem_from_array",
    "dem_info",
    "dem_notes",
    "find_skyline",
    "frame_image",
    "ground_elevation_m",
    "horizon",
    "load_bundle",
    "load_dem",
    "load_odometry",
    "load_truth",
    "locate",
    "lonlat_to_rowcol",
    "metric_to_rowcol",
    "observation_from_bundle",
    "pixel_rays",
    "predict_skyline",
    "project",
    "result_notes",
    "rowcol_to_lonlat",
    "rowcol_to_metric",
    "save_figure",
    "save_report",
]
