"""What the numbers of a band mean: scale, unit, voids, masks, and files that end too soon."""

import gzip
import shutil

import numpy as np
import pytest
import rasterio
from affine import Affine
from hypothesis import given
from hypothesis import strategies as st

from localizer.dem.info import suspect_zeros
from localizer.dem.lattice import DemError, load_dem

UTM = Affine(30.0, 0.0, 560_000.0, 0.0, -30.0, 5_120_000.0)
HILLS = (3000 + 7 * np.add.outer(np.arange(30), np.arange(40))).astype(np.int16)
"""300 to 783 m in decimetres."""


# ---- scale and unit


@pytest.mark.parametrize("scale", [0.0, np.nan, np.inf])
def test_a_scale_that_makes_no_elevations_is_refused_with_what_to_do(write_raster, scale):
    path = write_raster(HILLS, scale=scale)
    with pytest.raises(DemError, match="--scale"):
        load_dem([path])
    assert np.allclose(load_dem([path], scale=0.1).z_m, HILLS * 0.1, rtol=1e-6)


def test_a_scale_that_is_told_may_be_1_and_not_0(write_raster):
    path = write_raster(HILLS, scale=0.1)
    assert np.array_equal(load_dem([path], scale=1.0).z_m, HILLS)
    for scale in (0.0, np.nan, np.inf):
        with pytest.raises(DemError, match=f"^--scale: {scale:g} makes no elevations"):
            load_dem([path], scale=scale)


def test_an_offset_that_is_no_number_is_refused(write_raster):
    with pytest.raises(DemError, match="offset is nan"):
        load_dem([write_raster(HILLS, offset=np.nan)])


def test_the_file_with_scale_0_of_the_reports(skyfix_data, run, refused):
    path = skyfix_data / "reports/dem/scale0.tif"
    assert "--scale" in refused("dem", "info", path)
    status, out, _ = run("dem", "info", path, "--scale", "1")
    assert status == 0
    assert "558.0 to 1992.0 m" in out


@pytest.mark.parametrize(
    ("options", "factor"),
    [
        (["--vertical-unit", "dm"], 0.1),
        (["--vertical-unit", "cm"], 0.01),
        (["--vertical-unit", "mm"], 0.001),
        (["--scale", "0.1"], 0.1),
        (["--scale", "0.1", "--vertical-unit", "ft"], 0.03048),
    ],
)
def test_decimetres_and_centimetres_can_be_said(write_raster, run, options, factor):
    path = write_raster(HILLS)
    status, out, _ = run("dem", "info", path, *options)
    assert status == 0
    assert f"{HILLS.min() * factor:.1f} to {HILLS.max() * factor:.1f} m" in out


@pytest.mark.parametrize(
    ("unit", "factor"), [("dm", 0.1), ("decimeters", 0.1), ("cm", 0.01), ("centimetre", 0.01)]
)
def test_a_band_in_decimetres_says_so_itself(write_raster, unit, factor):
    assert np.allclose(load_dem([write_raster(HILLS, unit=unit)]).z_m, HILLS * factor, rtol=1e-6)


def test_an_option_that_overrules_the_file_s_scale_is_said(write_raster, run):
    _, out, _ = run("dem", "info", write_raster(HILLS, scale=0.1), "--scale", "0.2")
    assert "says its scale is 0.1; --scale takes it for 0.2" in out


@pytest.mark.parametrize("scale", ["0", "nan", "1e9"])
def test_a_wrong_scale_is_refused(write_raster, refused, scale):
    assert "--scale" in refused("dem", "info", write_raster(HILLS), "--scale", scale)


# ---- voids


