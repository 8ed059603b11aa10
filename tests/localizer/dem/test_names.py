"""What may be named as an elevation file."""

import gzip
import socket
import tarfile
import threading
import zipfile
from pathlib import Path

import numpy as np
import pytest
from scipy.io import netcdf_file

from localizer.dem.lattice import DemError, load_dem
from localizer.dem.names import beside, is_gdal_name, name_for_gdal, on_a_network


def netcdf(path: Path, *names: str) -> Path:
    """Latitudes upwards, as many have them, and no CRS."""
    with netcdf_file(str(path), "w") as file:
        file.Conventions = "CF-1.6"
        file.createDimension("lat", 40)
        file.createDimension("lon", 50)
        for name, start, count, unit in (
            ("lat", 34.0, 40, "degrees_north"),
            ("lon", -118.0, 50, "degrees_east"),
        ):
            axis = file.createVariable(name, "d", (name,))
            axis[:] = start + 0.001 * np.arange(count)
            axis.units = unit
            axis.standard_name = {"lat": "latitude", "lon": "longitude"}[name]
        for name in names:
            band = file.createVariable(name, "f", ("lat", "lon"))
            band[:] = 100.0 + np.add.outer(10.0 * np.arange(40), np.arange(50))
            band.units = "m"
    return path


def test_one_variable_of_a_netcdf_file_by_its_name(tmp_path, refused, run):
    path = netcdf(tmp_path / "two.nc", "dem", "error")
    said = refused("dem", "info", path, "--crs", "EPSG:4326")
    assert f"--dem 'netcdf:{path}:dem'" in said
    for name in (f"NETCDF:{path}:dem", f'NETCDF:"{path}":dem'):
        status, out, _ = run("dem", "info", name, "--crs", "EPSG:4326")
        assert status == 0
        assert "40 x 50" in out
    dem = load_dem([f"NETCDF:{path}:dem"], crs="EPSG:4326")
    assert dem.z_m[0, 0] == 100.0 + 390.0  # row 0 is northernmost


def test_a_netcdf_file_of_one_variable_needs_no_name(tmp_path):
    assert load_dem([netcdf(tmp_path / "one.nc", "dem")], crs="EPSG:4326").rows == 40


def test_a_variable_that_is_not_there_is_refused(tmp_path, refused):
    path = netcdf(tmp_path / "two.nc", "dem", "error")
    refused("dem", "info", f"NETCDF:{path}:depth", "--crs", "EPSG:4326")
    assert "no such file" in refused("dem", "info", f"NETCDF:{tmp_path}/none.nc:dem")


def test_packed_files_by_their_own_names(tmp_path, write_raster, ramp, refused):
    plain = write_raster(ramp)
    packed = tmp_path / "dem.tif.gz"
    packed.write_bytes(gzip.compress(plain.read_bytes()))
    archive, several = tmp_path / "one.zip", tmp_path / "two.zip"
    with zipfile.ZipFile(archive, "w") as file:
        file.write(plain, "tiles/dem.tif")
        file.writestr("readme.txt", "about it")
    with zipfile.ZipFile(several, "w") as file:
        file.write(plain, "a.tif")
        file.write(plain, "b.tif")
    names = [
        packed,
        f"/vsigzip/{packed}",
        archive,
        f"/vsizip/{archive}/tiles/dem.tif",
        f"/vsizip/{several}/b.tif",
        f"zip://{several}!b.tif",
        f"GTIFF_DIR:1:{plain}",
    ]
    for name in names:
        assert np.array_equal(load_dem([name]).z_m, ramp), name
        assert np.array_equal(load_dem([Path(name)]).z_m, ramp), name  # which has lost doubled slashes
    said = refused("dem", "info", several)
    assert "holds 2 files" in said
    assert "/b.tif" in said


@pytest.mark.parametrize("suffix", [".hgt.zip", ".SRTMGL1.hgt.zip"])
def test_a_zipped_tile_of_srtm_is_as_long_as_what_is_in_it(tmp_path, refused, suffix):
    path = tmp_path / f"N44W072{suffix}"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("N44W072.hgt", np.full((1201, 1201), 500, ">i2").tobytes())
    assert load_dem([path]).z_m[0, 0] == 500.0
    content = bytearray(path.read_bytes())
    content[1500] ^= 0xFF
    path.write_bytes(content)
    assert "damaged or cut short" in refused("dem", "info", path)


