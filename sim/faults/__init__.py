"""Things that go wrong with the fake devices at a time that a script gives."""
