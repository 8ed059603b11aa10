"""``rig service``: this installation as a service of the vehicle's computer."""
