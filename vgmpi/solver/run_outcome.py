"""How a run ends: its exit codes, and the errors that end it."""

DONE, BLEW_UP, STOPPED = 0, 3, 75  # exit codes


class BlowUp(RuntimeError):
    """Error of a state that can no longer be trusted; it names object, particle and step."""


class InvalidRunOptions(ValueError):
    """Error of options that exclude each other or do not suit the ranks."""
