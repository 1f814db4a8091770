"""What may interrupt a run from outside: signals, a limit of steps or wall time, a checkpoint that
is due.
"""

import logging
import signal
import time

log = logging.getLogger("vgmpi")

_heard: list[str] = []  # names of the signals that came


def listen(*signals: signal.Signals) -> None:
    """Take these signals as a wish to stop with a checkpoint; of INT only the first one: the next
    ends the program at once.

    USR1 and TERM are called for before anything that takes time: a job may get its signal while it
    still compiles. The run then stops after its first step.
    """
    for number in signals:
        signal.signal(number, _hear)


def _hear(number: int, frame: object) -> None:
    """What is said of it is said in `flags`: here a line of the log may be half written."""
    _heard.append(signal.Signals(number).name)
    if number == signal.SIGINT:
        signal.signal(number, signal.default_int_handler)


class Requests:
    """Flags that ride in each step's reduction, so that all ranks act on them at the same step."""

    def __init__(
        self, stop_steps: int = 0, stop_seconds: float = 0.0, checkpoint_seconds: float = 0.0
    ):
        self.began = self.saved = time.monotonic()
        self.told = False  # what an interrupt does
        self.stop_steps = stop_steps
        self.stop_seconds = stop_seconds
        self.checkpoint_seconds = checkpoint_seconds

    def flags(self, steps: int) -> tuple[float, float]:
        """(stop, checkpoint) as this rank sees it after `steps` steps of this run."""
        now = time.monotonic()
        stop = bool(_heard)
        if not self.told and signal.SIGINT.name in _heard:
            self.told = True
            log.info("interrupted: stops with a checkpoint; Ctrl-C again ends at once")
        stop |= 0 < self.stop_steps <= steps
        stop |= 0 < self.stop_seconds <= now - self.began
        due = 0 < self.checkpoint_seconds <= now - self.saved
        return float(stop), float(due)

    def checkpointed(self) -> None:
        self.saved = time.monotonic()
