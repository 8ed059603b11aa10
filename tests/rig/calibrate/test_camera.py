"""Intrinsics from views of a calibration target; too few, one-sided or blurred ones are rejected with the reason."""

import cv2
import numpy as np
import pytest

from rig.calibrate.camera.fit import coverage, fit_camera
from rig.calibrate.camera.procedure import is_new, is_still, progress
from rig.calibrate.camera.target import TargetView, charuco_board, parse_target
from rig.config.calibration_files import CalibrationError

SIZE = (640, 480)
TRUTH = {"fx_px": 501.0, "fy_px": 499.0, "cx_px": 324.0, "cy_px": 236.0, "k1": -0.09, "k2": 0.02}
GRID_MM = np.array([[x * 30.0, y * 30.0, 0.0] for y in range(6) for x in range(8)])


def views(count: int, noise_px: float = 0.1, tilt: float = 0.6, spread: float = 0.42) -> list[TargetView]:
    rng = np.random.default_rng(3)
    matrix = np.array([[TRUTH["fx_px"], 0, TRUTH["cx_px"]], [0, TRUTH["fy_px"], TRUTH["cy_px"]], [0, 0, 1.0]])
    lens = np.array([TRUTH["k1"], TRUTH["k2"], 0.0, 0.0, 0.0])
    found = []
    while len(found) < count:
        turn = rng.uniform(-tilt, tilt, 3) * [1.0, 1.0, 0.4]
        z = rng.uniform(300.0, 600.0)
        middle = rng.uniform(-spread, spread, 2) * [1.3, 0.95] * z
        shift = np.array([*middle, z]) - cv2.Rodrigues(turn)[0] @ [105.0, 75.0, 0.0]
        pixels = cv2.projectPoints(GRID_MM, turn, shift, matrix, lens)[0].reshape(-1, 2)
        pixels += rng.normal(0.0, noise_px, pixels.shape)
        inside = ((pixels >= 0) & (pixels < SIZE)).all(axis=1)
        if inside.sum() >= 12:
            ids = np.nonzero(inside)[0]
            found.append(TargetView(str(len(found)), ids, GRID_MM[inside], pixels[inside]))
    return found


def test_the_lens_is_found_within_its_sigmas() -> None:
    fit = fit_camera(views(25), SIZE)
    for name, true in TRUTH.items():
        assert abs(fit.values[name] - true) < 4.0 * fit.sigmas[name], name
    assert fit.sigmas["fx_px"] < 1.0
    assert fit.rms_px == pytest.approx(0.14, abs=0.03)


@pytest.mark.parametrize(
    ("shown", "reason"),
    [
        (views(6), "found in 6 pictures only"),
        (views(15, spread=0.05), "of the picture"),
        (views(25, noise_px=2.0), "px rms are left"),
    ],
)
def test_views_that_tell_too_little_are_refused(shown: list[TargetView], reason: str) -> None:
    with pytest.raises(CalibrationError, match=reason):
        fit_camera(shown, SIZE)


def test_a_target_never_tilted_is_refused() -> None:
    with pytest.raises(CalibrationError, match="camera: "):
        fit_camera(views(25, noise_px=0.4, tilt=0.01), SIZE)


def test_a_printed_target_is_found_where_it_is() -> None:
    picture = np.asarray(charuco_board(9, 7, 30.0, 22.0).generateImage((540, 420)))
    image = cv2.cvtColor(
        cv2.copyMakeBorder(picture, 30, 30, 50, 50, cv2.BORDER_CONSTANT, value=255), cv2.COLOR_GRAY2BGR
    )
    view = parse_target("charuco:9x7:30:22").find("board", np.asarray(image, np.uint8))
    assert view is not None
    assert len(view.ids) == 8 * 6
    assert view.image_px[0] == pytest.approx([50 + 60 - 0.5, 30 + 60 - 0.5], abs=0.7)


@pytest.mark.parametrize("text", ["charuco:9x7:30", "chess:9x6:25", "chessboard:9:25", "chessboard:2x6:25"])
def test_an_invalid_description_of_a_target(text: str) -> None:
    with pytest.raises(ValueError, match="board"):
        parse_target(text)


def test_only_a_still_target_in_a_new_position_is_taken() -> None:
    one, other = views(2)
    assert is_still(one, one)
    assert not is_new(one, [one], SIZE[0])
    assert not is_still(one, other)
    assert is_new(other, [one], SIZE[0])


def test_the_coverage_is_shown() -> None:
    shown = views(25)
    lines = progress(shown, SIZE, 25).splitlines()
    assert lines[0].startswith("view 25 of 25")
    assert len(lines) == 7
    assert coverage(shown, SIZE) > 0.9
