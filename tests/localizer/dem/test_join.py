"""Files of one DEM that lie on different lattices, side by side."""

import numpy as np
import pytest
import rasterio
from affine import Affine

from localizer.dem.geodesy import rowcol_to_lonlat
from localizer.dem.lattice import DemError, load_dem

SECOND = 1.0 / 3600.0


def plane(lon_deg, lat_deg):
    """A slope without bends, which bilinear surfaces have in common whatever their lattice."""
    return 1000.0 + 4000.0 * (lon_deg + 118.0) + 3000.0 * (lat_deg - 34.0)


@pytest.fixture
def tile(tmp_path):
    def write(name, west, north, rows, cols, dx=SECOND, dy=SECOND, crs="EPSG:4326"):
        lon, lat = west + dx * np.arange(cols), north - dy * np.arange(rows)
        z = plane(lon[None, :], lat[:, None]).astype(np.float32)
        path = tmp_path / name
        grid = Affine(dx, 0.0, west - dx / 2, 0.0, -dy, north + dy / 2)
        with rasterio.open(
            path,
            "w",
            driver="GTiff",
            height=rows,
            width=cols,
            count=1,
            dtype="float32",
            crs=crs,
            transform=grid,
        ) as dataset:
            dataset.write(z, 1)
        return path

    return write


def off_plane(dem):
    row, col = np.meshgrid(np.arange(dem.rows), np.arange(dem.cols), indexing="ij")
    return np.abs(dem.z_m - plane(*rowcol_to_lonlat(dem, row, col)))


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_tiles_that_grow_wider_towards_the_pole_are_one_surface(tile, order):
    """As Copernicus GLO-30 has them at 50 degrees: 1 and 1.5 arc seconds."""
    paths = [
        tile("south.tif", -118.0, 34.0, 60, 90),
        tile("north.tif", -118.0, 34.0 + 60 * SECOND, 60, 60, dx=1.5 * SECOND),
    ]
    dem = load_dem([paths[i] for i in order])
    assert dem.z_m.shape == (120, 90)
    assert off_plane(dem).max() < 1e-3
    assert "north.tif: lies on another lattice than" in dem.joined_notes[0]


def test_several_tiles_of_each_kind(tile):
    paths = [
        tile("sw.tif", -118.0, 34.0, 60, 90),
        tile("se.tif", -118.0 + 90 * SECOND, 34.0, 60, 90),
        tile("nw.tif", -118.0, 34.0 + 60 * SECOND, 60, 60, dx=1.5 * SECOND),
        tile("ne.tif", -118.0 + 90 * SECOND, 34.0 + 60 * SECOND, 60, 60, dx=1.5 * SECOND),
    ]
    dem = load_dem(paths)
    assert dem.z_m.shape == (120, 180)
    assert off_plane(dem).max() < 1e-3


def test_it_is_said_on_standard_output_of_dem_info(tile, run):
    south, north = (
        tile("s.tif", -118.0, 34.0, 60, 90),
        tile("n.tif", -118.0, 34.0 + 60 * SECOND, 60, 60, dx=1.5 * SECOND),
    )
    status, out, _ = run("dem", "info", south, north)
    assert status == 0
    assert "was continued onto that" in out


def test_wgs84_beside_nad83(tile):
    dem = load_dem(
        [
            tile("west.tif", -118.0, 34.0, 60, 60),
            tile("east.tif", -118.0 + 60 * SECOND, 34.0, 60, 60, crs="EPSG:4269"),
        ]
    )
    assert dem.crs.to_epsg() == 4326
    assert dem.z_m.shape == (60, 120)
    assert off_plane(dem).max() < 1e-3


def test_nad27_beside_wgs84_is_moved_to_where_it_lies(tile):
    """80 m to the west of where its numbers would put it: three cells."""
    west, east = (
        tile("w.tif", -118.0, 34.0, 60, 60),
        tile("e.tif", -118.0 + 57 * SECOND, 34.0, 60, 60, crs="EPSG:4267"),
    )
    dem = load_dem([west, east])
    moved = dem.z_m[30, 61:110] - plane(*rowcol_to_lonlat(dem, np.full(49, 30.0), np.arange(61.0, 110.0)))
    # what is 3 cells farther east on the slope is met here: 4000 m a degree
    assert 2.0 < float(np.nanmedian(moved)) < 5.0


