"""What may interrupt a run from outside: signals, a limit of steps or wall time, a checkpoint that
is due.
"""

import signal
import time

_heard: list[str] = []  # names of the signals that came


def listen() -> None:
    """Take USR1 and TERM as a wish to stop with a checkpoint.

    Called before anything that takes time: a job may get its signal while it still compiles. The
    run then stops after its first step.
    """
    for number in (signal.SIGUSR1, signal.SIGTERM):
        signal.signal(number, lambda n, frame: _heard.append(signal.Signals(n).name))


class Requests:
    """Flags that ride in each step's reduction, so that all ranks act on them at the same step."""

    def __init__(
        self, stop_steps: int = 0, stop_seconds: float = 0.0, checkpoint_seconds: float = 0.0
    ):
        self.began = self.saved = time.monotonic()
        self.stop_steps = stop_steps
        self.stop_seconds = stop_seconds
        self.checkpoint_seconds = checkpoint_seconds

    def flags(self, steps: int) -> tuple[float, float]:
        """(stop, checkpoint) as this rank sees it after `steps` steps of this run."""
        now = time.monotonic()
        stop = bool(_heard)
        stop |= 0 < self.stop_steps <= steps
        stop |= 0 < self.stop_seconds <= now - self.began
        due = 0 < self.checkpoint_seconds <= now - self.saved
        return float(stop), float(due)

    def checkpointed(self) -> None:
        self.saved = time.monotonic()
