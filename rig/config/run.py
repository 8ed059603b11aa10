"""``[run]`` of the configuration: triggers, search, spool and publishers of the daemon."""

import re
from pathlib import Path
from typing import Annotated, Literal, Self, get_args

from pydantic import AfterValidator, Field, ValidationError, model_validator

from localizer.dem.choice import DemChoice
from localizer.dem.names import beside
from localizer.dem.units import VERTICAL_UNITS
from localizer.documents import DocumentError, read_toml
from rig.config.section import Section


def _host_port(text: str) -> str:
    matched = re.fullmatch(r"([^\s:\[\]]+|\[[0-9a-fA-F:.]+\]):(\d{1,5})", text)
    if not matched or int(matched[2]) > 65535:
        raise ValueError(f"{text!r} is no address; give HOST:PORT, for example 127.0.0.1:10110")
    return text


def _vertical_unit(name: str) -> str:
    if name not in VERTICAL_UNITS:
        raise ValueError(f"{name!r} is no unit of elevations; give one of {', '.join(VERTICAL_UNITS)}")
    return name


def host_and_port(address: str) -> tuple[str, int]:
    """The parts of a ``HostPort``."""
    host, _, port = address.rpartition(":")
    return host.strip("[]"), int(port)


HostPort = Annotated[str, AfterValidator(_host_port)]
"""``HOST:PORT`` or ``[IPV6]:PORT``; port 0 lets the system choose where the daemon listens."""
Seconds = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
OptionalSeconds = Annotated[float, Field(gt=0.0, allow_inf_nan=False)] | None
Files = Annotated[tuple[Annotated[Path, Field(strict=False)], ...], Field(strict=False, min_length=1)]
Addresses = Annotated[tuple[HostPort, ...], Field(strict=False)]


class RestTrigger(Section):
    """``[run.rest]``: a capture whenever the vehicle has come to rest after it moved."""

    still_s: Seconds = 10.0
    """The vehicle is at rest once it has been still for this long."""
    still_mg: Annotated[float, Field(gt=0.0, le=1000.0)] = 5.0
    """It is still while the accelerometer's standard deviation over a second is below this."""


class OdometryInput(Section):
    """``[run.odometry]``: how the vehicle moved between captures, over UDP: NMEA VTG or RMC, or JSON legs."""

    listen: HostPort = "127.0.0.1:10111"
    """Address to listen on, ``HOST:PORT``."""
    speed_sigma_share: Annotated[float, Field(gt=0.0, le=1.0)] = 0.03
    """One standard deviation of a distance, as a share of it."""
    heading_sigma_deg: Annotated[float, Field(gt=0.0, le=180.0)] = 3.0
    """One standard deviation of a course."""
    require_checksum: bool = True
    """Whether an NMEA sentence without a checksum is refused; UDP has a checksum of its own."""
    accept_estimated: bool = False
    """Whether a speed of mode E (dead reckoning) counts. Wheels and gyros give it, but so does a receiver that guesses."""


class SearchLimits(Section):
    """``[run.search]``: limits of one search; beyond them it is ended as failed."""

    memory_mb: Annotated[int, Field(ge=256)] = 3000
    """A search that holds more memory is ended, tried once more, and then counts as failed."""
    time_s: Seconds = 120.0
    """A search that takes longer is ended likewise."""


class SpoolSection(Section):
    """``[run.spool]``: folder and quota of the spool of bundles and fixes."""

    dir: Annotated[Path, Field(strict=False)] = Path("spool")
    """Folder of the bundles and the index of their answers; as a service ``/var/lib/skyfix/spool``."""
    quota_mb: Annotated[int, Field(ge=10)] = 2000
    """Beyond this the oldest located bundles are deleted; others never."""


SentenceKind = Literal["ZDA", "RMC", "GGA", "GBS", "GST", "HDT", "GLL"]


class NmeaOutput(Section):
    """``[run.nmea]``: NMEA 0183 for gpsd, plotters and QGIS."""

    tcp: HostPort | None = "127.0.0.1:10110"
    """Address to serve sentences on, ``HOST:PORT``."""
    udp: Addresses = ()
    """Addresses that sentences are sent to."""
    every_s: Annotated[float, Field(ge=0.1, le=60.0)] = 1.0
    """Time from one set of sentences to the next."""
    valid_s: Seconds = 30.0
    """A fix is current for this long after its capture; then the quality is 0 until the next."""
    quality: Literal[1, 6] = 6
    """GGA quality of a fix: 6, estimated, or 1, GPS, for programs that accept nothing else."""
    sentences: Annotated[tuple[SentenceKind, ...], Field(strict=False, min_length=1)] = get_args(SentenceKind)
    """Sentences that are sent."""


