"""Opening of an elevation file, after checks: it exists, is local, is one raster, and is complete."""

import gzip
import re
import tarfile
import warnings
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree

import numpy as np

from localizer.dem.names import NETWORK_DRIVERS, container, is_gdal_name, name_for_gdal, on_a_network
from localizer.errors import SkyfixError
from localizer.os_errors import meant_instead

if TYPE_CHECKING:
    from rasterio import DatasetReader

MOST_NAMED = 8
"""Members of a file that an error message lists at most."""
RAW_DRIVERS = {
    "ENVI": 0,
    "PCRaster": 256,
    "EHdr": 0,
    "SRTMHGT": 0,
    "BT": 256,
    "GSBG": 56,
    "ISCE": 0,
    "ROI_PAC": 0,
}
"""Drivers of uncompressed arrays, with the least size of their header in bytes; some read zeros beyond the end of a file."""
PIECE = 1 << 20
ON_A_NETWORK = "lies on a network, and nothing is downloaded; fetch the file and name that"
NO_NETWORK = {
    "GDAL_HTTP_PROXY": "127.0.0.1:9",
    "GDAL_HTTP_CONNECTTIMEOUT": "1",
    "CPL_VSIL_CURL_ALLOWED_EXTENSIONS": ".nothing-is-downloaded",
    "GDAL_DISABLE_READDIR_ON_OPEN": "FALSE",
}
"""GDAL options against network access: a local VRT may refer to a remote source."""


class DemError(SkyfixError):
    """A DEM that cannot be used: what is wrong, in which file, and what to do."""


@contextmanager
def opened(path: Path) -> Iterator["DatasetReader"]:
    """The one raster that ``path`` names. Raises ``DemError``, also for what goes wrong while it is read."""
    # imported here to save memory: a daemon that searches in another process does not need GDAL
    import rasterio
    from rasterio.errors import NotGeoreferencedWarning, RasterioError

    try:
        name = _checked_name(path)
    except (OSError, ValueError) as error:  # a name that no file can have
        raise DemError(f"{str(path)[:200]}: {getattr(error, 'strerror', None) or error}") from None
    try:
        with warnings.catch_warnings(), rasterio.Env(GTIFF_REPORT_COMPD_CS=True, **NO_NETWORK):
            warnings.simplefilter("ignore", NotGeoreferencedWarning)  # reported by _check_layout
            with rasterio.open(name) as dataset:
                if dataset.driver in NETWORK_DRIVERS:
                    raise DemError(f"{path}: {ON_A_NETWORK}")
                parts = dataset.subdatasets
                if dataset.count or not parts:
                    _check_complete(dataset, path)
                    yield dataset
                    return
            if len(parts) > 1:
                raise DemError(f"{path}: holds {len(parts)} rasters; name one of them, as {_listed(parts)}")
            with rasterio.open(parts[0]) as dataset:
                _check_complete(dataset, path)
                yield dataset
    except RasterioError as error:
        raise DemError(f"{path}: not an elevation raster that can be read ({_reason(error, path)})") from None


def _checked_name(path: Path) -> str:
    text = str(path)
    if on_a_network(text):
        shown = re.sub(r"(?<=\w):/(?!/)", "://", text)  # a Path has one slash of two
        raise DemError(f"{shown}: {ON_A_NETWORK}")
    if text.lstrip().startswith("<"):  # GDAL takes a whole VRT for a name
        raise DemError(f"{text[:40]}...: is no file; write it into one and name that")
    if "vsistdin" in text:
        raise DemError(f"{path}: is standard input, not an elevation file; name a file")
    if not is_gdal_name(text):
        if not path.exists():
            raise DemError(f"{path}: no such file{meant_instead(path)}")
        if path.is_dir() and not (path / "hdr.adf").exists() and not _holds_a_raster(path):
            raise DemError(f"{path}: is a directory, not an elevation file")
        if not path.is_file() and not path.is_dir():  # opening it would block
            raise DemError(f"{path}: is a pipe or a device, not an elevation file")
    name = name_for_gdal(path)
    file = container(name)
    if file is None and "vsimem" not in name and is_gdal_name(text):
        raise DemError(f"{path}: no such file")
    if file is not None and (name != text or is_gdal_name(text) or file.suffix.lower() == ".zip"):
        _check_packed(path, file)
        for prefix, members in (("/vsizip/", _members_of_zip), ("/vsitar/", _members_of_tar)):
            if name.lower() == f"{prefix}{file}".lower():
                return _only_member(path, members(file), name)
    return name


def _holds_a_raster(folder: Path) -> bool:
    """Whether a folder is a raster: Zarr, Arc/Info grids, Sentinel products."""
    return any((folder / name).exists() for name in (".zarray", ".zgroup", ".zmetadata", "zarr.json"))


def _check_packed(path: Path, file: Path) -> None:
    """Verify checksums of compressed files: GDAL reads zeros beyond the end of a truncated one."""
    try:
        if zipfile.is_zipfile(file):
            with zipfile.ZipFile(file) as archive:
                broken = archive.testzip()
            if broken is not None:
                raise DemError(f"{path}: {broken} in it is damaged or cut short; fetch it anew")
        elif file.suffix.lower() in (".gz", ".tgz"):
            with gzip.open(file) as stream:
                while stream.read(PIECE):
                    pass
    except (EOFError, OSError, zlib.error, zipfile.BadZipFile, RuntimeError, NotImplementedError) as error:
        what = getattr(error, "strerror", None) or error
        raise DemError(f"{path}: is damaged or cut short ({what}); fetch it anew") from None


