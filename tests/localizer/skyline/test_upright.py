"""Pictures on their side and on their head; how deep their values go; cameras that are not known."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from localizer.bundle import BundleError, Camera, frame_image, load_bundle, sha256_of
from localizer.camera import camera_to_world, pixel_rays
from localizer.picture import decode_picture
from localizer.skyline.upright import frame_skyline, quarter_turns_of, upright

CAMERA = Camera(
    width_px=640,
    height_px=480,
    fx_px=500.0,
    fy_px=503.0,
    cx_px=311.0,
    cy_px=248.0,
    distortion=(-0.06, 0.012, 0.003, -0.002, 0.001),
)


def directions(camera, roll_deg, u, v):
    return pixel_rays(camera, u, v) @ camera_to_world(40.0, 5.0, roll_deg).T


@given(
    roll_deg=st.floats(-180.0, 180.0),
    u=st.floats(0.0, 479.0),
    v=st.floats(0.0, 479.0),
)
def test_a_turned_pixel_looks_where_it_looked(roll_deg, u, v):
    turned = upright(CAMERA, roll_deg)
    assert abs(turned.roll_deg) <= 45.0 + 1e-9
    us, vs = np.array([u]), np.array([v])
    as_recorded = turned.as_recorded(us, vs)
    assert np.allclose(
        directions(turned.camera, turned.roll_deg, us, vs),
        directions(CAMERA, roll_deg, *as_recorded),
        atol=1e-6,
    )


def test_upright_pictures_stay_as_they_are():
    assert upright(CAMERA, -44.0) == (0, CAMERA, -44.0)
    assert [quarter_turns_of(roll) for roll in (0.0, 90.0, 180.0, -180.0, -90.0, 44.0)] == [0, 1, 2, 2, 3, 0]


RIDGE = 240 + 40 * np.sin(np.arange(640) / 60.0) + 15 * np.sin(np.arange(640) / 17.0)


def scene() -> np.ndarray:
    """A ridge under a bright sky, 640 x 480; the first row of terrain is the one below RIDGE."""
    rng = np.random.default_rng(3)
    picture = np.full((480, 640, 3), (230, 210, 190), np.uint8)
    picture[np.arange(480)[:, None] > RIDGE[None, :]] = (40, 60, 50)
    return np.clip(picture + rng.normal(0, 2, picture.shape), 0, 255).astype(np.uint8)


@pytest.fixture
def with_picture(bundle_dir, edit_bundle):
    """A bundle whose frame N holds this picture, or these bytes."""

    def change(picture, roll_deg=0.0, size=(640, 480), suffix="png"):
        file = bundle_dir / "frames" / f"N.{suffix}"
        if isinstance(picture, bytes):
            file.write_bytes(picture)
        else:
            cv2.imwrite(str(file), picture)
        east = bundle_dir / "frames" / "E.png"
        cv2.imwrite(str(east), np.full((size[1], size[0], 3), 90, np.uint8))

        def edit(b):
            b["camera"].update(
                width_px=size[0],
                height_px=size[1],
                fx_px=500.0,
                fy_px=500.0,
                cx_px=size[0] / 2,
                cy_px=size[1] / 2,
            )
            b["frames"][0].update(file=f"frames/N.{suffix}", sha256=sha256_of(file), roll_deg=roll_deg)
            b["frames"][1].update(sha256=sha256_of(east))

        return load_bundle(edit_bundle(edit))

    return change


@pytest.mark.parametrize("quarter_turns", [0, 1, 2, 3])
def test_the_skyline_is_found_whichever_way_the_camera_hangs(with_picture, quarter_turns):
    hung = np.ascontiguousarray(
        np.rot90(scene(), quarter_turns)
    )  # a camera turned clockwise sees the world turned back
    roll_deg = (90.0 * quarter_turns + 180.0) % 360.0 - 180.0
    bundle = with_picture(hung, roll_deg=roll_deg, size=(hung.shape[1], hung.shape[0]))
    found = frame_skyline(bundle, bundle.frames[0])
    assert np.isfinite(found.row_px).mean() > 0.9
    error = (found.row_px - (np.floor(RIDGE) + 0.5))[np.isfinite(found.row_px)]
    assert np.percentile(np.abs(error), 90) < 0.5
    # back in the picture as recorded, it is bright on the sky's side of the line and dark on the other
    middle = np.arange(20.0, 620.0)
    for off_px, bright in ((-4.0, True), (4.0, False)):
        u, v = upright(bundle.camera, roll_deg).as_recorded(middle, found.row_px[20:620] + off_px)
        seen = hung[np.rint(v).astype(int), np.rint(u).astype(int)].mean(axis=1)
        assert ((seen > 125.0) == bright).mean() > 0.95


# ---- orientation tags


def jpeg(picture: np.ndarray, tag: int) -> bytes:
    from io import BytesIO

    exif = Image.Exif()
    exif[0x0112] = tag
    out = BytesIO()
    Image.fromarray(picture[:, :, ::-1].copy()).save(out, "JPEG", exif=exif, quality=95)
    return out.getvalue()


TURNED_BACK = {3: 2, 6: 1, 8: -1}
"""Quarters counter-clockwise, by which a picture is stored that the tag turns upright."""


@pytest.mark.parametrize("tag", [3, 6, 8])
def test_a_picture_that_only_its_tag_turns_upright_is_turned(with_picture, tag):
    bundle = with_picture(jpeg(np.rot90(scene(), TURNED_BACK[tag]), tag), suffix="jpg")
    image = frame_image(bundle, bundle.frames[0])
    assert image.shape == (480, 640, 3)
    assert np.abs(image.astype(int) - scene()).mean() < 8.0


@pytest.mark.parametrize("tag", [3, 6, 8])
def test_a_bundle_that_tells_of_the_stored_pixels_is_believed(with_picture, tag):
    """Sizes and roll are of the picture as it lies in the file: the tag says nothing new, and nothing is turned twice."""
    stored = np.rot90(scene(), TURNED_BACK[tag])
    roll_deg = {3: 180.0, 6: 90.0, 8: -90.0}[tag]
    bundle = with_picture(jpeg(stored, tag), roll_deg, (stored.shape[1], stored.shape[0]), "jpg")
    assert np.abs(frame_image(bundle, bundle.frames[0]).astype(int) - stored).mean() < 8.0
    found = frame_skyline(bundle, bundle.frames[0])
    assert np.isfinite(found.row_px).mean() > 0.9


@pytest.mark.parametrize("tag", [0, 9, 255, 65535])
def test_a_tag_that_is_none_turns_nothing(tag):
    content = jpeg(scene(), tag)
    assert np.abs(decode_picture(content, 640, 480).astype(int) - scene()).mean() < 8.0


# ---- depth


@pytest.mark.parametrize("bits", [8, 10, 12, 14, 16])
@pytest.mark.parametrize("colours", [1, 3])
def test_cameras_of_10_and_12_bits_leave_no_black_picture(bits, colours):
    eight = scene() if colours == 3 else np.repeat(scene()[:, :, :1], 3, axis=2)
    eight[0, 0] = 255  # as bright as can be: the depth is used
    deep = eight.astype(np.uint16) << (bits - 8)
    content = cv2.imencode(".png", deep if colours == 3 else deep[:, :, 0])[1].tobytes()
    assert np.array_equal(decode_picture(content, 640, 480), eight)


@pytest.mark.parametrize("stuck", [(240, 320), (0, slice(None))])
def test_stuck_pixels_and_a_line_of_the_camera_s_own_leave_no_black_picture(stuck):
    eight = scene()[:, :, 0]
    deep = eight.astype(np.uint16) << 2
    deep[stuck] = 0xFFFF
    found = decode_picture(cv2.imencode(".png", deep)[1].tobytes(), 640, 480)[:, :, 0]
    assert np.array_equal(found[1:-1, :300], eight[1:-1, :300])


def test_a_black_picture_of_16_bits_stays_black():
    content = cv2.imencode(".png", np.zeros((12, 16), np.uint16))[1].tobytes()
    assert not decode_picture(content, 16, 12).any()


# ---- cameras


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("model", "fisheye"),
        ("model", "rational"),
        ("model", "cylindrical"),
        ("model", "equirectangular"),
        ("model", "Perspective"),
        ("model", ""),
        ("model", None),
        ("model", 1),
        ("focal_sigma_fraction", 0.01),
        ("focal_sigma_fraction", -1.0),
        ("distortion", [0.0] * 4),
        ("distortion", [0.0] * 8),
        ("distortion", None),
    ],
)
def test_a_camera_that_is_not_known_is_refused_and_not_ignored(
    bundle_dir, edit_bundle, refused, field, value
):
    directory = edit_bundle(lambda b: b["camera"].update({field: value}))
    with pytest.raises(BundleError, match=rf"camera\.{field}"):
        load_bundle(directory)
    assert f"camera.{field}" in refused("predict", "--dem", "any.tif", "--at", "1,1", "--camera", directory)


def test_what_is_supported_is_said(edit_bundle):
    with pytest.raises(BundleError, match="only perspective is"):
        load_bundle(edit_bundle(lambda b: b["camera"].update(model="fisheye")))


def test_the_one_that_is_known_may_be_named(edit_bundle):
    bundle = load_bundle(
        edit_bundle(lambda b: b["camera"].update(model="perspective", focal_sigma_fraction=0.0))
    )
    assert '"model": "perspective"' in bundle.to_json()


def test_a_camera_that_says_nothing_of_it_is_written_without(bundle_dir):
    text = load_bundle(bundle_dir).to_json()
    assert "model" not in text
    assert "focal_sigma_fraction" not in text


@pytest.mark.parametrize("quarter_turns", [0, 1, 2, 3])
def test_what_is_drawn_is_measured_across_the_horizon(quarter_turns):
    """Five pixels above the predicted skyline, whichever way the frame lies."""
    from localizer.search.details import FrameDetail
    from localizer.show.figures import residuals_px

    turned = upright(CAMERA, 90.0 * quarter_turns)
    columns = np.arange(20.0)
    found = turned.as_recorded(columns, 100.0 + columns)
    predicted = turned.as_recorded(columns, 105.0 + columns)
    detail = FrameDetail("N", *found, np.ones(20, bool), *predicted, quarter_turns=quarter_turns)
    assert np.allclose(residuals_px(detail), 5.0)
    assert np.allclose(
        detail.turned_px(*found, CAMERA.height_px, CAMERA.width_px), (columns, 100.0 + columns)
    )