@pytest.mark.parametrize(
    ("dtype", "void", "scale"),
    [
        ("int16", -9999, 0.01),
        ("int16", -9999, 0.1),
        ("int16", -32767, 0.01),
        ("int16", -32768, 0.01),
        ("int16", 32767, 0.1),
        ("uint16", 65535, 0.1),
        ("int32", -9999, 0.01),
        ("int32", -32768, 0.01),
        ("int32", -99999, 0.001),
        ("int32", -2147483648, 1e-6),
        ("float32", -9999.0, 0.01),
        ("float32", -32767.0, 0.01),
        ("float32", -3.4028234663852886e38, 0.01),
        ("float32", 3.4028234663852886e38, 0.01),
        ("float32", 1e20, 0.01),
        ("float32", np.nan, 0.01),
    ],
)
@pytest.mark.parametrize("how", ["scale", "option", "unit"])
def test_undeclared_voids_are_voids_whatever_the_scale(write_raster, dtype, void, scale, how):
    z = HILLS.astype(dtype)
    z[3, 4] = void
    if how == "scale":
        dem = load_dem([write_raster(z, scale=scale)])
    elif how == "option":
        dem = load_dem([write_raster(z)], scale=scale)
    else:
        unit = {0.1: "dm", 0.01: "cm"}.get(scale, "mm")
        dem = load_dem([write_raster(z)], vertical_unit=unit)
    assert np.argwhere(np.isnan(dem.z_m)).tolist() == [[3, 4]]


@pytest.mark.parametrize("void", [-9999, -32767, 65535, 3.4e38])
def test_feet_do_not_make_ground_of_voids(write_raster, void):
    z = HILLS.astype(np.float32)
    z[0, 0] = void
    assert np.isnan(load_dem([write_raster(z, unit="ft")]).z_m[0, 0])


def test_a_number_of_voids_that_lies_among_the_ground_is_ground(write_raster):
    """32767 mm is a height like any other between 30 and 40 m; -999 cm is ground where a shore goes on down to it."""
    z = np.linspace(30_000, 40_000, 1200).reshape(30, 40).astype(np.int32)
    z[5, 5] = 32767
    assert np.isfinite(load_dem([write_raster(z, scale=0.001)]).z_m).all()
    shore = np.linspace(-1500, 9000, 1200).reshape(30, 40).astype(np.int16)
    shore[0, 0] = -999
    assert np.isfinite(load_dem([write_raster(shore, scale=0.01)]).z_m).all()


@pytest.mark.parametrize(
    ("void", "scale"),
    [
        *((void, 0.01) for void in (-999, -9999, -32767, -32768, 9999, 99999, 32767, 65535)),
        (-99999, 0.001),
    ],
)
def test_each_usual_void_apart_from_the_ground_is_one(write_raster, void, scale):
    z = HILLS.astype(np.int32)  # 30 to 78 m, or 3 to 8 m: the void lies 20 m or more beside that
    z[3, 4] = void
    assert np.argwhere(np.isnan(load_dem([write_raster(z, scale=scale)]).z_m)).tolist() == [[3, 4]]


def test_such_a_number_in_the_middle_of_much_higher_and_lower_ground_is_ground(write_raster):
    z = np.linspace(20_000, 90_000, 1200).reshape(30, 40).astype(np.int32)  # 20 to 90 m
    z[5, 5] = 32767
    assert np.isfinite(load_dem([write_raster(z, scale=0.001)]).z_m).all()


def test_the_end_of_a_type_s_range_is_a_void_also_right_beside_the_ground(write_raster):
    z = np.linspace(20_000, 32_700, 1200).reshape(30, 40).astype(np.int16)  # up to 327.00 m
    z[2, 3] = 32767
    dem = load_dem([write_raster(z, scale=0.01)])
    assert np.argwhere(np.isnan(dem.z_m)).tolist() == [[2, 3]]


def test_bytes_use_their_whole_range(write_raster):
    z = np.linspace(0, 255, 1200).reshape(30, 40).astype(np.uint8)
    assert load_dem([write_raster(z)]).z_m.max() == 255.0


def test_complex_numbers_are_no_elevations(write_raster):
    with pytest.raises(DemError, match="holds complex64 values, which are no elevations"):
        load_dem([write_raster(HILLS.astype(np.complex64))])


@given(st.integers(-40_000, 800_000), st.sampled_from([0.1, 0.01, 0.001]))
def test_ground_is_never_lost_to_a_scale(number, scale):
    from localizer.dem.values import HIGHEST_M, LOWEST_M, _drop_usual_voids

    z = np.full((4, 4), float(number))
    z[1:] += np.arange(12).reshape(3, 4)
    z_m = z * scale
    before = np.isfinite(z_m) & (z_m >= LOWEST_M) & (z_m <= HIGHEST_M)
    _drop_usual_voids(z, z_m)
    assert np.isfinite(z_m[before]).all()


