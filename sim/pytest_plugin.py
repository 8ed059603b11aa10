"""A simulated rig for the tests of other programs: pytest finds this module by itself where skyfix is installed.

Nothing is imported until a test asks for a fixture. Without these fixtures: ``pytest -p no:skyfix``.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from sim import SimulatedRig, World


@pytest.fixture
def simulated_world() -> "World":
    """The world of `simulated_rig`: seed 1 on the terrain that comes with skyfix. Override it for another one."""
    import sim

    return sim.World.create()


@pytest.fixture
def simulated_rig(simulated_world: "World", tmp_path: Path) -> Iterator["SimulatedRig"]:
    """Fake devices of a rig, running until the test ends: see ``sim.simulated_rig``. Bundles go into ``tmp_path``."""
    import sim

    with sim.simulated_rig(simulated_world, bundle_dir=tmp_path / "bundles") as rig:
        yield rig
