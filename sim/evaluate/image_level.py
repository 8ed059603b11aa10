"""Cases with pictures: a case's world is rendered and written as a bundle."""

import hashlib
from datetime import UTC, datetime
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from localizer import Altitude, Bundle, Camera, Frame, load_bundle
from sim.errors import SimulationError
from sim.evaluate.scenario import EvaluationScenario
from sim.evaluate.truth import TrueFrame, Truth
from sim.render.panorama import render_panorama
from sim.render.renderer import Renderer
from sim.world.scenario import Scenario
from sim.world.scenario import Vehicle as RigVehicle
from sim.world.truth import World

CREATED = datetime(2026, 11, 24, 12, 0, 0, tzinfo=UTC)
CONTOUR_ONLY = ("foreground", "occlusion", "cloud")


def refuse_contour_faults(scenario: EvaluationScenario) -> None:
    """Raise SimulationError for faults that exist at contour level only."""
    present = [name for name in CONTOUR_ONLY if getattr(scenario, name) is not None]
    if present:
        raise SimulationError(
            f"[{present[0]}] is not rendered; take --level contour, or a scenario without it"
        )


def write_pictures(truth: Truth, scenario: EvaluationScenario, seed: int, folder: Path) -> Bundle:
    """Render all frames and write the bundle of an ideal rig; ``seed`` draws weather and ground."""
    conditions = Scenario(
        place=scenario.place,
        vehicle=RigVehicle(mast_height_m=scenario.vehicle.mast_height_m),
        weather=scenario.weather,
        camera=scenario.camera,
    )
    world = World.around(truth.surface, truth.observer, conditions, seed)
    renderer = Renderer(world, render_panorama(world))
    noise = world.rng("camera")
    (folder / "frames").mkdir(parents=True)
    frames = [
        _write_frame(folder, frame, renderer.frame(frame.rotation, noise), scenario) for frame in truth.frames
    ]
    assumed, optics = scenario.assumed_sigma, scenario.camera
    altitude = None
    if truth.measured_altitude_m is not None:
        altitude = Altitude(value_m=truth.measured_altitude_m, sigma_m=assumed("altitude_sigma_m"))
    bundle = Bundle(
        id=folder.name,
        created=CREATED,
        camera=Camera(
            width_px=optics.width_px,
            height_px=optics.height_px,
            fx_px=optics.fx_px,
            fy_px=optics.fy_px,
            cx_px=optics.cx_px,
            cy_px=optics.cy_px,
            distortion=optics.distortion,
        ),
        mast_height_m=scenario.vehicle.mast_height_m,
        altitude=altitude,
        azimuth_bias_sigma_deg=assumed("azimuth_bias_sigma_deg"),
        tilt_bias_sigma_deg=assumed("tilt_bias_sigma_deg"),
        frames=tuple(frames),
    )
    (folder / "bundle.json").write_text(bundle.to_json(), encoding="utf-8")
    return load_bundle(folder)


def _write_frame(
    folder: Path, frame: TrueFrame, picture: NDArray[np.uint8], scenario: EvaluationScenario
) -> Frame:
    """The camera sends JPEG; the bundle holds PNG."""
    quality = [cv2.IMWRITE_JPEG_QUALITY, scenario.camera.jpeg_quality]
    sent = cv2.imdecode(cv2.imencode(".jpg", picture, quality)[1], cv2.IMREAD_COLOR)
    if sent is None:
        raise SimulationError("OpenCV cannot read the JPEG that it wrote; reinstall it")
    name = f"frames/{frame.label}.png"
    content = cv2.imencode(".png", sent)[1].tobytes()
    (folder / name).write_bytes(content)
    assumed = scenario.assumed_sigma
    return Frame(
        label=frame.label,
        file=name,
        sha256=hashlib.sha256(content).hexdigest(),
        time=CREATED,
        azimuth_deg=frame.measured.heading_deg,
        azimuth_sigma_deg=assumed("azimuth_sigma_deg"),
        tilt_deg=frame.measured.pitch_deg,
        tilt_sigma_deg=assumed("tilt_sigma_deg"),
        roll_deg=frame.measured.roll_deg,
        roll_sigma_deg=assumed("roll_sigma_deg"),
    )
