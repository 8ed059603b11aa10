"""Intrinsics from views of a calibration target; too few, one-sided or blurred ones are rejected with the reason."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from rig.calibrate.camera.fit import (
    CameraFit,
    _require_plausible,
    _require_views,
    coverage,
    coverage_grid,
    fit_camera,
)
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


@pytest.mark.parametrize(("noise_px", "tilt"), [(0.4, 0.01), (0.1, 0.02), (0.05, 0.02), (0.02, 0.001)])
def test_a_target_never_tilted_is_refused(noise_px: float, tilt: float) -> None:
    """Then a longer lens further away shows the same; quiet corners do not help."""
    with pytest.raises(CalibrationError, match=r"the focal length is known to \d+\.\d% only; tilt the board"):
        fit_camera(views(25, noise_px=noise_px, tilt=tilt), SIZE)


def test_the_sigmas_of_well_tilted_views_are_those_of_opencv() -> None:
    shown = views(25)
    fit = fit_camera(shown, SIZE)
    corners_mm = [view.target_mm.astype(np.float32) for view in shown]
    images = [view.image_px.astype(np.float32) for view in shown]
    found = cv2.calibrateCameraExtended(
        corners_mm, images, SIZE, np.eye(3), np.zeros(5), flags=cv2.CALIB_FIX_K3
    )
    assert list(fit.sigmas.values()) == pytest.approx(np.asarray(found[5]).ravel()[:9], rel=0.01)


CREDIBLE = CameraFit(
    {"fx_px": 500.0, "fy_px": 500.0, "cx_px": 319.5, "cy_px": 239.5}
    | dict.fromkeys(("k1", "k2", "p1", "p2", "k3"), 0.0),
    dict.fromkeys(("fx_px", "fy_px", "cx_px", "cy_px", "k1", "k2", "p1", "p2", "k3"), 0.01),
    rms_px=0.3,
    views=20,
    dropped=(),
    coverage=0.9,
    corners_px=np.zeros((0, 2)),
    residuals_px=np.zeros((0, 2)),
)


@pytest.mark.parametrize(
    ("allowed", "refused", "reason"),
    [
        ({"fx_px": 511.0}, {"fx_px": 519.0}, r"pixels of 1\.04 : 1 are not square"),
        ({"fx_px": 489.0}, {"fx_px": 481.0}, r"pixels of 0\.96 : 1 are not square"),
        # 2 atan(320 / 90) = 148.6 deg, 2 atan(320 / 80) = 151.9 deg; 5.2 deg and 4.6 deg.
        (
            {"fx_px": 90.0, "fy_px": 90.0},
            {"fx_px": 80.0, "fy_px": 80.0},
            r"a view of 152 deg is no real lens",
        ),
        (
            {"fx_px": 7000.0, "fy_px": 7000.0},
            {"fx_px": 8000.0, "fy_px": 8000.0},
            "a view of 5 deg is no real",
        ),
        # 15 % of 640 and 480 px: 96 and 72.
        ({"cx_px": 319.5 + 95.0}, {"cx_px": 319.5 + 97.0}, "cx_px 416 lies far from the middle of 640 px"),
        ({"cy_px": 239.5 - 71.0}, {"cy_px": 239.5 - 73.0}, "cy_px 166 lies far from the middle of 480 px"),
    ],
)
def test_a_lens_is_credible_up_to_its_limits(
    allowed: dict[str, float], refused: dict[str, float], reason: str
) -> None:
    _require_plausible(replace(CREDIBLE, values=CREDIBLE.values | allowed), SIZE)
    with pytest.raises(CalibrationError, match=reason):
        _require_plausible(replace(CREDIBLE, values=CREDIBLE.values | refused), SIZE)


@pytest.mark.parametrize(
    ("allowed", "refused"),
    [
        # The corner lies at r = hypot(319.5, 239.5) / 500 = 0.7986. r (1 + k1 r^2) grows while 1 + 3 k1 r^2 > 0: to
        # k1 = -0.5226; likewise r (1 + k2 r^4) to k2 = -1 / (5 r^4) = -0.4917 and k3 to -1 / (7 r^6) = -0.5507.
        ({"k1": -0.51}, {"k1": -0.54}),
        ({"k2": -0.48}, {"k2": -0.51}),
        ({"k3": -0.54}, {"k3": -0.57}),
        # A centre that lies aside makes another corner the farthest: (0, 0) at 0.9170, where k1 may be -0.3964.
        ({"k1": -0.38, "cx_px": 384.5, "cy_px": 250.5}, {"k1": -0.41, "cx_px": 384.5, "cy_px": 250.5}),
        # It folds in the middle of the picture and grows again before the corner: 1 - 9 r^2 + 17.5 r^4.
        ({"k1": 3.0, "k2": 3.5}, {"k1": -3.0, "k2": 3.5}),
    ],
)
def test_a_distortion_that_folds_the_picture_is_refused(
    allowed: dict[str, float], refused: dict[str, float]
) -> None:
    _require_plausible(replace(CREDIBLE, values=CREDIBLE.values | allowed), SIZE)
    with pytest.raises(CalibrationError, match="its distortion folds the picture over before the corners"):
        _require_plausible(replace(CREDIBLE, values=CREDIBLE.values | refused), SIZE)


def test_residuals_and_the_focal_lengths_sigma_have_their_limits() -> None:
    _require_plausible(replace(CREDIBLE, rms_px=0.69), SIZE)
    with pytest.raises(CalibrationError, match=r"0\.71 px rms are left, 0\.7 are allowed"):
        _require_plausible(replace(CREDIBLE, rms_px=0.71), SIZE)
    _require_plausible(replace(CREDIBLE, sigmas=CREDIBLE.sigmas | {"fx_px": 1.45}), SIZE)
    with pytest.raises(CalibrationError, match=r"the focal length is known to 0\.3% only"):
        _require_plausible(replace(CREDIBLE, sigmas=CREDIBLE.sigmas | {"fx_px": 1.55}), SIZE)


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


def corners(*at_px: tuple[float, float], name: str = "view") -> TargetView:
    return TargetView(name, np.arange(len(at_px)), np.zeros((len(at_px), 3)), np.array(at_px))


def test_a_corner_counts_in_the_cell_of_its_pixel() -> None:
    """640 x 480 in 8 columns and 6 rows of 80 px; pixel 79 is the last of the first cell, its middle at 79.0."""
    counts = coverage_grid([corners((79.4, 79.4), (79.6, 0.0)), corners((639.4, 479.4), (-0.4, 240.0))], SIZE)
    assert counts.shape == (6, 8)
    found = {(int(r), int(c)): int(counts[r, c]) for r, c in zip(*np.nonzero(counts), strict=True)}
    assert found == {(0, 0): 1, (0, 1): 1, (5, 7): 1, (3, 0): 1}
    assert coverage([corners((0.0, 0.0), (1.0, 1.0), (639.0, 479.0))], SIZE) == pytest.approx(2 / 48)


def missing(columns: slice, rows: slice) -> list[TargetView]:
    """Ten views with a corner in the middle of each cell but those."""
    cells = np.ones((6, 8), bool)
    cells[rows, columns] = False
    at = [(80.0 * c + 39.5, 80.0 * r + 39.5) for r, c in zip(*np.nonzero(cells), strict=True)]
    return [corners(*at, name=str(i)) for i in range(10)]


@pytest.mark.parametrize(
    ("shown", "said"),
    [
        (
            missing(slice(0, 4), slice(0, 4)),
            "covered 67% of the picture, 75% are needed.* most of all the upper left",
        ),
        (missing(slice(4, 8), slice(0, 4)), "the upper right"),
        (missing(slice(4, 8), slice(2, 6)), "the lower right"),
        (missing(slice(0, 4), slice(2, 6)), "the lower left"),
        (missing(slice(0, 0), slice(0, 0))[:9], "found in 9 pictures only; take 10 or more"),
    ],
)
def test_what_the_board_did_not_cover_is_said(shown: list[TargetView], said: str) -> None:
    with pytest.raises(CalibrationError, match=said):
        _require_views(shown, SIZE)


def test_three_quarters_of_the_picture_in_ten_views_are_enough() -> None:
    _require_views(missing(slice(0, 2), slice(0, 6)), SIZE)


def test_two_blurred_views_of_twenty_five_are_left_out() -> None:
    """Their corners are off by 2 px, the others' by 0.1."""
    shown = views(25)
    rng = np.random.default_rng(4)
    for i in (3, 11):
        blurred = shown[i].image_px + rng.normal(0.0, 2.0, shown[i].image_px.shape)
        shown[i] = replace(shown[i], image_px=blurred)
    fit = fit_camera(shown, SIZE)
    assert fit.dropped == ("3", "11")
    assert fit.views == 23
    assert fit.rms_px == pytest.approx(0.14, abs=0.03)
    assert (
        len(fit.corners_px)
        == len(fit.residuals_px)
        == sum(len(v.ids) for v in shown) - sum(len(shown[i].ids) for i in (3, 11))
    )


def test_the_coverage_is_shown() -> None:
    shown = views(25)
    lines = progress(shown, SIZE, 25).splitlines()
    assert lines[0].startswith("view 25 of 25")
    assert len(lines) == 7
    assert coverage(shown, SIZE) > 0.9
