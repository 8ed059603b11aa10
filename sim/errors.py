"""Errors of the simulator."""


class SimulationError(Exception):
    """An expected failure of the simulator. Its message is one line: what is wrong, where, and what to do.

    The simulator shares no code with what it tests, so this is no subclass of the other packages' errors; ``sim``'s
    command line converts it.
    """
