import hashlib
import json
import os
import re
import struct
import zlib
from datetime import UTC, datetime, timedelta, timezone

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from localizer.bundle import (
    Altitude,
    Bundle,
    BundleError,
    Camera,
    Frame,
    Prior,
    frame_image,
    load_bundle,
    parse_bundle,
    sha256_of,
)


def test_a_sound_bundle_is_read_with_its_directory_and_pictures(bundle_dir):
    bundle = load_bundle(bundle_dir)
    assert bundle.directory == bundle_dir
    assert bundle.created == datetime(2026, 11, 23, 4, 31, 51, tzinfo=UTC)
    assert bundle.altitude == Altitude(value_m=1432.6, sigma_m=5.0)
    assert [frame.label for frame in bundle.frames] == ["N", "E"]
    image = frame_image(bundle, bundle.frames[1])
    assert image.shape == (12, 16, 3)
    assert image.dtype == np.uint8


def test_unknown_fields_survive_a_round_trip(bundle_dir):
    bundle = load_bundle(bundle_dir)
    written = json.loads(bundle.to_json())
    assert written == json.loads((bundle_dir / "bundle.json").read_text())
    assert written["schema"] == "skyfix.bundle/1"
    assert written["created"] == "2026-11-23T04:31:51Z"
    assert written["calibration"] == {"zero_tick": 2048}
    assert written["frames"][0]["raw"]["pan_ticks"] == 2048
    assert "prior" not in written


def test_no_altimeter_no_compass_and_a_prior_are_said_as_the_contract_says_them(edit_bundle):
    def change(fields):
        fields["altitude"] = None
        fields["azimuth_bias_sigma_deg"] = 180
        fields["prior"] = {"lat_deg": 46.2, "lon_deg": -122.2, "radius_m": 2000.0}

    bundle = load_bundle(edit_bundle(change))
    assert bundle.altitude is None
    assert bundle.azimuth_bias_sigma_deg == 180.0
    assert bundle.prior == Prior(lat_deg=46.2, lon_deg=-122.2, radius_m=2000.0)
    assert json.loads(bundle.to_json())["altitude"] is None


