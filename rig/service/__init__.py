"""``rig service``: installs skyfix as a systemd service."""
