"""``rig capture --repeat``: bundle after bundle, a series that goes on where a crash or a power cut stopped it."""