@pytest.mark.parametrize(
    ("change", "field", "complaint"),
    [
        (lambda b: b.pop("schema"), "schema", "required"),
        (lambda b: b.update(schema="skyfix.bundle/2"), "schema", "skyfix.bundle/1"),
        (lambda b: b.pop("camera"), "camera", "required"),
        (lambda b: b["camera"].update(fx_px=0.0), "camera.fx_px", "greater than 0"),
        (lambda b: b["camera"].update(fx_px="492.8"), "camera.fx_px", "number"),
        (lambda b: b["camera"].update(cx_px=float("nan")), "camera.cx_px", "finite"),
        (lambda b: b["camera"].update(width_px=640.5), "camera.width_px", "integer"),
        (lambda b: b["camera"].update(width_px=32768, height_px=32768), "camera", "150 megapixels"),
        (lambda b: b["camera"].update(fx_px=1e-9), "camera", "field of view of 180 deg"),
        (lambda b: b["camera"].update(fy_px=1e6), "camera", "field of view of 0.0"),
        (lambda b: b["camera"].update(cx_px=1e9), "camera", "far outside"),
        (lambda b: b["camera"].update(distortion=[0.0, 0.0, 1.0, 1.0, 0.0]), "camera", "folds"),
        (lambda b: b["frames"][0].update(label="altitude"), "frames[0].label", "step of the search"),
        (lambda b: b["frames"][0].update(label="N\x1b[2J"), "frames[0].label", "control characters"),
        (lambda b: b["frames"][0].update(file="frames/N\0.png"), "frames[0].file", "control characters"),
        (lambda b: b["camera"].update(distortion=[0.0] * 4), "camera.distortion[4]", "required"),
        (lambda b: b.update(created="2026-11-23T04:31:51"), "created", "Z"),
        (lambda b: b.update(created="2026-11-23T06:31:51+02:00"), "created", "UTC"),
        (lambda b: b.update(mast_height_m=-1.0), "mast_height_m", "greater"),
        (lambda b: b["altitude"].update(value_m=12000.0), "altitude.value_m", "9000"),
        (lambda b: b["altitude"].update(sigma_m=-1.0), "altitude.sigma_m", "greater"),
        (lambda b: b.update(azimuth_bias_sigma_deg=181.0), "azimuth_bias_sigma_deg", "180"),
        (lambda b: b.update(frames=[]), "frames", "at least 1"),
        (lambda b: b["frames"][1].update(azimuth_deg=360.0), "frames[1].azimuth_deg", "less than 360"),
        (lambda b: b["frames"][1].update(tilt_deg=90.5), "frames[1].tilt_deg", "90"),
        (lambda b: b["frames"][1].update(roll_deg=-181.0), "frames[1].roll_deg", "-180"),
        (lambda b: b["frames"][1].pop("roll_sigma_deg"), "frames[1].roll_sigma_deg", "required"),
        (lambda b: b["frames"][1].update(label="N"), "frames", "once"),
        (lambda b: b["frames"][0].update(sha256="12"), "frames[0].sha256", "pattern"),
        (lambda b: b["frames"][0].update(sha256="0" * 64), "frames[N].sha256", "checksum"),
        (lambda b: b["frames"][0].update(file="frames/gone.png"), "frames[N].file", "missing"),
        (lambda b: b["frames"][0].update(file="frames"), "frames[N].file", "directory"),
        (lambda b: b["frames"][0].update(file="../outside.png"), "frames[0].file", "inside"),
        (lambda b: b["frames"][0].update(file="frames/../../outside.png"), "frames[0].file", "inside"),
        (lambda b: b["frames"][0].update(file="/etc/passwd"), "frames[0].file", "inside"),
        (lambda b: b["frames"][0].update(file=""), "frames[0].file", "inside"),
        (lambda b: b["camera"].update(width_px=17), "frames[N].file", "16 x 12 px"),
        (lambda b: b.update(prior={"lat_deg": 91, "lon_deg": 0, "radius_m": 1}), "prior.lat_deg", "90"),
    ],
)
def test_what_fails_is_refused_with_file_and_field(edit_bundle, change, field, complaint):
    directory = edit_bundle(change)
    with pytest.raises(BundleError) as refusal:
        load_bundle(directory)
    message = str(refusal.value)
    assert message.startswith(f"{directory / 'bundle.json'}: {field}")
    assert complaint.lower() in message.lower()
    assert "\n" not in message


@pytest.mark.parametrize("text", [b"", b"{", b"[1]", b"null", b"\xff\xfe", b"[" * 100_000])
def test_what_is_no_json_object_is_refused(bundle_dir, text):
    (bundle_dir / "bundle.json").write_bytes(text)
    with pytest.raises(BundleError, match=r"bundle\.json: "):
        load_bundle(bundle_dir)


@given(text=st.binary(max_size=200))
def test_no_content_of_bundle_json_ends_in_anything_but_a_refusal(tmp_path_factory, text):
    directory = tmp_path_factory.mktemp("bundle")
    (directory / "bundle.json").write_bytes(text)
    with pytest.raises(BundleError):
        load_bundle(directory)


def test_a_link_that_leads_outside_is_refused(bundle_dir, edit_bundle):
    outside = bundle_dir.parent / "outside.png"
    (bundle_dir / "frames/N.png").rename(outside)
    (bundle_dir / "frames/N.png").symlink_to(outside)
    with pytest.raises(BundleError, match=r"frames\[N\]\.file: .*outside the bundle"):
        load_bundle(bundle_dir)


def test_a_link_to_itself_and_a_pipe_are_refused(bundle_dir):
    file = bundle_dir / "frames/N.png"
    file.unlink()
    file.symlink_to(file)
    with pytest.raises(BundleError, match=r"frames\[N\]\.file: "):
        load_bundle(bundle_dir)
    file.unlink()
    os.mkfifo(file)
    with pytest.raises(BundleError, match=r"frames\[N\]\.file: .*pipe"):
        load_bundle(bundle_dir)


@pytest.mark.parametrize("make", [os.mkfifo, os.mkdir])
def test_a_bundle_json_that_is_no_file_is_refused_and_not_waited_for(bundle_dir, make):
    (bundle_dir / "bundle.json").unlink()
    make(bundle_dir / "bundle.json")
    with pytest.raises(BundleError, match=r"bundle\.json: is not a file but a directory or a pipe"):
        load_bundle(bundle_dir)