def test_utm_zones_side_by_side(write_raster):
    """A tile of zone 11 beside one of zone 10, whose axes run 3.4 degrees apart."""
    from pyproj import Transformer

    z = np.full((60, 60), 500.0, np.float32)
    x, y = Transformer.from_crs(4326, 32610, always_xy=True).transform(-120.0, 37.0)
    west = write_raster(z, "w.tif", crs="EPSG:32610", transform=Affine(30.0, 0, x - 1800, 0, -30.0, y))
    x, y = Transformer.from_crs(4326, 32611, always_xy=True).transform(-120.0, 37.0)
    east = write_raster(z + 100, "e.tif", crs="EPSG:32611", transform=Affine(30.0, 0, x - 60, 0, -30.0, y))
    dem = load_dem([west, east])
    assert dem.z_m[30, 10] == 500.0
    assert dem.z_m[30, 100] == 600.0


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_where_files_on_different_lattices_overlap_the_first_counts(tile, order):
    """Rows 51 to 59 of the northern tile and 0 to 8 of the southern one; the northern one is 100 m higher."""
    south = tile("south.tif", -118.0, 34.0, 60, 90)
    north = tile("north.tif", -118.0, 34.0 + 51 * SECOND, 60, 60, dx=1.5 * SECOND)
    with rasterio.open(north, "r+") as dataset:
        dataset.write(dataset.read(1) + 100.0, 1)
    paths = [south, north]
    dem = load_dem([paths[i] for i in order])
    row, col = np.meshgrid(np.arange(dem.rows), np.arange(1, 88), indexing="ij")
    higher_m = (dem.z_m[:, 1:88] - plane(*rowcol_to_lonlat(dem, row, col))).mean(axis=1)
    assert higher_m[:51] == pytest.approx(np.full(51, 100.0), abs=0.01)
    assert higher_m[51:60] == pytest.approx(np.full(9, 100.0 if order[0] == 1 else 0.0), abs=0.01)
    assert higher_m[60:] == pytest.approx(np.zeros(len(higher_m) - 60), abs=0.01)


def test_a_void_stays_one(tile):
    south, north = (
        tile("s.tif", -118.0, 34.0, 60, 90),
        tile("n.tif", -118.0, 34.0 + 60 * SECOND, 60, 60, dx=1.5 * SECOND),
    )
    with rasterio.open(north, "r+") as dataset:
        z = dataset.read(1)
        z[20, 20] = np.nan
        dataset.write(z, 1)
    dem = load_dem([south, north])
    assert 1 <= np.count_nonzero(np.isnan(dem.z_m)) <= 4
    assert np.isnan(dem.z_m[20, 30])


def test_two_surfaces_over_each_other_are_refused_with_the_exact_command(tile):
    fine, coarse = (
        tile("fine.tif", -118.0, 34.0, 60, 60),
        tile("coarse.tif", -118.0, 34.0, 30, 30, dx=2 * SECOND, dy=2 * SECOND),
    )
    with pytest.raises(DemError, match="gdalwarp -t_srs EPSG:4326 -tr ") as refusal:
        load_dem([fine, coarse])
    text = str(refusal.value)
    assert "-te " in text
    assert f"{coarse} coarse_resampled.tif" in text
    assert "\n" not in text


def test_the_command_puts_a_file_on_the_lattice(tile, tmp_path):
    from rasterio.warp import Resampling, reproject

    fine, coarse = (
        tile("fine.tif", -118.0, 34.0, 60, 60),
        tile("coarse.tif", -118.0, 34.0, 30, 30, dx=2 * SECOND, dy=2 * SECOND),
    )
    with pytest.raises(DemError) as refusal:
        load_dem([fine, coarse])
    words = str(refusal.value).split("gdalwarp ")[1].split()
    dx, dy = (float(v) for v in words[words.index("-tr") + 1 :][:2])
    west, south, east, north = (float(v) for v in words[words.index("-te") + 1 :][:4])
    rows, cols = round((north - south) / dy), round((east - west) / dx)
    out = np.full((rows, cols), np.nan, np.float32)
    grid = Affine(dx, 0, west, 0, -dy, north)
    with rasterio.open(coarse) as dataset:
        reproject(
            dataset.read(1),
            out,
            src_transform=dataset.transform,
            src_crs=dataset.crs,
            dst_transform=grid,
            dst_crs=dataset.crs,
            dst_nodata=np.nan,
            resampling=Resampling.bilinear,
        )
    path = tmp_path / "coarse_resampled.tif"
    with rasterio.open(
        path,
        "w",
        driver="GTiff",
        height=rows,
        width=cols,
        count=1,
        dtype="float32",
        crs="EPSG:4326",
        transform=grid,
    ) as dataset:
        dataset.write(out, 1)
    assert load_dem([fine, path]).joined_notes == ()


def test_files_far_apart_are_no_dem(tile):
    with pytest.raises(DemError, match="no overlap"):
        load_dem([tile("a.tif", -118.0, 34.0, 60, 60), tile("b.tif", -117.0, 34.0, 40, 40, dx=1.5 * SECOND)])