def test_a_mask_beside_the_band_makes_voids(write_raster):
    path = write_raster(HILLS)
    with rasterio.open(path, "r+") as dataset:
        mask = np.full(HILLS.shape, 255, np.uint8)
        mask[2, 7] = 0
        dataset.write_mask(mask)
    assert np.argwhere(np.isnan(load_dem([path]).z_m)).tolist() == [[2, 7]]


# ---- bands


def two_bands(write_raster, first, second, name="two.tif", descriptions=(None, None), **profile):
    path = write_raster(first, name, bands=2, **profile)
    with rasterio.open(path, "r+") as dataset:
        dataset.write(second, 2)
        for i, text in enumerate(descriptions):
            if text:
                dataset.set_band_description(i + 1, text)
    return path


def test_several_bands_ask_which(write_raster, refused, run):
    path = two_bands(write_raster, HILLS // 100, HILLS, descriptions=("error", "elevation"))
    said = refused("dem", "info", path)
    assert "--band" in said
    assert "2 (elevation)" in said
    status, out, _ = run("dem", "info", path, "--band", "2", "--scale", "0.1")
    assert status == 0
    assert "300.0 to" in out
    assert "has no band 3" in refused("dem", "info", path, "--band", "3")


def test_an_alpha_band_is_a_mask(write_raster):
    alpha = np.full(HILLS.shape, 255, np.int16)
    alpha[0, 0] = 0
    path = two_bands(write_raster, HILLS, alpha, alpha="yes")
    dem = load_dem([path], scale=0.1)
    assert np.argwhere(np.isnan(dem.z_m)).tolist() == [[0, 0]]


def test_the_file_with_an_alpha_band_of_the_reports(skyfix_data, run):
    status, out, _ = run("dem", "info", skyfix_data / "reports/dem/alpha.tif")
    assert status == 0
    assert "2.22 % void" in out


def test_pictures_are_no_elevations(write_raster, refused):
    colours = (HILLS // 30).astype(np.uint8)
    assert "a picture in colours" in refused(
        "dem", "info", write_raster(colours, "rgb.tif", bands=3, photometric="RGB")
    )
    path = write_raster(colours, "palette.tif", photometric="palette")
    with rasterio.open(path, "r+") as dataset:
        dataset.write_colormap(1, {i: (i, i, 255, 255) for i in range(256)})
    assert "numbers of colours" in refused("dem", "info", path)


# ---- files that end too soon


def written(tmp_path, driver, name, dtype, **options):
    path = tmp_path / name
    with rasterio.open(
        path,
        "w",
        driver=driver,
        height=30,
        width=40,
        count=1,
        dtype=dtype,
        crs="EPSG:32610",
        transform=UTM,
        **options,
    ) as dataset:
        dataset.write(HILLS.astype(dtype), 1)
    return path


@pytest.mark.parametrize(
    ("driver", "name", "dtype", "options"),
    [
        ("ENVI", "dem.img", "int16", {}),
        ("EHdr", "dem.bil", "int16", {}),
        ("PCRaster", "dem.map", "float32", {"PCRASTER_VALUESCALE": "VS_SCALAR"}),
        ("AAIGrid", "dem.asc", "int32", {}),
        ("GSBG", "dem.grd", "float32", {}),
        ("SAGA", "dem.sdat", "int16", {}),
        ("ISCE", "dem.isce", "int16", {}),
        ("GTiff", "dem.tif", "int16", {}),
        ("BT", "dem.bt", "int16", {}),
        ("RST", "dem.rst", "int16", {}),
    ],
)
@pytest.mark.parametrize("kept", [0.6, 0.97])
def test_a_file_that_is_cut_short_is_refused(tmp_path, driver, name, dtype, options, kept):
    path = written(tmp_path, driver, name, dtype, **options)
    crs = {"crs": "EPSG:32610"}
    assert load_dem([path], **crs).z_m[-1, -1] == HILLS[-1, -1]
    content = path.read_bytes()
    path.write_bytes(content[: int(kept * len(content))])
    with pytest.raises(DemError) as refusal:
        load_dem([path], **crs)
    assert "\n" not in str(refusal.value)


def test_points_that_end_within_a_line_are_refused_and_missing_ones_are_voids(tmp_path):
    path = written(tmp_path, "XYZ", "dem.xyz", "int32")
    content = path.read_bytes()
    path.write_bytes(content[:-1] + b"\n")
    assert load_dem([path], crs="EPSG:32610").files[0].voids == 0
    path.write_bytes(content[:-23])  # within a number: 3462 would be 3
    with pytest.raises(DemError, match="cut short"):
        load_dem([path], crs="EPSG:32610")
    path.write_bytes(b"".join(content.splitlines(keepends=True)[:-7]))
    assert load_dem([path], crs="EPSG:32610").files[0].voids == 7


def test_a_tile_of_srtm_that_is_cut_short_is_refused(tmp_path, refused):
    path = tmp_path / "N44W072.hgt"
    path.write_bytes(np.full((1201, 1201), 500, ">i2").tobytes()[:-5000])
    refused("dem", "info", path)


def test_an_envi_file_says_how_long_it_should_be(tmp_path, refused):
    path = written(tmp_path, "ENVI", "dem.img", "int16")
    path.write_bytes(path.read_bytes()[:-2])
    assert "30 x 40 cells take 2400 bytes, it has 2398" in refused("dem", "info", path)


VRT = """<VRTDataset rasterXSize="40" rasterYSize="30"><SRS>EPSG:32610</SRS>
<GeoTransform>500000, 30, 0, 4000000, 0, -30</GeoTransform>{band}</VRTDataset>"""
VRT_SOURCE = """<VRTRasterBand dataType="Int16" band="1"><SimpleSource>
<SourceFilename relativeToVRT="1">dem.img</SourceFilename><SourceBand>1</SourceBand></SimpleSource></VRTRasterBand>"""
VRT_ARRAY = """<VRTRasterBand dataType="Int16" band="1" subClass="VRTRawRasterBand">
<SourceFilename relativeToVRT="1">dem.img</SourceFilename><ImageOffset>0</ImageOffset><PixelOffset>2</PixelOffset>
<LineOffset>80</LineOffset><ByteOrder>LSB</ByteOrder></VRTRasterBand>"""


@pytest.mark.parametrize("band", [VRT_SOURCE, VRT_ARRAY], ids=["a raster", "an array"])
def test_a_vrt_of_a_file_that_is_cut_short_is_refused(tmp_path, refused, band):
    source = written(tmp_path, "ENVI", "dem.img", "int16")
    vrt = tmp_path / "dem.vrt"
    vrt.write_text(VRT.format(band=band))
    assert load_dem([vrt]).z_m[-1, -1] == HILLS[-1, -1]
    source.write_bytes(source.read_bytes()[:-2])
    assert "30 x 40 cells take 2400 bytes, it has 2398" in refused("dem", "info", vrt)


def test_a_packed_file_that_is_cut_short_is_refused(tmp_path, refused):
    whole = gzip.compress(np.full((1201, 1201), 500, ">i2").tobytes())
    path = tmp_path / "N44W072.hgt.gz"
    path.write_bytes(whole[: len(whole) // 2])
    assert "cut short" in refused("dem", "info", path)
    assert "cut short" in refused("dem", "info", f"/vsigzip/{path}")


def test_a_damaged_archive_is_refused(tmp_path, write_raster, refused):
    path = write_raster(np.random.default_rng(1).integers(0, 900, (60, 60)).astype(np.int16))
    archive = shutil.make_archive(str(tmp_path / "packed"), "zip", tmp_path, path.name)
    with open(archive, "r+b") as file:  # noqa: PTH123
        file.seek(3000)
        file.write(b"\x00\xff" * 50)
    assert "damaged" in refused("dem", "info", archive)


def test_zeros_below_all_ground_are_still_suspected():
    z = np.full((10, 10), 500.0, np.float32)
    z[-3:] = 0.0
    assert suspect_zeros(z) == 30
