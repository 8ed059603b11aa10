"""Bundles, answers and a daemon state, without a rig and without a search."""

from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from localizer.bundle import Altitude, Bundle, Camera, Frame, sha256_of
from localizer.fix import Candidate, Fix, Nuisance, Position, Stage1Counts, Status
from rig.clock import Instant
from rig.daemon.state import Answer, TriggerAnswer, TriggerSource

WIDTH_PX, HEIGHT_PX = 64, 48


def write_bundle(folder: Path, bundle_id: str) -> Path:
    """A sound bundle of four small frames below ``folder``."""
    directory = folder / bundle_id
    (directory / "frames").mkdir(parents=True)
    frames = []
    for azimuth_deg, label in enumerate("NESW"):
        file = directory / "frames" / f"{label}.png"
        cv2.imwrite(str(file), np.full((HEIGHT_PX, WIDTH_PX, 3), 60 + 40 * azimuth_deg, np.uint8))
        frames.append(
            Frame(
                label=label,
                file=f"frames/{label}.png",
                sha256=sha256_of(file),
                time="2026-11-23T04:31:40Z",
                azimuth_deg=90.0 * azimuth_deg,
                azimuth_sigma_deg=0.1,
                tilt_deg=5.0,
                tilt_sigma_deg=0.01,
                roll_deg=0.0,
                roll_sigma_deg=0.02,
            )
        )
    bundle = Bundle(
        id=bundle_id,
        created="2026-11-23T04:31:51Z",
        camera=Camera(width_px=WIDTH_PX, height_px=HEIGHT_PX, fx_px=50.0, fy_px=50.0, cx_px=31.5, cy_px=23.5),
        mast_height_m=2.0,
        altitude=Altitude(value_m=432.6, sigma_m=5.0),
        azimuth_bias_sigma_deg=0.5,
        tilt_bias_sigma_deg=0.02,
        frames=tuple(frames),
    )
    (directory / "bundle.json").write_text(bundle.to_json())
    return directory


def fix_of(bundle_id: str, status: Status = "fix", east_m: float = 0.0) -> Fix:
    """A place in the terrain that ships, or several, or none."""
    counts = Stage1Counts(cells=640_000, after_altitude=9000, after={"N": 40, "E": 3}, points_explored=90_000)
    if status == "none":
        return Fix(
            bundle=bundle_id,
            status="none",
            position=None,
            covariance_m2=None,
            probability=0.0,
            candidates=(),
            stage1=counts,
            residual={},
            nuisance=None,
            timing_s={"stage1": 0.1},
        )
    shares = (0.998,) if status == "fix" else (0.61, 0.3, 0.05)
    places = [
        Candidate(
            easting_m=574_000.0 + east_m + 2500.0 * i,
            northing_m=4_120_000.0,
            probability=share,
            rms_px=0.8,
        )
        for i, share in enumerate(shares)
    ]
    return Fix(
        bundle=bundle_id,
        status=status,
        position=Position(
            easting_m=places[0].easting_m,
            northing_m=places[0].northing_m,
            crs="EPSG:32610",
            lat_deg=37.22,
            lon_deg=-122.17,
            ground_m=430.0,
            row=440.0,
            col=320.0,
        ),
        covariance_m2=((30.0, 8.0), (8.0, 16.0)),
        probability=shares[0],
        candidates=tuple(places),
        stage1=counts,
        residual=dict.fromkeys("NESW", 0.8),
        nuisance=Nuisance(azimuth_bias_deg=0.3, tilt_bias_deg=0.01, altitude_bias_m=1.5),
        timing_s={"stage1": 0.1, "refine": 0.4},
    )


def ago(seconds: float) -> Instant:
    """That long before this moment, on both clocks."""
    now = Instant.now()
    return Instant(now.monotonic_s - seconds, now.utc - timedelta(seconds=seconds))


def answer_of(bundle_id: str, status: Status = "fix", age_s: float = 1.0, east_m: float = 0.0) -> Answer:
    """An answer to a bundle that was captured so long ago."""
    placed = status != "none"
    return Answer(
        bundle=bundle_id,
        captured=ago(age_s),
        answered=ago(0.5 * age_s),
        trigger="interval",
        fix=fix_of(bundle_id, status, east_m),
        mode="whole DEM",
        hypotheses=(),
        elsewhere=0.002,
        altitude_m=432.0 if placed else None,
        vehicle_heading_deg=41.5 if placed else None,
        vehicle_heading_sigma_deg=0.6 if placed else None,
    )


def bundle_id(number: int) -> str:
    """Ids in the order of their numbers."""
    return f"{datetime(2026, 11, 23, tzinfo=UTC) + timedelta(minutes=number):%Y%m%dT%H%M%SZ}-3f9a"


@dataclass
class ScriptedActions:
    """Answers triggers with a given answer, and records them."""

    answer: TriggerAnswer = "started"
    asked: list[TriggerSource] = field(default_factory=list)

    def trigger(self, source: TriggerSource) -> TriggerAnswer:
        self.asked.append(source)
        return self.answer


def json_of(response: Any) -> Any:
    """A response's JSON, once it is known to have succeeded."""
    assert response.status_code == 200, response.text
    return response.json()
