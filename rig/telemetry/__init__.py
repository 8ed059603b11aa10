"""Telemetry of a session in an MCAP file for Foxglove: readings, actions and pictures."""