def test_a_small_file_that_claims_to_be_a_gigantic_picture_is_not_decoded(bundle_dir, edit_bundle):
    header = struct.pack(">IIBBBBB", 60_000, 60_000, 8, 2, 0, 0, 0)
    content = b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in ((b"IHDR", header), (b"IDAT", zlib.compress(bytes(1_000_000))), (b"IEND", b""))
    )
    (bundle_dir / "frames/N.png").write_bytes(content)
    edit_bundle(lambda b: b["frames"][0].update(sha256=hashlib.sha256(content).hexdigest()))
    with pytest.raises(BundleError, match=r"frames\[N\]\.file: .*not a picture that can be read"):
        load_bundle(bundle_dir)


@pytest.mark.parametrize("kind", ["grey", "16 bits", "16 bits grey", "transparent"])
def test_pictures_of_other_kinds_show_the_same(bundle_dir, edit_bundle, kind):
    picture = np.repeat(np.arange(192, dtype=np.uint8).reshape(12, 16, 1), 3, axis=2)
    stored = {
        "grey": picture[..., 0],
        "16 bits": picture.astype(np.uint16) * 257,
        "16 bits grey": picture[..., 0].astype(np.uint16) * 257,
        "transparent": np.dstack([picture, np.zeros((12, 16), np.uint8)]),
    }[kind]
    content = cv2.imencode(".png", stored)[1].tobytes()
    (bundle_dir / "frames/N.png").write_bytes(content)
    bundle = load_bundle(
        edit_bundle(lambda b: b["frames"][0].update(sha256=hashlib.sha256(content).hexdigest()))
    )
    assert np.array_equal(frame_image(bundle, bundle.frames[0]), picture)


@pytest.mark.parametrize("content", [b"", b"not a picture", b"\x89PNG\r\n\x1a\n"])
def test_a_file_that_is_no_picture_is_refused_even_with_the_right_checksum(bundle_dir, edit_bundle, content):
    (bundle_dir / "frames/N.png").write_bytes(content)
    edit_bundle(lambda b: b["frames"][0].update(sha256=hashlib.sha256(content).hexdigest()))
    with pytest.raises(BundleError, match=r"frames\[N\]\.file: frames/N\.png is not a picture"):
        load_bundle(bundle_dir)


def test_no_directory_and_no_bundle_json_are_told_apart(tmp_path, bundle_dir):
    with pytest.raises(BundleError, match="does not exist"):
        load_bundle(tmp_path / "nowhere")
    with pytest.raises(BundleError, match="is not a directory"):
        load_bundle(bundle_dir / "bundle.json")
    with pytest.raises(BundleError, match=r"holds no bundle\.json"):
        load_bundle(tmp_path)


def test_an_orientation_tag_does_not_turn_the_picture(bundle_dir, edit_bundle):
    tag = Image.Exif()
    tag[0x0112] = 6  # turn by 90 degrees for display
    Image.new("RGB", (16, 12)).save(bundle_dir / "frames/N.jpg", exif=tag)
    checksum = sha256_of(bundle_dir / "frames/N.jpg")
    bundle = load_bundle(edit_bundle(lambda b: b["frames"][0].update(file="frames/N.jpg", sha256=checksum)))
    assert frame_image(bundle, bundle.frames[0]).shape == (12, 16, 3)


def test_a_grey_picture_comes_as_bgr(bundle_dir, edit_bundle):
    grey = np.arange(192, dtype=np.uint8).reshape(12, 16)
    cv2.imwrite(str(bundle_dir / "frames/N.png"), grey)
    checksum = sha256_of(bundle_dir / "frames/N.png")
    bundle = load_bundle(edit_bundle(lambda b: b["frames"][0].update(sha256=checksum)))
    assert np.array_equal(frame_image(bundle, bundle.frames[0]), np.repeat(grey[:, :, None], 3, axis=2))


