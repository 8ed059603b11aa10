"""The version of skyfix."""

from functools import cache
from importlib.metadata import PackageNotFoundError, version


@cache
def package_version() -> str:
    """The version of the installed distribution; "unknown" where the source is run without one."""
    try:
        return version("skyfix")
    except PackageNotFoundError:
        return "unknown"
