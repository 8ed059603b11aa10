# What is exported, and from where: lazy_loader reads it when ``sim`` is imported, type checkers read it as it is.

from .errors import SimulationError
from .launch.launcher import SimulatedRig, simulated_rig
from .render.panorama import Panorama, render_panorama
from .render.view import render_view, true_skyline
from .shipped_files import EMBEDDED_DEM, SCENARIOS
from .version import __version__
from .world.scenario import Scenario, load_scenario
from .world.true_values import TruePlace
from .world.truth import World

__all__ = [
    "EMBEDDED_DEM",
    "SCENARIOS",
    "Panorama",
    "Scenario",
    "SimulatedRig",
    "SimulationError",
    "TruePlace",
    "World",
    "__version__",
    "load_scenario",
    "render_panorama",
    "render_view",
    "simulated_rig",
    "true_skyline",
]
