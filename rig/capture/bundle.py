"""One bundle, as a program asks for it: what the command ``rig capture`` does, without its words on a terminal."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rig.capture.progress import ProgressReporter
from rig.capture.sequence import capture
from rig.config.directions import parse_directions
from rig.config.model import RigConfig

if TYPE_CHECKING:
    from localizer.dem.lattice import Dem


class _Silent:
    """Tells nobody."""

    def doing(self, what: str) -> None:
        pass

    def done(self, what: str) -> None:
        pass


def capture_bundle(
    config: RigConfig,
    out_dir: Path | str | None = None,
    directions: Sequence[str | float] | None = None,
    *,
    report: ProgressReporter | None = None,
    park: bool = False,
    skip_failed_sensors: bool = False,
    dem: "Dem | None" = None,
) -> Path:
    """Take one measurement bundle: level and heading of the vehicle, then a frame in each direction.

    Whatever happens, the head is left without torque, and no incomplete bundle behind.

    Parameters
    ----------
    config : RigConfig
        From `load_config`.
    out_dir : path, optional
        The folder for the bundle, made where it is absent; by default ``[rig] bundle_dir``.
    directions : sequence of str or float, optional
        Where to look: letters of the compass rose (``"NNE"``) or true azimuths in degrees; by default ``[capture] directions``.
    report : object, optional
        Its methods ``doing(what)`` and ``done(what)`` hear what goes on, a short sentence each; nobody by default.
    park : bool
        Turn the head to its parking place before it is let go.
    skip_failed_sensors : bool
        Do without a compass or an altimeter that cannot be opened.
    dem : localizer.Dem, optional
        Elevations of the area: an altitude that its ground cannot have is refused.

    Returns
    -------
    pathlib.Path
        The bundle's directory (``skyfix.bundle/1``), named by its id.

    Raises
    ------
    ValueError
        A direction is none, or is given twice.
    ConfigError
        The configuration does not fit the devices.
    DeviceError
        A device is absent, another one, or broken.
    GoalError
        The head may not go where a direction is.
    CaptureError
        No frame shows a skyline.
    BundleWriteError
        The bundle cannot be written there.

    Examples
    --------
    >>> import rig
    >>> config = rig.load_config(config_file)  # config_file = "vehicle.toml"
    >>> folder = rig.capture_bundle(config, "bundles", [45.0])
    >>> sorted(path.name for path in (folder / "frames").iterdir())
    ['A045.png']

    ``localizer locate``, or the package ``localizer``, finds out where that was.
    """
    wanted = (
        config.capture.parsed_directions()
        if directions is None
        else parse_directions([str(direction) for direction in directions])
    )
    return capture(
        config,
        wanted,
        Path(out_dir) if out_dir is not None else config.rig.bundle_dir,
        report or _Silent(),
        park=park,
        skip_failed_sensors=skip_failed_sensors,
        dem=dem,
    )
