"""Telemetry of a session in an MCAP file, which Foxglove shows: what the devices said, what was done, and what was seen."""
