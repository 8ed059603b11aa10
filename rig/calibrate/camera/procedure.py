"""Camera calibration: collect views of a calibration target, live or from files, fit, show."""

import glob
import struct
import warnings
from collections.abc import Sequence

import cv2
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from rig import timebase
from rig.calibrate.camera.fit import MIN_COVERAGE, NAMES, CameraFit, coverage, coverage_grid, fit_camera
from rig.calibrate.camera.target import CalibrationTarget, TargetView
from rig.calibrate.figures import new_figure
from rig.calibrate.guide import Guide
from rig.calibrate.run import CalibrationRun
from rig.config.calibration_files import CalibrationError, CameraCalibration
from rig.devices.camera.driver import Camera

STILL_PX = 0.5
NEW_SHARE = 0.05  # of the width: least movement of the corners from any other view
IDLE_TIMEOUT_S = 60.0


def calibrate_camera(
    run: CalibrationRun, target: CalibrationTarget, images: str | None, views_wanted: int
) -> None:
    """Guide the operator, collect views, fit and write. ``CalibrationError`` says why a result is rejected."""
    section = run.config.camera
    size_px = (section.width_px, section.height_px)
    if images is not None:
        views, device = views_from_files(target, images, size_px), images
    else:
        run.guide.ready(
            f"Hold the board {target.text} before the camera, then move it: near and far, to all edges and corners, tilted by "
            "30 deg and more to all sides, and keep it still for a moment each time."
        )
        with Camera(section) as camera:
            camera.wait_open()
            device = camera.identify()
            views = views_from_camera(camera, target, size_px, views_wanted, run.guide)
    fit = fit_camera(views, size_px)
    value = fit.values
    document = CameraCalibration(
        **run.header("camera", device),
        width_px=section.width_px,
        height_px=section.height_px,
        fx_px=value["fx_px"],
        fy_px=value["fy_px"],
        cx_px=value["cx_px"],
        cy_px=value["cy_px"],
        distortion=(value["k1"], value["k2"], value["p1"], value["p2"], value["k3"]),
        sigma=fit.sigmas,
        fit={
            "views": fit.views,
            "corners": len(fit.corners_px),
            "rms_px": fit.rms_px,
            "coverage": fit.coverage,
            "board": target.text,
            "dropped": ", ".join(fit.dropped),
        },
    )
    rows = [(name, f"{value[name]:.5g}", f"{fit.sigmas[name]:.2g}") for name in NAMES]
    rows.append(
        ("residual rms, px", f"{fit.rms_px:.3f}", f"{len(fit.corners_px)} corners in {fit.views} views")
    )
    rows.append(("coverage", f"{fit.coverage:.0%}", f"left out: {len(fit.dropped)} views"))
    run.finish(document, rows, draw(fit, size_px))


def views_from_files(target: CalibrationTarget, pattern: str, size_px: tuple[int, int]) -> list[TargetView]:
    """The views in the pictures of a glob pattern. ``CalibrationError`` if there are none, or of another size."""
    paths = sorted(glob.glob(pattern, recursive=True))  # noqa: PTH207 - a pattern may be absolute
    if not paths:
        raise CalibrationError(f"--images {pattern}: names no file; check the folder, and quote the pattern")
    views = []
    for path in paths:
        width, height = _size_px(path)  # before decoding: a small file can claim gigabytes
        if (width, height) != size_px:
            raise CalibrationError(
                f"{path}: is {width} x {height} px, but [camera] says {size_px[0]} x {size_px[1]}; take pictures of that size"
            )
        try:
            image = cv2.imread(path, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
        except cv2.error:
            image = None
        if image is None:
            raise CalibrationError(f"{path}: is no picture that can be read; leave it out of --images")
        view = target.find(path, np.asarray(image, np.uint8))
        views += [view] if view else []
    return views


def _size_px(path: str) -> tuple[int, int]:
    """Picture size from the file header."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with Image.open(path) as picture:
                return picture.size
    except (OSError, SyntaxError, ValueError, EOFError, struct.error, Image.DecompressionBombError) as error:
        raise CalibrationError(
            f"{path}: is no picture that can be read ({error}); leave it out of --images"
        ) from error


def views_from_camera(
    camera: Camera, target: CalibrationTarget, size_px: tuple[int, int], wanted: int, guide: Guide
) -> list[TargetView]:
    """Take a view whenever the target is held still in a new position, until the views are enough and cover the
    picture.

    Also ends after a minute without a new view; the fit then reports what is missing.
    """
    views: list[TargetView] = []
    before: TargetView | None = None
    newest_s = timebase.monotonic_s()
    while timebase.monotonic_s() - newest_s < IDLE_TIMEOUT_S:
        frame = camera.frame_after(timebase.monotonic_s())
        view = target.find(f"view {len(views) + 1}", frame.image_bgr)
        if view and before and is_still(view, before) and is_new(view, views, size_px[0]):
            views.append(view)
            newest_s = timebase.monotonic_s()
            guide.say(progress(views, size_px, wanted))
            if len(views) >= wanted and coverage(views, size_px) >= MIN_COVERAGE:
                break
        before = view
    return views


def is_still(view: TargetView, before: TargetView) -> bool:
    """Whether the target has not moved since the previous frame."""
    moved = _moved_px(view, before)
    return moved is not None and moved < STILL_PX


def is_new(view: TargetView, others: Sequence[TargetView], width_px: int) -> bool:
    """Whether the target's position differs from those of all other views."""
    moves = [_moved_px(view, other) for other in others]
    return all(moved is None or moved > NEW_SHARE * width_px for moved in moves)


def progress(views: Sequence[TargetView], size_px: tuple[int, int], wanted: int) -> str:
    """Coverage of the picture as text blocks: more corners, a fuller block."""
    counts = coverage_grid(views, size_px)
    blocks = np.array(list("·░▒▓█"))
    lines = ["  " + "".join(blocks[np.clip((row + 4) // 5, 0, 4)].repeat(2)) for row in counts]
    head = (
        f"view {len(views)} of {wanted}: {len(views[-1].ids)} corners, {coverage(views, size_px):.0%} covered"
    )
    return "\n".join([head, *lines])


def draw(fit: CameraFit, size_px: tuple[int, int]) -> Figure:
    """Corner positions with their residuals, and the residuals alone."""
    figure, (picture, cloud) = new_figure(
        f"camera: {fit.rms_px:.3f} px rms, {len(fit.corners_px)} corners in {fit.views} views", 2
    )
    u, v = fit.corners_px.T
    du, dv = fit.residuals_px.T
    picture.quiver(u, v, du, dv, angles="xy", scale_units="xy", scale=0.02, width=0.0015)
    picture.set_xlim(0, size_px[0] - 1)
    picture.set_ylim(size_px[1] - 1, 0)
    picture.set_aspect("equal")
    picture.set_xlabel("corners, px; residuals 50 times as long")
    cloud.plot(du, dv, ".", ms=2, alpha=0.5)
    limit = max(4.0 * fit.rms_px, 0.2)
    cloud.set_xlim(-limit, limit)
    cloud.set_ylim(-limit, limit)
    cloud.set_aspect("equal")
    cloud.set_xlabel("residual, px: right")
    cloud.set_ylabel("down")
    return figure


def _moved_px(view: TargetView, other: TargetView) -> float | None:
    """Mean displacement of the common corners; None if there are few."""
    common: NDArray[np.int64]
    common, mine, theirs = np.intersect1d(view.ids, other.ids, return_indices=True)
    if len(common) < 6:
        return None
    return float(np.linalg.norm(view.image_px[mine] - other.image_px[theirs], axis=1).mean())
