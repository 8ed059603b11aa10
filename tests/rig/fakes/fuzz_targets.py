"""What takes bytes from outside, each as a function of bytes that raises only where there is a defect.

Run by hypothesis in the default tests, and in the long ones by atheris, which follows the branches that it reaches:

    python -m fakes.fuzz_targets TARGET -max_total_time=20
"""

import atexit
import contextlib
import sys
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path

from localizer.bundle import BundleError, parse_bundle
from localizer.errors import SkyfixError
from localizer.track.odometry import parse_leg
from localizer.track.tracker import Tracker
from rig.bundle.archive import ArchiveError, bundles_of_archive
from rig.clock import Instant
from rig.config.load import load_config
from rig.daemon.control import ControlSocket
from rig.daemon.odometry.receiver import velocity_in
from rig.daemon.state import DaemonState
from rig.daemon.triggers import Triggers
from rig.devices.dynamixel.protocol2 import StatusParser, frame
from rig.devices.sensors.nmea import parse_heading, parse_pressure, parse_sentence
from rig.devices.sensors.vaisala import parse_pa50
from rig.errors import ConfigError, MessageError

AT = Instant.now()


@cache
def _folder() -> Path:
    folder = tempfile.TemporaryDirectory(prefix="skyfix-fuzz-")
    atexit.register(folder.cleanup)
    return Path(folder.name)


@cache
def _control() -> ControlSocket:
    daemon_state = DaemonState()
    return ControlSocket(
        _folder() / "s", daemon_state, Triggers(daemon_state, lambda: None, lambda source: None)
    )


def control_message(data: bytes) -> None:
    """One line over the control socket."""
    assert set(_control()._answer(data)) & {"answer", "error", "schema"}


def toml_configuration(data: bytes) -> None:
    """The rig's configuration."""
    file = _folder() / "x.toml"
    file.write_bytes(data)
    with contextlib.suppress(ConfigError):
        load_config(file)


def json_bundle(data: bytes) -> None:
    """``bundle.json``."""
    with contextlib.suppress(BundleError):
        parse_bundle(data, "bundle.json")


def json_leg_and_track(data: bytes) -> None:
    """A leg of the odometry, which comes by datagram, and a stored track."""
    with contextlib.suppress(ValueError):
        parse_leg(data)
    with contextlib.suppress(SkyfixError):
        Tracker.from_json(data)


def archive(data: bytes) -> None:
    """An archive of bundles, in any of the formats: its first bytes say which."""
    file = _folder() / "x.tar"
    file.write_bytes(data)
    with contextlib.suppress(ArchiveError, BundleError):
        for _ in bundles_of_archive(file):
            pass


def nmea_sentence(data: bytes) -> None:
    """A line of a talker."""
    for parse in (parse_heading, parse_pressure):
        with contextlib.suppress(MessageError):
            parse(parse_sentence(data), AT)
    with contextlib.suppress(MessageError):
        velocity_in(parse_sentence(data))
    with contextlib.suppress(MessageError):
        parse_pa50(data, AT)


def dynamixel_packet(data: bytes) -> None:
    """Bytes of a servo bus; afterwards a good packet is still understood, or the one after it."""
    parser = StatusParser()
    parser.feed(data)
    good = frame(1, 0x55, b"\0\1")
    parser.feed(bytes(1100))  # whatever has been announced has come
    assert [status.parameters for status in parser.feed(good)] == [b"\1"]


TARGETS: dict[str, Callable[[bytes], None]] = {
    target.__name__: target
    for target in (
        control_message,
        toml_configuration,
        json_bundle,
        json_leg_and_track,
        archive,
        nmea_sentence,
        dynamixel_packet,
    )
}

if __name__ == "__main__":
    import atheris

    name, *options = sys.argv[1:]
    for module in list(sys.modules.values()):
        if (module.__name__ or "").startswith(("rig.", "localizer.")):
            for each in vars(module).values():
                if callable(each) and getattr(each, "__module__", None) == module.__name__:
                    with contextlib.suppress(Exception):
                        atheris.instrument_func(each)
    atheris.Setup([name, *options], TARGETS[name])
    atheris.Fuzz()