def test_a_writer_constructs_the_models_with_plain_values():
    frame = Frame(
        label="045",
        file="frames/045.png",
        sha256="ab" * 32,
        time=datetime(2026, 11, 23, 5, 31, 40, 250000, tzinfo=UTC),
        azimuth_deg=np.float64(45.0),
        azimuth_sigma_deg=0.1,
        tilt_deg=0,
        tilt_sigma_deg=0.01,
        roll_deg=0.0,
        roll_sigma_deg=0.02,
    )
    bundle = Bundle(
        id="x",
        created=datetime(2026, 11, 23, 5, 31, 51, tzinfo=UTC),
        camera=Camera(width_px=640, height_px=480, fx_px=492.8, fy_px=492.8, cx_px=319.5, cy_px=239.5),
        mast_height_m=2.0,
        altitude=None,
        azimuth_bias_sigma_deg=180.0,
        tilt_bias_sigma_deg=0.02,
        frames=[frame],
    )
    fields = json.loads(bundle.to_json())
    assert fields["frames"][0]["time"] == "2026-11-23T05:31:40.250000Z"
    assert fields["camera"]["distortion"] == [0.0] * 5
    with pytest.raises(BundleError, match="not loaded from a directory"):
        frame_image(bundle, frame)


def test_a_local_time_is_no_bundle_time():
    elsewhere = datetime(2026, 11, 23, 5, 31, 51, tzinfo=timezone(timedelta(hours=1)))
    with pytest.raises(ValueError, match="UTC"):
        Bundle.model_validate({"created": elsewhere})


@pytest.mark.parametrize(
    ("where", "taken", "refused"),
    [
        ("camera.width_px", [1, 32768], [0, 32769]),
        ("camera.distortion.0", [0.001], [-1000.5, 1000.5]),
        ("mast_height_m", [0.0, 1000.0], [-1e-9, 1000.1]),
        ("altitude.value_m", [-500.0, 9000.0], [-500.1, 9000.1]),
        ("altitude.sigma_m", [0.0, 1e4], [-1e-9, 10_001.0]),
        ("azimuth_bias_sigma_deg", [0.0, 180.0], [-1e-9, 180.1]),
        ("tilt_bias_sigma_deg", [0.0, 180.0], [-1e-9, 180.1]),
        ("frames.0.azimuth_deg", [0.0, 359.999999], [-1e-9, 360.0]),
        ("frames.0.azimuth_sigma_deg", [0.0, 180.0], [-1e-9, 180.1]),
        ("frames.0.tilt_deg", [-90.0, 90.0], [-90.1, 90.1]),
        ("frames.0.tilt_sigma_deg", [0.0, 180.0], [-1e-9, 180.1]),
        ("frames.0.roll_deg", [-180.0, 180.0], [-180.1, 180.1]),
        ("frames.0.roll_sigma_deg", [0.0, 180.0], [-1e-9, 180.1]),
        ("frames.0.label", ["x" * 64], ["", "x" * 65]),
        ("frames.0.file", ["x" * 1024], ["x" * 1025, "a\\b", "c:b", "."]),
        ("prior.lat_deg", [-90.0, 90.0], [-90.1, 90.1]),
        ("prior.lon_deg", [-360.0, 360.0], [-360.1, 360.1]),
        ("prior.radius_m", [1e-3], [0.0, -1.0]),
    ],
)
def test_a_reading_is_taken_up_to_its_limit_and_not_beyond(bundle_dir, where, taken, refused):
    def parsed(value):
        fields = json.loads((bundle_dir / "bundle.json").read_text())
        fields["prior"] = {"lat_deg": 46.2, "lon_deg": -122.2, "radius_m": 2000.0}
        if where == "camera.width_px":  # with a lens as wide as before
            fields["camera"].update(
                height_px=3, fx_px=max(float(value), 1.0), fy_px=3.0, cx_px=0.0, cy_px=0.0
            )
        *parts, last = (int(part) if part.isdigit() else part for part in where.split("."))
        at = fields
        for part in parts:
            at = at[part]
        at[last] = value
        return parse_bundle(json.dumps(fields).encode(), "bundle.json")

    for value in taken:
        parsed(value)
    field = where.replace(".0", "[0]")
    for value in refused:
        with pytest.raises(BundleError) as refusal:
            parsed(value)
        assert str(refusal.value).startswith(f"bundle.json: {field}: ")


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        # 2 atan(w / 2f): 16 px wide. 170 deg at f = 8 / tan(85 deg) = 0.69992, 0.2 deg at f = 8 / tan(0.1 deg) = 4583.66
        ({"fx_px": 0.6998}, "fx_px 0.6998 on 16 px is a field of view of 170 deg; should be 0.2 to 170"),
        ({"fx_px": 0.7001}, None),
        ({"fx_px": 4583.0}, None),
        ({"fx_px": 4584.5}, "fx_px 4584.5 on 16 px is a field of view of 0.2 deg; should be 0.2 to 170"),
        ({"fy_px": 0.5}, "fy_px 0.5 on 12 px is a field of view of 170 deg"),
        ({"cx_px": -16.0}, None),
        ({"cx_px": -16.1}, "cx_px -16.1 is far outside a picture of 16 px"),
        ({"cx_px": 32.0}, None),
        ({"cx_px": 32.1}, "cx_px 32.1 is far outside a picture of 16 px"),
        ({"cy_px": 24.1}, "cy_px 24.1 is far outside a picture of 12 px"),
        ({"cy_px": -12.1}, "cy_px -12.1 is far outside a picture of 12 px"),
    ],
)
def test_a_camera_has_a_view_of_a_fifth_of_a_degree_to_170(change, complaint):
    camera = {"width_px": 16, "height_px": 12, "fx_px": 12.3, "fy_px": 12.3, "cx_px": 7.5, "cy_px": 5.5}
    if complaint is None:
        Camera(**{**camera, **change})
    else:
        with pytest.raises(ValueError, match=re.escape(complaint)):
            Camera(**{**camera, **change})