class MavlinkOutput(Section):
    """``[run.mavlink]``: positions for ArduPilot."""

    connection: Annotated[str, Field(min_length=1)]
    """A pymavlink connection string: ``udpout:127.0.0.1:14550``, ``/dev/ttyACM0``, ..."""
    baud: Annotated[int, Field(ge=300)] = 115200
    """Baud rate of a serial port."""
    messages: Annotated[
        tuple[Literal["EXTERNAL_POSITION_ESTIMATE", "GPS_INPUT"], ...], Field(strict=False, min_length=1)
    ] = ("EXTERNAL_POSITION_ESTIMATE",)
    """Messages that are sent."""
    valid_s: Seconds = 30.0
    """A fix that is answered later than this after its capture is not sent."""
    system_id: Annotated[int, Field(ge=1, le=255)] = 1
    """MAVLink's system id."""
    component_id: Annotated[int, Field(ge=1, le=255)] = 197
    """MAVLink's component id."""


class HttpServer(Section):
    """``[run.http]``: the web page and the HTTP API."""

    listen: HostPort = "127.0.0.1:8080"
    """Address to serve on, ``HOST:PORT``."""
    token_file: Annotated[Path | None, Field(strict=False)] = None
    """Holds the token that a request has to show which acts; without one nothing can be done over HTTP, only read."""
    names: Annotated[tuple[str, ...], Field(strict=False)] = ()
    """Names that the machine may be asked by beside its host name, localhost and addresses."""
    valid_s: Seconds = 30.0
    """A fix is shown as current for this long after its capture."""


class RunSection(Section):
    """``[run]``: what ``rig run`` does."""

    dem: Files
    """Elevation files to search in; several that adjoin are taken as one. Also GDAL's names, as ``NETCDF:file.nc:dem``."""
    dem_error_m: Annotated[float, Field(gt=0.0, le=1000.0)] | None = None
    """One standard deviation of the elevations, where it is known; by cells and roughness where absent."""
    dem_vertical_unit: Annotated[str, AfterValidator(_vertical_unit)] | None = None
    """Unit of the elevations (m, dm, cm, mm, km, ft, us-ft), where the files do not say it."""
    dem_crs: Annotated[str, Field(min_length=1)] | None = None
    """CRS with its datum, as EPSG:26711, where the files do not say it or say it wrong. Without a known datum there is no
    fix."""
    dem_nodata: float | None = None
    """A further number that means void."""
    dem_band: Annotated[int, Field(ge=1)] | None = None
    """Band that holds the elevations, where there are several."""
    dem_scale: Annotated[float, Field(ge=-1e6, le=1e6, allow_inf_nan=False)] | None = None
    """Factor of the stored numbers, where the files do not say it."""
    dem_geoid_offset_m: Annotated[float, Field(gt=-120.0, lt=120.0)] | None = None
    """Where the elevations count from the ellipsoid: the geoid's height above it there, which is taken off."""
    every_s: OptionalSeconds = None
    """Time from one capture to the next; none by the clock where absent."""
    retry_least_s: Seconds = 1.0
    """First wait before a device that failed is tried again; later waits double."""
    retry_most_s: Seconds = 60.0
    """Longest wait before a device that failed is tried again."""
    check_every_s: Seconds = 60.0
    """A device that works is asked this often, between captures, whether it still does."""
    rest: RestTrigger | None = None
    odometry: OdometryInput | None = None
    search: SearchLimits = SearchLimits()
    spool: SpoolSection = SpoolSection()
    control: Annotated[Path | None, Field(strict=False)] = None
    """Socket of ``rig trigger`` and ``rig status``; ``control.sock`` in the spool where absent."""
    nmea: NmeaOutput | None = None
    mavlink: MavlinkOutput | None = None
    http: HttpServer | None = None

    @model_validator(mode="after")
    def _retry_limits_are_ordered(self) -> Self:
        if self.retry_least_s > self.retry_most_s:
            raise ValueError("[run] retry_least_s is longer than retry_most_s")
        return self

    @property
    def chosen_dem(self) -> DemChoice:
        """The elevation files and their options."""
        return DemChoice(
            self.dem,
            self.dem_vertical_unit,
            self.dem_crs,
            self.dem_nodata,
            self.dem_error_m,
            self.dem_band,
            self.dem_scale,
            self.dem_geoid_offset_m,
        )

    def resolved_against(self, folder: Path) -> "RunSection":
        """The section with relative paths resolved against ``folder``."""
        http = self.http
        if http is not None and http.token_file is not None:
            http = http.model_copy(update={"token_file": folder / http.token_file})
        spool_dir = folder / self.spool.dir
        return self.model_copy(
            update={
                "control": folder / self.control if self.control else spool_dir / "control.sock",
                "dem": tuple(beside(folder, file) for file in self.dem),
                "spool": self.spool.model_copy(update={"dir": spool_dir}),
                "http": http,
            }
        )


def control_socket_of_invalid_config(path: Path) -> Path | None:
    """The control socket named by a configuration that is otherwise invalid; None if this key is invalid too.

    A daemon that rejected it continues with the previous configuration; ``rig status`` must still reach it to show why.
    """
    try:
        named = read_toml(path)["run"]
        keys = {"control": named["control"]} if "control" in named else {}
        if "dir" in named.get("spool", {}):
            keys["spool"] = {"dir": named["spool"]["dir"]}
        return RunSection.model_validate({"dem": ["any"], **keys}).resolved_against(path.parent).control
    except (
        OSError,
        DocumentError,
        KeyError,
        TypeError,
        AttributeError,
        ValidationError,
    ):
        return None
