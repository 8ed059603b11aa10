"""Faults injected into the fake devices at scripted times."""
