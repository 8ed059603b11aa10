"""The daemon's HTTP API and web page: the state, and one action (``POST /capture``)."""

from rig.daemon.http.server import serving

__all__ = ["serving"]
