"""Simulates a rig over real terrain: rendered views, and fakes of every device that answer at wire level.

What this package exports is public; every module below it is private, and may change with any version.

>>> import sim
>>> world = sim.World.create(seed=7, scenario=small_camera)
>>> with sim.simulated_rig(world) as simulated:
...     environment = simulated.environment  # for subprocess.run(["rig", "capture"], env={**os.environ, **environment})
>>> sorted(environment)
['SKYFIX_CONFIG', 'SKYFIX_TRUTH']

For tests with pytest there are the fixtures `simulated_rig` and, to be overridden for another world, `simulated_world`:

.. code-block:: python

    def test_my_program(simulated_rig):
        bundle = my_program(config=simulated_rig.config_path)
        assert far_from(bundle, simulated_rig.truth()) < 30.0

In the examples ``small_camera`` is a scenario whose camera has few pixels, so that they are quick. They run in the tests.

Every expected failure is a `SimulationError`, of one line. Pictures are arrays (height, width, 3) of uint8: blue, green, red.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
