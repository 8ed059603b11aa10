"""The standpoints: each as a real bundle with realistic sigmas, its DEM and the truth."""

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from pyproj import CRS

from localizer import Altitude, Bundle, Camera, Frame
from sim.errors import SimulationError
from sim.evaluate.photos.conversions import (
    cropped,
    distortion_of,
    principal_point_px,
    trace_rows_px,
    true_azimuth_deg,
)
from sim.evaluate.photos.source import Image, existing, read_image, read_json
from sim.evaluate.photos.traced_pictures import rendered_folders

Floats = NDArray[np.float64]

UNKNOWN_TIME = datetime(2000, 1, 1, 12, tzinfo=UTC)
"""A bundle must have a time; the search does not use it."""
MAST_HEIGHT_M = 2.0
ALTIMETER_SIGMA_M = 15.0
"""Sigma of a barometric altimeter: the photographs' altitudes are surveyed, but a vehicle would not have that."""
COLUMBIA_GEOID_M = 16.0
"""Height of mean sea level above the ellipsoid, good to a metre."""
COLUMBIA_TILT_SIGMA_DEG = 0.15
COLUMBIA_ROLL_SIGMA_DEG = 0.3

ALETSCH_PAPER = {"left": 30, "top": 22, "right": 996, "bottom": 736}
"""The photograph itself within the paper's white border, first column and row and those after the last."""
ALETSCH_FOCAL_PX = 958.0
ALETSCH_LV03_M = (650244.0, 142541.0)
ALETSCH_ALTITUDE_M, ALETSCH_ALTITUDE_SIGMA_M = 2826.0, 38.0
ALETSCH_GRID_AZIMUTH_DEG, ALETSCH_TILT_DEG, ALETSCH_ROLL_DEG = 296.4, -8.7, -0.3
ALETSCH_ANGLE_SIGMA_DEG = 0.4

RENDERED_DEMS = {
    "bt": "bigtujunga_srtm_30m.tif",
    "sh": "sthelens_usgs_30m.dem",
    "yo": "yosemite_ned_1s.tif",
}


@dataclass(frozen=True)
class Standpoint:
    """One place.

    Attributes:
        dataset, name: what it is called in the tables.
        bundle: a bundle's directory, true azimuths in it (a real compass's own errors in the rendered ones).
        dem: the file to be searched; dem_nodata: a further value that means void there.
        crs, easting_m, northing_m: the truth.
        truth_sigma_m: how well that is known.
        traced: rows of the skyline as a person traced it, by frame label; empty where nobody did.
    """

    dataset: str
    name: str
    bundle: Path
    dem: Path
    dem_nodata: float | None
    crs: CRS
    easting_m: float
    northing_m: float
    truth_sigma_m: float
    traced: Mapping[str, Floats]


def standpoints(data_dir: Path, work_dir: Path) -> Iterator[Standpoint]:
    """All standpoints, converted to bundles below `work_dir` where necessary. Raises SimulationError for missing data."""
    yield from _columbia(data_dir, work_dir)
    yield _aletsch(data_dir, work_dir)
    yield from _rendered(data_dir)


def _columbia(data_dir: Path, work_dir: Path) -> Iterator[Standpoint]:
    folder = existing(data_dir / "local-only" / "columbia")
    truth = read_json(folder / "truth.json")
    crs = CRS.from_user_input(truth["crs_xyz"].split(",")[0])
    for photo in truth["photos"]:
        image = read_image(folder / photo["photo"])
        name = Path(photo["photo"]).stem[:19]
        easting_m, northing_m, ellipsoid_m = photo["utm6n_xyz_hae"]
        yaw_deg, pitch_deg, roll_deg = photo["yaw_pitch_roll_deg"]
        cx, cy = principal_point_px(photo["size"], photo["c_offset_px"])
        camera = _camera(image, photo["f_px"], (cx, cy), distortion_of(photo["k"], photo["p"]))
        bundle = write_bundle(
            work_dir / name,
            image,
            camera,
            altitude=Altitude(value_m=ellipsoid_m - COLUMBIA_GEOID_M, sigma_m=ALTIMETER_SIGMA_M),
            azimuth_deg=true_azimuth_deg(crs, easting_m, northing_m, yaw_deg),
            tilt_deg=pitch_deg,
            roll_deg=roll_deg,
            tilt_sigma_deg=COLUMBIA_TILT_SIGMA_DEG,
            roll_sigma_deg=COLUMBIA_ROLL_SIGMA_DEG,
        )
        traced = {LABEL: trace_rows_px(photo["horizon_px"], image.shape[1])}
        dem = existing(folder / "dem_columbia_100m.tif")
        yield Standpoint("columbia", name, bundle, dem, None, crs, easting_m, northing_m, 1.0, traced)


