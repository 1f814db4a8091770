"""Stop requests: signals, limits of steps or wall time, and checkpoints that are due."""

import logging
import signal
import time

log = logging.getLogger("vgmpi")

_heard: list[str] = []  # names of the signals received so far


def install_signal_handlers(*signals: signal.Signals) -> None:
    """Handle these signals as requests to stop with a checkpoint.

    Only the first SIGINT is handled so; the next one ends the program at once. SIGUSR1 and SIGTERM
    are installed before anything that takes time, because a job may get its signal while it still
    compiles; the run then stops after its first step.
    """
    for number in signals:
        signal.signal(number, _on_signal)


def _on_signal(number: int, frame: object) -> None:
    """Record a signal.

    Its message is logged by `poll`: at this point a line of the log may be half written.
    """
    _heard.append(signal.Signals(number).name)
    if number == signal.SIGINT:
        signal.signal(number, signal.default_int_handler)


class Requests:
    """Stop and checkpoint flags, reduced in each step so that all ranks act at the same step."""

    def __init__(
        self, stop_steps: int = 0, stop_seconds: float = 0.0, checkpoint_seconds: float = 0.0
    ):
        """Start the clocks.

        Args:
            stop_steps: Steps after which the run stops, 0 for no limit.
            stop_seconds: Wall time after which the run stops [s], 0 for no limit.
            checkpoint_seconds: Wall time between checkpoints [s], 0 for none.
        """
        self.started = self.last_checkpoint = time.monotonic()
        self.interrupt_logged = False  # whether the effect of an interrupt was logged
        self.stop_steps = stop_steps
        self.stop_seconds = stop_seconds
        self.checkpoint_seconds = checkpoint_seconds

    def poll(self, steps: int) -> tuple[float, float]:
        """Return (stop, checkpoint) as this rank sees it after `steps` steps of this run."""
        now = time.monotonic()
        stop = bool(_heard)
        if not self.interrupt_logged and signal.SIGINT.name in _heard:
            self.interrupt_logged = True
            log.info("interrupted: stops with a checkpoint; Ctrl-C again ends at once")
        stop |= 0 < self.stop_steps <= steps
        stop |= 0 < self.stop_seconds <= now - self.started
        due = 0 < self.checkpoint_seconds <= now - self.last_checkpoint
        return float(stop), float(due)

    def note_checkpoint(self) -> None:
        """Restart the clock of checkpoints."""
        self.last_checkpoint = time.monotonic()
