"""Which skyfix this is; the simulator asks for itself, it imports nothing of what it tests."""

from functools import cache

__version__: str
"""Looked up when it is asked for."""


@cache
def package_version() -> str:
    """The version of the installed distribution; "unknown" where the source is run without one."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("skyfix")
    except PackageNotFoundError:
        return "unknown"


def __getattr__(name: str) -> str:
    if name == "__version__":
        return package_version()
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