def test_archives_by_relative_names(tmp_path, write_raster, ramp, refused, monkeypatch):
    plain = write_raster(ramp)
    with zipfile.ZipFile(tmp_path / "one.zip", "w") as file:
        file.write(plain, "tiles/dem.tif")
    for name, members in (("one.tar.gz", ("dem.tif",)), ("two.tgz", ("a.tif", "b.tif"))):
        with tarfile.open(tmp_path / name, "w:gz") as archive:
            for member in members:
                archive.add(plain, member)
    monkeypatch.chdir(tmp_path)
    for name in (
        "zip://one.zip!tiles/dem.tif",
        "zip://one.zip!/tiles/dem.tif",
        "one.tar.gz",
        "tar://two.tgz!b.tif",
    ):
        assert np.array_equal(load_dem([Path(name)]).z_m, ramp), name
    said = refused("dem", "info", "two.tgz")
    assert "holds 2 files" in said
    assert "--dem '/vsitar/two.tgz/b.tif'" in said


def test_a_packed_tile_of_srtm_knows_its_place_by_its_name(tmp_path):
    path = tmp_path / "N44W072.hgt.gz"
    path.write_bytes(gzip.compress(np.full((1201, 1201), 500, ">i2").tobytes(), 1))
    dem = load_dem([path])
    assert dem.crs.to_epsg() == 4326
    assert dem.transform.f == pytest.approx(45.0, abs=0.001)


@pytest.mark.parametrize(
    "name",
    [
        "https://example.org/dem.tif",
        "http://example.org/dem.tif",
        "ftp://example.org/dem.tif",
        "s3://bucket/dem.tif",
        "gs://bucket/dem.tif",
        "az://container/dem.tif",
        "zip+https://example.org/dem.zip!a.tif",
        "/vsicurl/https://example.org/dem.tif",
        "/vsicurl_streaming/http://example.org/dem.tif",
        "/vsis3/bucket/dem.tif",
        "/vsigs/bucket/dem.tif",
        "/vsiaz/container/dem.tif",
        "/vsizip//vsicurl/https://example.org/dem.zip/a.tif",
        "/vsizip/vsicurl/https://example.org/dem.zip/a.tif",
        'NETCDF:"/vsicurl/https://example.org/dem.nc":dem',
        "WMS:https://example.org/wms",
        "WMTS:https://example.org/wmts",
        "<GDAL_WMS><Service/></GDAL_WMS>",
    ],
)
def test_nothing_is_downloaded(name, refused, bundle_dir):
    assert on_a_network(str(Path(name)))
    said = refused("dem", "info", name)
    assert "nothing is downloaded" in said
    assert "nothing is downloaded" in refused("locate", bundle_dir, "--dem", name)


def test_a_local_file_that_leads_to_a_network_asks_nothing_of_it(tmp_path, refused):
    asked = []
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(0.1)
        port = server.getsockname()[1]
        stop = threading.Event()

        def listen() -> None:
            while not stop.is_set():
                try:
                    connection, _ = server.accept()
                except TimeoutError:
                    continue
                asked.append(connection)
                connection.close()

        listener = threading.Thread(target=listen)
        listener.start()
        vrt = tmp_path / "far.vrt"
        vrt.write_text(
            '<VRTDataset rasterXSize="20" rasterYSize="20"><SRS>EPSG:32610</SRS>'
            "<GeoTransform>560000,30,0,5120000,0,-30</GeoTransform>"
            '<VRTRasterBand dataType="Int16" band="1"><SimpleSource>'
            f'<SourceFilename relativeToVRT="0">/vsicurl/http://127.0.0.1:{port}/dem.tif</SourceFilename>'
            "<SourceBand>1</SourceBand></SimpleSource></VRTRasterBand></VRTDataset>"
        )
        refused("dem", "info", vrt)
        stop.set()
        listener.join()
    assert asked == []


def test_standard_input_is_no_elevation_file(refused):
    assert "standard input" in refused("dem", "info", "/vsistdin/")


def test_a_configuration_s_names_are_taken_from_its_folder(tmp_path):
    netcdf(tmp_path / "two.nc", "dem")
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as file:
        file.writestr("dem.tif", b"")
    assert beside(tmp_path, Path("terrain.tif")) == tmp_path / "terrain.tif"
    assert str(beside(tmp_path, Path("NETCDF:two.nc:dem"))) == f"NETCDF:{tmp_path}/two.nc:dem"
    named = beside(tmp_path, Path("/vsizip/a.zip/dem.tif"))
    assert name_for_gdal(named) == f"/vsizip/{tmp_path}/a.zip/dem.tif"
    assert on_a_network(str(beside(tmp_path, Path("https://example.org/dem.tif"))))


def test_a_colon_in_a_file_s_name_is_no_driver(tmp_path, write_raster, ramp, monkeypatch):
    write_raster(ramp, "tile:1.tif")
    monkeypatch.chdir(tmp_path)
    assert not is_gdal_name("tile:1.tif")
    assert np.array_equal(load_dem([Path("tile:1.tif")]).z_m, ramp)


def test_what_no_driver_knows_is_one_line(refused):
    assert "no such file" in refused("dem", "info", "NONSENSE:somewhere:else")


def test_a_library_s_caller_gets_a_named_error():
    with pytest.raises(DemError):
        load_dem(["/vsizip/none.zip/dem.tif"])
