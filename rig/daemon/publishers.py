"""Starts the configured publishers. Each is imported only if needed, as it may require an optional extra."""

from contextlib import ExitStack

import structlog

from rig.config.run import RunSection
from rig.daemon.heartbeat import Heartbeats
from rig.daemon.spool.store import Spool
from rig.daemon.state import Actions, DaemonState

_log = structlog.get_logger(__name__)


def publish(
    stack: ExitStack,
    run: RunSection,
    daemon_state: DaemonState,
    actions: Actions,
    spool: Spool,
    heartbeats: Heartbeats,
) -> None:
    """Start the publisher of each configured section; ``stack`` ends them. ``RigError`` if one cannot start."""
    if run.http:
        from rig.daemon.http import serving

        url = stack.enter_context(serving(run.http, daemon_state, actions, spool, run.chosen_dem, heartbeats))
        _log.info("HTTP", url=url)
    if run.nmea:
        from rig.daemon.publish.nmea import publishing as publishing_nmea

        nmea = stack.enter_context(publishing_nmea(run.nmea, daemon_state, heartbeats))
        where = {"tcp": nmea.tcp and "{}:{}".format(*nmea.tcp), "udp": ",".join(run.nmea.udp)}
        _log.info("NMEA", **{how: to for how, to in where.items() if to})
    if run.mavlink:
        from rig.daemon.publish.mavlink import publishing as publishing_mavlink

        stack.enter_context(publishing_mavlink(run.mavlink, daemon_state, heartbeats))
        _log.info("MAVLink", connection=run.mavlink.connection)
