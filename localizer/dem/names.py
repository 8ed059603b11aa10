"""Names of elevation files: paths, compressed files, and GDAL's own names; network sources are refused.

``NETCDF:terrain.nc:dem``, ``/vsizip/terrain.zip/dem.tif``, ``zip://terrain.zip!dem.tif`` and ``N44W072.hgt.gz`` are taken. A
``Path`` has lost doubled slashes on the way here, which tell an absolute path within a ``/vsi`` name: they are put back.
"""

import re
from pathlib import Path, PurePath

NETWORK_DRIVERS = frozenset(("WMS", "WMTS", "WCS", "HTTP", "OGCAPI", "STACIT", "STACTA", "EEDA")) | frozenset(
    ("EEDAI", "DAAS", "PLMOSAIC", "PLSCENES", "NGW", "RASDAMAN", "PostGISRaster")
)
"""Drivers of GDAL that access a network."""

_ON_A_NETWORK = re.compile(
    r"/vsi(curl|s3|gs|az|adls|oss|swift|hdfs|webhdfs)(_streaming)?\b"
    r"|\b(https?|ftps?|s3|gs|gcs|az|azure|adl|abfss?|oss|swift|hdfs|webhdfs):/"
    r"|^(wms|wmts|wcs|ogcapi|pg|postgresql|stacit|stacta|eeda|eedai|daas|plmosaic|plscenes|ngw):"
    r"|<(gdal_wm[st]|wcs_gdal|gdal_wmts)",
    re.IGNORECASE,
)
_VSI = re.compile(r"^/vsi(?P<kind>zip|gzip|tar|7z|rar|subfile|sparse|mem|stdin)(?P<rest>/.*)?", re.IGNORECASE)
_SCHEME = re.compile(r"^(?P<scheme>(?:zip|tar|gzip|file)(?:\+file)?):/(?P<rest>.*)$", re.IGNORECASE)
_DRIVER_PREFIX = re.compile(r"^[A-Za-z][A-Za-z0-9_]+:")


def on_a_network(name: str) -> bool:
    """Whether GDAL would access a network for it."""
    return _ON_A_NETWORK.search(name) is not None


def is_gdal_name(name: str) -> bool:
    """Whether this is not a path but a name that GDAL parses."""
    if _VSI.match(name) or _SCHEME.match(name):
        return True
    return _DRIVER_PREFIX.match(name) is not None and not Path(name).exists()


def name_for_gdal(path: PurePath | str) -> str:
    """The name that GDAL opens for a user's path."""
    name = str(path)
    scheme = _SCHEME.match(name)
    if scheme:  # a Path keeps one slash of two, and two of three
        archive, *member = scheme["rest"].lstrip("/").split("!")
        # absolute, because the part after two slashes is taken for a server's name
        path = (
            Path(archive)
            if Path(archive).exists() or not Path(f"/{archive}").exists()
            else Path(f"/{archive}")
        )
        return "!".join((f"{scheme['scheme']}://{path.absolute()}", *member))
    packed = _VSI.match(name)
    if packed:
        return _absolute_again(name)
    if not is_gdal_name(name):
        suffix = name.lower()
        if suffix.endswith((".tar.gz", ".tgz", ".tar")):
            return f"/vsitar/{name}"
        if suffix.endswith(".gz"):
            return f"/vsigzip/{name}"
        if suffix.endswith(".zip") and not suffix.endswith(".hgt.zip"):
            return f"/vsizip/{name}"
    return name


def container(name: str) -> Path | None:
    """The local file that a GDAL name refers to; None if there is none."""
    bare = re.sub(r"^(?:/vsi(?:zip|gzip|tar|7z|rar)/)+", "", name, flags=re.IGNORECASE)
    scheme = _SCHEME.match(bare)
    if scheme:
        bare = scheme["rest"].lstrip("/") if not scheme["rest"].startswith("//") else scheme["rest"][1:]
        bare = bare.split("!")[0]
    if bare == name and is_gdal_name(name):
        return next((p for part in _parts(name) if (p := Path(part)).is_file()), None)
    path = Path(bare.strip("{}"))
    return next((p for p in (path, *path.parents) if p.is_file()), None)


def beside(folder: Path, path: Path) -> Path:
    """A relative name in a configuration, resolved against its folder."""
    name = str(path)
    if on_a_network(name) or not is_gdal_name(name):
        return path if on_a_network(name) else folder / path
    for part in _parts(name):
        if part and not part.startswith("/") and (folder / part).is_file():
            return Path(name.replace(part, str(folder / part), 1))
    packed = _VSI.match(name)
    inner = (packed["rest"] or "").lstrip("/") if packed else ""
    if inner and any((folder / p).is_file() for p in (Path(inner), *Path(inner).parents[:-1])):
        return Path(name.replace(inner, str(folder / inner), 1))
    return path


def _parts(name: str) -> list[str]:
    """The file's part of ``DRIVER:file:layer``, in quotes or not."""
    quoted = re.findall(r'"([^"]+)"', name)
    return quoted + name.split(":")[1:]


def _absolute_again(name: str) -> str:
    """Restore the slash of an absolute path: ``/vsizip/data/a.zip/x`` becomes ``/vsizip//data/a.zip/x`` if only that exists."""
    prefix = re.match(r"^(?:/vsi[a-z0-9]+)+/?", name, re.IGNORECASE)
    if prefix is None or prefix.end() >= len(name):
        return name
    head, rest = name[: prefix.end()].rstrip("/") + "/", name[prefix.end() :].lstrip("/")
    path = Path(rest)
    here = any(p.is_file() for p in (path, *path.parents))
    there = any(p.is_file() for p in (Path("/") / path, *(Path("/") / path).parents))
    return f"{head}/{rest}" if there and not here else f"{head}{rest}"
