"""What a fit of the boresight must satisfy to be believed: each limit from both sides."""

from dataclasses import replace

import numpy as np
import pytest

from rig.attitude.kinematics import Attitude
from rig.calibrate.boresight.dem_error_model import covariance_deg2, fit_dem_error_model
from rig.calibrate.boresight.fit import BoresightFit, _require_place, _require_skyline
from rig.calibrate.boresight.known_place import PlaceSigmas
from rig.calibrate.boresight.skyline_frame import SkylineFrame
from rig.config.calibration_files import CalibrationError

PLACE = PlaceSigmas(horizontal_m=4.0, altitude_m=1.5, dem_m=2.0)
LEVEL = Attitude(0.0, 0.0, 0.0)
GOOD = BoresightFit(
    LEVEL,
    0.0,
    np.diag([0.03, 0.02, 0.02]) ** 2,
    off_m=(1.0, 1.0, 0.5),
    misfit_deg=0.05,
    misfit_sigmas=0.9,
    dem_factor=1.0,
    frame=np.zeros(0, np.int64),
    azimuth_deg=np.zeros(0),
    elevation_deg=np.zeros(0),
    residual_deg=np.zeros(0),
)


@pytest.mark.parametrize(
    ("allowed", "refused", "reason"),
    [
        # Four sigmas of 4 m; the length in the plane counts, whatever the altitude.
        (
            {"off_m": (15.9, 0.0, 9.0)},
            {"off_m": (-16.1, 0.0, 0.0)},
            r"fits better 16 m away \(east -16, north 0\)",
        ),
        ({"off_m": (9.6, -12.7, 0.0)}, {"off_m": (9.6, -12.9, 0.0)}, r"16 m away \(east 10, north -13\)"),
        (
            {"misfit_deg": 0.19, "misfit_sigmas": 1.1},
            {"misfit_deg": 0.21, "misfit_sigmas": 1.1},
            r"is 0\.21 deg",
        ),
        (
            {"misfit_deg": 5.0, "misfit_sigmas": 0.9},
            {"misfit_deg": 5.0, "misfit_sigmas": 1.1},
            r"\(1\.1 sigma\)",
        ),
        ({"misfit_sigmas": 2.9}, {"misfit_sigmas": 3.1}, r"\(3\.1 sigma\) off the DEM's at that place"),
        (
            {"dem_factor": 4.9},
            {"dem_factor": 5.1},
            r"as if its ridges were 10\.2 m off: this is another place",
        ),
        (
            {"covariance_deg2": np.diag([0.3, 0.049, 0.3]) ** 2},
            {"covariance_deg2": np.diag([0.03, 0.051, 0.02]) ** 2},
            r"leaves the tilt uncertain by 0\.05 deg",
        ),
    ],
)
def test_a_fit_is_believed_up_to_its_limits(
    allowed: dict[str, object], refused: dict[str, object], reason: str
) -> None:
    _require_place(replace(GOOD, **allowed), PLACE)  # type: ignore[arg-type]
    with pytest.raises(CalibrationError, match=reason):
        _require_place(replace(GOOD, **refused), PLACE)  # type: ignore[arg-type]


def frame(share: float) -> SkylineFrame:
    return SkylineFrame("N", LEVEL, np.zeros((0, 3)), np.zeros(0), share, 0.1, 0.01, 0)


def test_three_frames_must_show_a_skyline_in_a_quarter_of_their_columns() -> None:
    _require_skyline([frame(0.25), frame(0.25), frame(0.25), frame(0.0)])
    with pytest.raises(CalibrationError, match=r"shows in 2 of 4 frames only \(N 25%, N 25%, N 24%, N 0% of"):
        _require_skyline([frame(0.25), frame(0.25), frame(0.24), frame(0.0)])


def test_the_dems_error_is_alike_along_a_ridge_and_in_part_between_ridges_equally_far() -> None:
    """Three quarters fall off with exp(-d / 60 m), a quarter with the logarithm of the ratio of distances."""
    sigma_deg = np.array([0.1, 0.2, 0.1, 0.1])
    azimuth_deg = np.array([0.0, 60.0 / 3000.0 * 180.0 / np.pi, 180.0, 0.0])  # 60 m aside; behind
    found = covariance_deg2(sigma_deg, azimuth_deg, np.array([3000.0, 3000.0, 3000.0, 6000.0]))
    assert np.diag(found) == pytest.approx(sigma_deg**2)
    assert found == pytest.approx(found.T)
    assert found[0, 1] == pytest.approx(0.02 * (0.75 * np.exp(-1.0) + 0.25), rel=1e-4)
    assert found[0, 2] == pytest.approx(0.01 * 0.25, rel=1e-6), "the same distance, another ridge"
    assert found[0, 3] == pytest.approx(0.01 * 0.25 * 2.0 ** (-1 / 0.7), rel=1e-6), "twice as far"


@pytest.mark.parametrize("factor", [0.5, 1.0, 3.0])
def test_how_much_the_dem_errs_is_found_from_the_residuals(factor: float) -> None:
    """Of the factors 1.5^n that are tried the nearest or its neighbour, over forty draws their geometric mean."""
    rng = np.random.default_rng(2)
    azimuth_deg = np.arange(0.0, 360.0, 3.0)
    dem_deg, image_deg = np.full(120, 0.1), np.full(120, 0.02)
    stated = covariance_deg2(dem_deg, azimuth_deg, np.full(120, 3000.0))
    root = np.linalg.cholesky(stated * factor**2 + np.diag(image_deg**2))
    found = [
        fit_dem_error_model(root @ rng.normal(0.0, 1.0, 120), image_deg, dem_deg, stated).dem_factor
        for _ in range(40)
    ]
    assert np.exp(np.mean(np.log(found))) == pytest.approx(factor, rel=0.15)


def test_whitened_residuals_are_independent_and_of_unit_variance() -> None:
    """Against the inverse of the dense covariance."""
    azimuth_deg = np.linspace(0.0, 40.0, 40)
    dem_deg, image_deg = np.linspace(0.05, 0.2, 40), np.full(40, 0.03)
    stated = covariance_deg2(dem_deg, azimuth_deg, np.linspace(1000.0, 4000.0, 40))
    residual_deg = np.linalg.cholesky(stated + np.diag(image_deg**2)) @ np.random.default_rng(7).normal(
        size=40
    )
    found = fit_dem_error_model(residual_deg, image_deg, dem_deg, stated)
    spread = 1.4826 * np.median(np.abs(residual_deg / np.hypot(image_deg, dem_deg)))
    distrust = np.maximum(np.abs(residual_deg / np.hypot(image_deg, dem_deg)) / (1.5 * spread), 1.0) ** 2
    dense = stated * found.dem_factor**2 + np.diag((image_deg * distrust) ** 2)
    assert found.whiten @ dense @ found.whiten.T == pytest.approx(np.eye(40), abs=1e-8)