def _members_of_zip(file: Path) -> list[str]:
    with zipfile.ZipFile(file) as archive:
        return [m for m in archive.namelist() if not m.endswith("/")]


def _members_of_tar(file: Path) -> list[str]:
    with tarfile.open(file) as archive:
        return [m.name for m in archive if m.isfile()]


def _only_member(path: Path, members: list[str], name: str) -> str:
    """The name of the only raster in an archive."""
    rasters = [m for m in members if m.lower().endswith(_SUFFIXES)] or members
    if len(rasters) != 1:
        raise DemError(
            f"{path}: holds {len(rasters)} files; name one of them, as "
            + _listed([f"{name}/{member}" for member in rasters])
        )
    return f"{name}/{rasters[0]}"


_SUFFIXES = (
    ".tif",
    ".tiff",
    ".hgt",
    ".asc",
    ".img",
    ".dem",
    ".bil",
    ".flt",
    ".dt0",
    ".dt1",
    ".dt2",
    ".nc",
    ".vrt",
    ".ddf",
    ".map",
)


def _check_complete(dataset: "DatasetReader", path: Path) -> None:
    """Raise ``DemError`` for a file shorter than its header says: the rest would be read as zeros."""
    if dataset.count == 0:
        return
    if dataset.driver == "XYZ":
        _check_points(dataset, path)
    if dataset.driver == "VRT":
        _check_sources(dataset, path)
    least = RAW_DRIVERS.get(dataset.driver)
    if dataset.driver == "PCIDSK" and dataset.compression is None and not dataset.is_tiled:
        least = 1024
    if least is None or _is_packed(dataset):
        return
    files = [Path(file) for file in dataset.files if Path(file).is_file()]
    if not files:
        return
    offset = dataset.tags(ns="ENVI").get("header_offset", "0") if dataset.driver == "ENVI" else str(least)
    start = int(offset) if offset.strip().isdigit() else 0
    rows, cols = dataset.shape
    needed = start + sum(np.dtype(dtype).itemsize for dtype in dataset.dtypes) * rows * cols
    held = max(file.stat().st_size for file in files)
    if held < needed:
        raise _cut_short(path, rows, cols, needed, held)


def _check_sources(dataset: "DatasetReader", path: Path) -> None:
    """Check the sources of a VRT: rasters, and raw arrays that only the VRT describes."""
    import rasterio
    from rasterio.errors import RasterioError

    for name in dataset.files:
        if Path(name) == Path(dataset.name) or not Path(name).is_file():
            continue
        with suppress(RasterioError), rasterio.open(name) as source:  # a plain array is no raster
            _check_complete(source, path)
    if not Path(dataset.name).is_file():
        return
    with suppress(ElementTree.ParseError, ValueError):  # GDAL takes what is no XML in the strict sense
        for band in ElementTree.parse(dataset.name).iter("VRTRasterBand"):
            if band.get("subClass") == "VRTRawRasterBand":
                _check_array(band, dataset, path)


def _check_array(band: ElementTree.Element, dataset: "DatasetReader", path: Path) -> None:
    named = band.find("SourceFilename")
    if named is None or not named.text:
        return
    file = Path(dataset.name).parent / named.text if named.get("relativeToVRT") == "1" else Path(named.text)
    offset, pixel, line = (
        int(band.findtext(key) or 0) for key in ("ImageOffset", "PixelOffset", "LineOffset")
    )
    rows, cols = dataset.shape
    size = np.dtype(dataset.dtypes[int(band.get("band") or 1) - 1]).itemsize
    needed = offset + max(line, 0) * (rows - 1) + max(pixel, 0) * (cols - 1) + size
    if file.is_file() and file.stat().st_size < needed:
        raise _cut_short(path, rows, cols, needed, file.stat().st_size)


def _cut_short(path: Path, rows: int, cols: int, needed: int, held: int) -> DemError:
    return DemError(
        f"{path}: is cut short: {rows} x {cols} cells take {needed} bytes, it has {held}; fetch it anew"
    )


def _is_packed(dataset: "DatasetReader") -> bool:
    packed = dataset.tags(ns="ENVI").get("file_compression", "0").strip() not in ("", "0")
    return packed or dataset.name.startswith("/vsi") or Path(dataset.name).suffix.lower() == ".zip"


def _check_points(dataset: "DatasetReader", path: Path) -> None:
    """A text file of grid points may omit cells; one that ends within a line is truncated."""
    rows, cols = dataset.shape
    if not Path(dataset.name).is_file():
        return
    text = Path(dataset.name).read_bytes()
    lines = text.count(b"\n")
    if text and not text.endswith(b"\n") and lines + 1 < rows * cols:
        raise DemError(
            f"{path}: is cut short: it ends within line {lines + 1} of {rows * cols}; fetch it anew"
        )


def _listed(names: list[str]) -> str:
    more = f" and {len(names) - MOST_NAMED} more" if len(names) > MOST_NAMED else ""
    return ", ".join(f"--dem '{name}'" for name in names[:MOST_NAMED]) + more


def _reason(error: Exception, path: Path) -> str:
    """GDAL's message; the cause of a failed read is in the preceding exception."""
    cause = error.__cause__
    text = str(cause) if cause is not None and "previous exception" in str(error) else str(error)
    return " ".join(text.split()) or f"GDAL does not say why of {path}"
