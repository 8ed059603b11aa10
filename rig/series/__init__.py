"""``rig capture --repeat``: a series of bundles that resumes after a crash or a power cut."""
