"""What can go wrong while a world is made."""


class SimulationError(Exception):
    """An expected failure of the simulator. Its message is one line: what is wrong, where, and what to do.

    The data that the simulator makes must owe nothing to the code under test, so this is no subclass of the
    other packages' error; ``sim``'s command line turns the one into the other.
    """
