"""``rig watch``: live readings of all devices, without moving anything."""
