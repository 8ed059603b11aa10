"""What several tests of the localizer start from: a small elevation file, a small bundle, the command."""

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import rasterio
from affine import Affine

from localizer.bundle import Bundle, Camera, Frame, sha256_of
from localizer.commands import cli

SANTA_CRUZ = Path(__file__).parents[2] / "sim" / "terrain" / "santa_cruz_srtm_1s.tif"

UTM_TRANSFORM = Affine(30.0, 0.0, 560_000.0, 0.0, -30.0, 5_120_000.0)


@pytest.fixture
def santa_cruz_file() -> Path:
    """The terrain that ships with the project."""
    return SANTA_CRUZ


@pytest.fixture
def write_raster(tmp_path: Path) -> Callable[..., Path]:
    """Writes a GeoTIFF of the values given, in UTM zone 10 unless told otherwise."""

    def write(
        z: Any,
        name: str = "dem.tif",
        *,
        crs: Any = "EPSG:32610",
        transform: Affine = UTM_TRANSFORM,
        unit: str | None = None,
        scale: float = 1.0,
        offset: float = 0.0,
        point: bool = False,
        bands: int = 1,
        **profile: Any,
    ) -> Path:
        z = np.asarray(z)
        path = tmp_path / name
        with rasterio.open(
            path,
            "w",
            driver="GTiff",
            height=z.shape[0],
            width=z.shape[1],
            count=bands,
            dtype=z.dtype,
            crs=crs,
            transform=transform,
            **profile,
        ) as dataset:
            for band in range(1, bands + 1):
                dataset.write(z, band)
            if point:
                dataset.update_tags(AREA_OR_POINT="Point")
            if unit:
                dataset.set_band_unit(1, unit)
            dataset.scales, dataset.offsets = [scale] * bands, [offset] * bands
        return path

    return write


@pytest.fixture
def ramp() -> np.ndarray:
    """Elevations (6, 5) that differ in every cell: 100 row + col."""
    return np.add.outer(100 * np.arange(6), np.arange(5)).astype(np.int16)


@pytest.fixture
def bundle_dir(tmp_path: Path) -> Path:
    """A sound bundle of two small frames, with raw readings that no reader knows."""
    directory = tmp_path / "20261123T043151Z-3f9a"
    (directory / "frames").mkdir(parents=True)
    frames = []
    for azimuth_deg, label in ((0.12, "N"), (90.3, "E")):
        file = directory / "frames" / f"{label}.png"
        cv2.imwrite(str(file), np.full((12, 16, 3), int(azimuth_deg) + 50, np.uint8))
        frames.append(
            Frame(
                label=label,
                file=f"frames/{label}.png",
                sha256=sha256_of(file),
                time="2026-11-23T04:31:40Z",
                azimuth_deg=azimuth_deg,
                azimuth_sigma_deg=0.1,
                tilt_deg=4.98,
                tilt_sigma_deg=0.01,
                roll_deg=-0.31,
                roll_sigma_deg=0.02,
                raw={"pan_ticks": 2048, "accelerometer_g": [0.0, 0.087, 0.996]},
            )
        )
    bundle = Bundle(
        id=directory.name,
        created="2026-11-23T04:31:51Z",
        camera=Camera(width_px=16, height_px=12, fx_px=12.3, fy_px=12.3, cx_px=7.5, cy_px=5.5),
        mast_height_m=2.0,
        altitude={"value_m": 1432.6, "sigma_m": 5.0},
        azimuth_bias_sigma_deg=0.5,
        tilt_bias_sigma_deg=0.02,
        frames=frames,
        calibration={"zero_tick": 2048},
    )
    (directory / "bundle.json").write_text(bundle.to_json())
    return directory


@pytest.fixture
def edit_bundle(bundle_dir: Path) -> Callable[[Callable[[dict[str, Any]], object]], Path]:
    """Changes the bundle's JSON in place and returns its directory."""

    def edit(change: Callable[[dict[str, Any]], object]) -> Path:
        file = bundle_dir / "bundle.json"
        fields = json.loads(file.read_text())
        change(fields)
        file.write_text(json.dumps(fields))
        return bundle_dir

    return edit


@pytest.fixture
def run(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> Callable[..., tuple[Any, str, str]]:
    """Runs ``localizer`` with arguments: exit status, standard output, standard error."""

    def run(*arguments: object) -> tuple[Any, str, str]:
        monkeypatch.setattr(sys, "argv", ["localizer", *map(str, arguments)])
        with pytest.raises(SystemExit) as end:
            cli.main()
        return end.value.code, *capfd.readouterr()

    return run


@pytest.fixture
def refused(run: Callable[..., tuple[Any, str, str]]) -> Callable[..., str]:
    """Runs ``localizer`` with bad input and returns the one line that it says."""

    def refused(*arguments: object) -> str:
        status, out, err = run(*arguments)
        assert status == 2
        assert out == ""
        assert err.count("\n") == 1
        assert err.startswith("localizer")
        assert "Traceback" not in err
        return err

    return refused
