"""Devices that the driver tests talk to: servos on a pty, chips as register files, talkers on a pty."""
