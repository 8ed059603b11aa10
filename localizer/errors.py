"""What all expected failures have in common, in every part of skyfix."""


class SkyfixError(Exception):
    """An expected failure. Its message is one line: what is wrong, where, and what to do.

    Attributes
    ----------
    exit_status : int
        What a command ends with when the error reaches it: 2, bad input, unless a subclass says otherwise.
    """

    exit_status: int = 2

    def __str__(self) -> str:
        """The message in one printable line, whatever it cites from a file."""
        return "".join(c if c.isprintable() else " " for c in super().__str__())
