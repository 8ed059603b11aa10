"""The files that come with the package: terrain, and scenarios to start from.

``configs/scenarios`` of the repository is the place to edit the scenarios; ``sim/scenarios`` is a link to it, and a folder in
the wheel.
"""

from pathlib import Path

_PACKAGE = Path(__file__).parent

EMBEDDED_DEM = _PACKAGE / "terrain" / "santa_cruz_srtm_1s.tif"
SCENARIOS = _PACKAGE / "scenarios"


def scenario_file(named: Path) -> Path:
    """The file itself where there is one, else the scenario of that name that comes with the package.

    ``ideal`` is ``ideal.toml``, ``evaluate/cloud`` is ``evaluate/cloud.toml``. The name as it is where there is neither.
    """
    by_name = {
        path.relative_to(SCENARIOS).with_suffix("").as_posix(): path for path in SCENARIOS.rglob("*.toml")
    }
    shipped = by_name.get(named.as_posix())
    return named if shipped is None or named.exists() else shipped
