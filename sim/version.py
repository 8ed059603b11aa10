"""The version of skyfix."""

from localizer.version import __version__ as __version__
