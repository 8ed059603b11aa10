"""``rig run``: the service on the vehicle that captures, locates and publishes."""