def _aletsch(data_dir: Path, work_dir: Path) -> Standpoint:
    folder = existing(data_dir / "photos")
    paper = read_image(folder / "aletsch_1890s.jpg")
    p = ALETSCH_PAPER
    height_px, width_px = paper.shape[:2]
    if width_px < p["right"] or height_px < p["bottom"]:
        raise SimulationError(
            f"{folder / 'aletsch_1890s.jpg'}: {width_px} x {height_px} px; give the one of 1024 x 763"
        )
    image = np.ascontiguousarray(paper[p["top"] : p["bottom"], p["left"] : p["right"]])
    # the resection used the centre of the whole picture, border included, as principal point
    middle = principal_point_px((width_px, height_px), (0.0, 0.0))
    camera = _camera(image, (ALETSCH_FOCAL_PX,) * 2, cropped(middle, p["left"], p["top"]), (0.0,) * 5)
    crs = CRS.from_epsg(21781)
    bundle = write_bundle(
        work_dir / "aletsch",
        image,
        camera,
        altitude=Altitude(value_m=ALETSCH_ALTITUDE_M, sigma_m=ALETSCH_ALTITUDE_SIGMA_M),
        azimuth_deg=true_azimuth_deg(crs, *ALETSCH_LV03_M, ALETSCH_GRID_AZIMUTH_DEG),
        tilt_deg=ALETSCH_TILT_DEG,
        roll_deg=ALETSCH_ROLL_DEG,
        tilt_sigma_deg=ALETSCH_ANGLE_SIGMA_DEG,
        roll_sigma_deg=ALETSCH_ANGLE_SIGMA_DEG,
    )
    dem = existing(folder / "aletsch_aster_25m.tif")
    return Standpoint("aletsch", "aletsch_1890s", bundle, dem, 0.0, crs, *ALETSCH_LV03_M, 82.0, {})


def _rendered(data_dir: Path) -> Iterator[Standpoint]:
    for folder in rendered_folders(data_dir):
        truth = read_json(folder / "truth.json")
        dem = RENDERED_DEMS.get(folder.name[:2])
        if dem is None:
            raise SimulationError(
                f"{folder}: which DEM belongs to it? A name begins with {', '.join(RENDERED_DEMS)}"
            )
        place = truth["position"]
        yield Standpoint(
            "rendered",
            folder.name,
            existing(folder / "bundle"),
            existing(data_dir / "terrain" / dem),
            None,
            CRS.from_user_input(truth["crs"]),
            place["easting"],
            place["northing"],
            0.0,
            {label: np.asarray(frame["terrain_row"], float) for label, frame in truth["images"].items()},
        )


LABEL = "photo"
"""Label of the only frame of a photograph's bundle."""


def write_bundle(
    folder: Path,
    image: Image,
    camera: Camera,
    *,
    altitude: Altitude,
    azimuth_deg: float,
    tilt_deg: float,
    roll_deg: float,
    tilt_sigma_deg: float,
    roll_sigma_deg: float,
) -> Path:
    """A bundle of one photograph, without heading information; the search adds its own."""
    (folder / "frames").mkdir(parents=True)
    file = f"frames/{LABEL}.png"
    encoded, png = cv2.imencode(".png", image)
    if not encoded:
        raise SimulationError(f"{folder / file}: the picture cannot be encoded")
    (folder / file).write_bytes(png.tobytes())
    frame = Frame(
        label=LABEL,
        file=file,
        sha256=hashlib.sha256(png.tobytes()).hexdigest(),
        time=UNKNOWN_TIME,
        azimuth_deg=azimuth_deg,
        azimuth_sigma_deg=0.0,
        tilt_deg=tilt_deg,
        tilt_sigma_deg=tilt_sigma_deg,
        roll_deg=roll_deg,
        roll_sigma_deg=roll_sigma_deg,
    )
    bundle = Bundle(
        id=folder.name,
        created=UNKNOWN_TIME,
        camera=camera,
        mast_height_m=MAST_HEIGHT_M,
        altitude=altitude,
        azimuth_bias_sigma_deg=180.0,
        tilt_bias_sigma_deg=0.0,
        frames=(frame,),
    )
    (folder / "bundle.json").write_text(bundle.to_json(), encoding="utf-8")
    return folder


def _camera(
    image: Image, focal_px: Sequence[float], principal_point: tuple[float, float], distortion: Any
) -> Camera:
    return Camera(
        width_px=image.shape[1],
        height_px=image.shape[0],
        fx_px=focal_px[0],
        fy_px=focal_px[1],
        cx_px=principal_point[0],
        cy_px=principal_point[1],
        distortion=distortion,
    )
