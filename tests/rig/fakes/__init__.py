"""Fake devices for the driver tests: servos on a pty, chips as register files, talkers on a pty."""
