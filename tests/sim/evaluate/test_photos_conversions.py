"""Published poses and traces in the contract's conventions, on cases that can be computed by hand."""

import math

import numpy as np
import pytest
from pyproj import CRS

from localizer.camera import camera_to_world, pixel_rays, project
from sim.evaluate.photos.conversions import (
    cropped,
    distortion_of,
    grid_convergence_deg,
    principal_point_px,
    trace_rows_px,
    true_azimuth_deg,
)
from sim.evaluate.photos.standpoints import write_bundle

UTM6N = CRS.from_epsg(32606)


def test_on_the_central_meridian_grid_north_is_true_north():
    assert grid_convergence_deg(UTM6N, 500_000.0, 6_780_000.0) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("easting_m", [430_000.0, 560_000.0])
def test_convergence_is_the_longitude_difference_times_the_sine_of_the_latitude(easting_m):
    northing_m = 6_780_000.0
    from pyproj import Transformer

    lon, lat = Transformer.from_crs(UTM6N, 4326, always_xy=True).transform(easting_m, northing_m)
    expected = math.degrees(math.atan(math.tan(math.radians(lon + 147.0)) * math.sin(math.radians(lat))))
    assert grid_convergence_deg(UTM6N, easting_m, northing_m) == pytest.approx(expected, abs=1e-3)


def test_west_of_the_central_meridian_a_true_azimuth_is_smaller_than_the_grid_azimuth():
    assert true_azimuth_deg(UTM6N, 493_230.6, 6_776_753.5, 75.7441) == pytest.approx(75.7441 - 0.11, abs=1e-3)


def test_a_true_azimuth_stays_within_one_turn():
    assert true_azimuth_deg(UTM6N, 430_000.0, 6_780_000.0, 0.5) == pytest.approx(359.36, abs=0.02)
    assert true_azimuth_deg(UTM6N, 500_000.0, 6_780_000.0, -163.8) == pytest.approx(196.2, abs=1e-4)


def test_a_principal_point_without_offset_is_the_picture_s_middle():
    assert principal_point_px((640, 480), (0.0, 0.0)) == (319.5, 239.5)
    assert principal_point_px((968, 648), (-17.5, 42.0)) == (466.0, 365.5)


def test_cropping_leaves_every_ray_where_it_was():
    class Lens:
        fx_px = fy_px = 958.0
        distortion = (0.0,) * 5

        def __init__(self, cx_px: float, cy_px: float) -> None:
            self.cx_px, self.cy_px = cx_px, cy_px

    whole = pixel_rays(Lens(511.5, 381.0), [130.0], [222.0])
    part = pixel_rays(Lens(*cropped((511.5, 381.0), 30, 22)), [100.0], [200.0])
    assert part == pytest.approx(whole)


def test_a_trace_is_interpolated_within_a_line_and_not_across_a_gap():
    # corner-based coordinates: the centre of pixel (2, 10) is (2.5, 10.5)
    rows = trace_rows_px([[(2.5, 10.5), (4.5, 20.5)], [(7.5, 30.5), (6.5, 30.5)]], 9)
    assert rows[2:5] == pytest.approx([10.0, 15.0, 20.0])
    assert rows[6:8] == pytest.approx([30.0, 30.0])
    assert np.isnan(rows[[0, 1, 5, 8]]).all()


def test_of_two_lines_one_above_the_other_the_upper_counts():
    rows = trace_rows_px([[(0.5, 40.5), (3.5, 40.5)], [(0.5, 20.5), (1.5, 20.5)]], 4)
    assert rows == pytest.approx([20.0, 20.0, 40.0, 40.0])


def test_distortion_comes_in_opencv_s_order_and_a_rational_one_is_refused():
    assert distortion_of([1.0, 2.0, 3.0, 0.0], [4.0, 5.0]) == (1.0, 2.0, 4.0, 5.0, 3.0)
    with pytest.raises(ValueError, match="rational"):
        distortion_of([1.0, 2.0, 3.0, 0.1], [0.0, 0.0])


def test_a_photograph_becomes_a_bundle_that_can_be_loaded(tmp_path):
    from localizer.bundle import Altitude, Camera, frame_image, load_bundle

    image = np.random.default_rng(1).integers(0, 255, (20, 30, 3)).astype(np.uint8)
    camera = Camera(width_px=30, height_px=20, fx_px=40.0, fy_px=41.0, cx_px=14.5, cy_px=9.5)
    folder = write_bundle(
        tmp_path / "photo",
        image,
        camera,
        altitude=Altitude(value_m=480.0, sigma_m=15.0),
        azimuth_deg=75.6,
        tilt_deg=-9.9,
        roll_deg=0.6,
        tilt_sigma_deg=0.15,
        roll_sigma_deg=0.3,
    )
    bundle = load_bundle(folder)
    frame = bundle.frames[0]
    assert np.array_equal(frame_image(bundle, frame), image)
    rotation = camera_to_world(frame.azimuth_deg, frame.tilt_deg, frame.roll_deg)
    u, v = project(bundle.camera, rotation, [75.6], [-9.9])
    assert (u[0], v[0]) == pytest.approx((14.5, 9.5))
    assert bundle.azimuth_bias_sigma_deg == 180.0
