"""The daemon from start to end: one configuration after the other."""

import os
from collections.abc import Callable, Mapping
from pathlib import Path

import structlog

from localizer.errors import SkyfixError
from rig import timebase
from rig.config.load import load_config
from rig.config.model import RigConfig
from rig.daemon.boot import process_age_s
from rig.daemon.heartbeat import watchdog
from rig.daemon.log import logging_to
from rig.daemon.main_loop import refused, run_of, status_line
from rig.daemon.named_files import check_named_files
from rig.daemon.notify import notifier_of
from rig.daemon.runtime import DaemonContext, run_configuration
from rig.daemon.signals import Signals, StopRequestedError
from rig.daemon.state import DaemonState

_log = structlog.get_logger(__name__)


def serve(path: Path, environment: Mapping[str, str] = os.environ) -> None:
    """Run until SIGTERM or SIGINT. ``SkyfixError`` if it cannot start; nothing has moved then."""
    config = load_config(path)
    check_named_files(run_of(config, path), path)
    notifier = notifier_of(environment)
    daemon_state = DaemonState()
    with logging_to(daemon_state, environment), Signals() as signals:
        shared = DaemonContext(path, daemon_state, signals, notifier)

        def started(seconds: float) -> None:
            notifier.ready(status_line(daemon_state.snapshot()))
            _log.info("ready", seconds=round(seconds, 2), config=str(path))

        try:
            with watchdog(shared.heartbeats, notifier):
                _run_configurations(config, shared, started)
        except StopRequestedError:
            notifier.stopping("ended on request")
            daemon_state.set_activity("stopping")
            _log.info("ended", reason="on request")
        finally:
            if shared.worker:
                shared.worker.close()


def _run_configurations(
    config: RigConfig, shared: DaemonContext, tell_started: Callable[[float], None]
) -> None:
    """Run one configuration after the other. One that cannot start after another has run is refused, and the previous
    one continues.

    ``tell_started`` gets the seconds until a configuration ran; the first counts from the start of the process.
    """
    in_force: RigConfig | None = None
    runs = False
    begun_s = timebase.monotonic_s() - process_age_s()

    def started() -> None:
        nonlocal in_force, runs
        in_force, runs = config, True
        tell_started(timebase.monotonic_s() - begun_s)

    while True:
        runs = False
        try:
            config = run_configuration(config, shared, started)
            begun_s = timebase.monotonic_s()
            _log.info("configuration read anew", config=str(shared.path))
        except SkyfixError as error:
            if runs or in_force is None or config is in_force:
                raise
            begun_s = timebase.monotonic_s()
            refused(shared.daemon_state, str(error))
            config = in_force
