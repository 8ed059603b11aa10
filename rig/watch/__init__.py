"""``rig watch``: what all devices say at this moment, without moving anything."""
