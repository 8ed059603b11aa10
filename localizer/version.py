"""The version of skyfix that is installed."""

from importlib import metadata

try:
    __version__ = metadata.version("skyfix")
except metadata.PackageNotFoundError:  # the source is run without being installed
    __version__ = "unknown"
