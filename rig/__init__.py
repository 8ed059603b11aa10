"""Measures where a camera on a pan-tilt head looks at the horizon, and writes that into measurement bundles.

What this package exports is public; every module below it is private, and may change with any version.

A whole rig is described by a configuration file. ``configs/vehicle.toml``, in an installation ``rig/service/vehicle.toml``,
explains every key.

>>> import rig
>>> config = rig.load_config(config_file)
>>> with rig.connect(config) as devices:
...     level = devices.inclinometer.read_many(0.2)

``rig.capture_bundle(config)`` measures and writes a bundle, ``rig.write_bundle`` one of pictures of your own.

Each driver works by itself:

>>> with rig.open_chip(rig.Adxl355, i2c_bus, 0x1D) as chip:
...     reading = chip.read()

In the examples ``config_file`` is the path of such a file (``"vehicle.toml"``), ``i2c_bus`` a bus (``"/dev/i2c-1"``), and
``servo_port``, ``compass_port``, ``barometer_port`` and ``vaisala_port`` are serial ports (``"/dev/ttyUSB0"``). They run in
the tests, against the simulator's devices. ``sim.simulated_rig`` starts such devices for a program of yours.

Every expected failure is a `RigError`, of one line: what is wrong, where, and what to do. Only a `TransientError` is worth
another try. Units are in the names: ``_g``, ``_ut`` (µT), ``_hpa``, ``_deg``, ``_m``, ``_s``.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