def test_a_picture_has_150_megapixels_at_most():
    fits = Camera(width_px=15_000, height_px=10_000, fx_px=1e4, fy_px=1e4, cx_px=7500.0, cy_px=5000.0)
    assert fits.width_px * fits.height_px == 150_000_000
    with pytest.raises(ValueError, match="15000 x 10001 px are more than 150 megapixels"):
        Camera(width_px=15_000, height_px=10_001, fx_px=1e4, fy_px=1e4, cx_px=7500.0, cy_px=5000.0)


def test_how_many_more_fields_are_wrong_is_said(edit_bundle):
    def two(fields):
        fields["mast_height_m"] = -1.0
        fields["frames"][1]["tilt_deg"] = 91.0

    with pytest.raises(BundleError, match=r"mast_height_m: .* \(got -1.0\) \(and 1 more\)$"):
        load_bundle(edit_bundle(two))
    with pytest.raises(BundleError, match=r"mast_height_m: .* \(got -1.0\)$"):
        load_bundle(edit_bundle(lambda fields: fields["frames"][1].update(tilt_deg=1.0)))


def test_a_list_that_is_wrong_is_not_repeated_in_the_message(edit_bundle):
    with pytest.raises(BundleError, match=r"frames: [^()]*$"):
        load_bundle(edit_bundle(lambda fields: fields.update(frames=[])))


def test_a_bundle_has_a_thousand_frames_at_most(bundle_dir):
    fields = json.loads((bundle_dir / "bundle.json").read_text())
    fields["frames"] = [{**fields["frames"][0], "label": str(number)} for number in range(1001)]
    with pytest.raises(BundleError, match="at most 1000 items"):
        parse_bundle(json.dumps(fields).encode(), "bundle.json")
    del fields["frames"][0]
    assert len(parse_bundle(json.dumps(fields).encode(), "bundle.json").frames) == 1000


@pytest.mark.parametrize(
    ("name", "advice"),
    [
        ("one.zip", r"; take it out of the archive first: rig bundle import$"),
        ("one.tar.gz", r"; take it out of the archive first: rig bundle import$"),
        ("one.tgz", r"; take it out of the archive first: rig bundle import$"),
        ("one.tar", r"; take it out of the archive first: rig bundle import$"),
        ("one.txt", r"a bundle is a directory with a bundle\.json$"),
    ],
)
def test_what_to_do_with_a_file_is_said(tmp_path, name, advice):
    (tmp_path / name).write_bytes(b"PK")
    with pytest.raises(BundleError, match=advice):
        load_bundle(tmp_path / name)


def test_the_folder_of_a_bundle_json_is_named(bundle_dir):
    with pytest.raises(BundleError, match=rf"; name {re.escape(str(bundle_dir))}$"):
        load_bundle(bundle_dir / "bundle.json")
