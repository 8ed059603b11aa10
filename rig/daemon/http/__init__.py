"""The daemon over HTTP: what it knows, for programs and as a page, and one thing to do (``POST /capture``)."""

from rig.daemon.http.server import serving

__all__ = ["serving"]
