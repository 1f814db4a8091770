"""Stop requests: signals, limits of steps or wall time, and checkpoints that are due."""

import contextlib
import logging
import os
import signal
import stat
import threading
import time
from collections.abc import Callable, Iterator

log = logging.getLogger("vgmpi")

# They stop a run with a checkpoint once it steps, and end it at once before: nothing is lost yet.
ENDING = (signal.SIGTERM, signal.SIGHUP, signal.SIGXCPU)
AT_LIMIT = 0.5  # of a stop that no signal asks for; signals are counted from 1
GRACE_SECONDS = 2.0  # [s] from a signal to a forced end where compiled code does not return

_heard: list[str] = []  # names of the signals received so far
_steps_begun = threading.Event()


class EndedBySignalError(SystemExit):
    """End of the program by a signal before the first step; `code` is 128 + its number."""

    def __init__(self, number: int):
        super().__init__(128 + number)
        self.exit_code = 128 + number
        self.line = _line_of(number)


def _line_of(number: int) -> str:
    """Return the line that says why a run ends before its first step."""
    return f"{signal.Signals(number).name} before the first step: the run ends, nothing is kept"


@contextlib.contextmanager
def stop_signal_held() -> Iterator[None]:
    """Hold SIGUSR1 back until `signals_heard` takes it, so that it ends no program that starts.

    What arrives later, when the run is over, is dropped.
    """
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGUSR1})
    try:
        yield
    finally:
        signal.sigtimedwait({signal.SIGUSR1}, 0)
        signal.pthread_sigmask(signal.SIG_SETMASK, blocked)


@contextlib.contextmanager
def signals_heard() -> Iterator[None]:
    """Handle the signals that stop a run, from before anything that takes time to its end.

    Before `begin_steps` SIGTERM, SIGHUP and SIGXCPU raise EndedBySignalError, and SIGUSR1 asks for
    a stop after the first step; after it all of them ask for a stop with a checkpoint. A signal
    that is ignored, as SIGHUP is under nohup, stays so. Compiled code may not return for minutes:
    a process that does not obey a signal to end within GRACE_SECONDS is ended by a thread.
    """
    _heard.clear()
    _steps_begun.clear()
    before: dict[signal.Signals, Callable | int | None] = {
        number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGUSR1, *ENDING)
    }
    for number in (signal.SIGUSR1, *ENDING):
        if before[number] is not signal.SIG_IGN:
            signal.signal(number, _on_signal)
    with _forced_end():
        blocked = signal.pthread_sigmask(signal.SIG_BLOCK, ())
        try:
            signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGUSR1})
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
            for number, handler in before.items():
                signal.signal(number, signal.SIG_DFL if handler is None else handler)


def hold_ending_signals() -> None:
    """Hold the signals that end a run back until `take_ending_signals`: somebody must answer."""
    signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)


def take_ending_signals() -> None:
    """Take the signals that were held back. Raises EndedBySignalError for one that has come."""
    signal.pthread_sigmask(signal.SIG_UNBLOCK, ENDING)


def begin_steps() -> None:
    """Take signals for requests to stop with a checkpoint from now on, the first SIGINT too."""
    _steps_begun.set()
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:  # as behind a script's &
        signal.signal(signal.SIGINT, _on_signal)


def _on_signal(number: int, frame: object) -> None:
    """Record a signal, or end the program before the first step.

    Its message is logged by `poll`: at this point a line of the log may be half written.
    """
    if number == signal.SIGHUP:
        _discard_output_to_lost_terminal()
    if not _steps_begun.is_set() and number in ENDING:
        raise EndedBySignalError(number)
    _heard.append(signal.Signals(number).name)
    if number == signal.SIGINT:
        signal.signal(number, signal.default_int_handler)


def _discard_output_to_lost_terminal() -> None:
    """Let output go nowhere where its terminal was closed: a line would end the run by an error."""
    for descriptor in (1, 2):
        try:
            os.write(descriptor, b"")
            is_lost = stat.S_ISCHR(os.fstat(descriptor).st_mode) and not _is_open(descriptor)
        except OSError:
            is_lost = True
        if is_lost:
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, descriptor)
            os.close(nowhere)


def _is_open(descriptor: int) -> bool:
    """Return whether a character device is a terminal that is there, or no terminal."""
    try:
        return os.isatty(descriptor) or os.path.samestat(os.fstat(descriptor), os.stat(os.devnull))
    except OSError:
        return False


@contextlib.contextmanager
def _forced_end() -> Iterator[None]:
    """End the process by a thread where its main thread does not get to obey a signal."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    read_end, write_end = os.pipe2(os.O_CLOEXEC)
    os.set_blocking(write_end, False)
    is_over = threading.Event()
    earlier = signal.set_wakeup_fd(write_end, warn_on_full_buffer=False)
    threading.Thread(target=_force_ends, args=(read_end, is_over), daemon=True).start()
    try:
        yield
    finally:
        is_over.set()
        signal.set_wakeup_fd(earlier)
        os.close(write_end)  # the thread ends


def _force_ends(read_end: int, is_over: threading.Event) -> None:
    """End the process GRACE_SECONDS after a signal that it did not obey.

    Args:
        read_end: Pipe into which Python writes the numbers of the signals; closed at the end.
        is_over: Set once the signals are no longer this module's.
    """
    interrupts = 0
    while numbers := os.read(read_end, 1):
        number = numbers[0]
        interrupts += number == signal.SIGINT
        is_second = number == signal.SIGINT and interrupts > 1
        is_to_end = number in (signal.SIGINT, *ENDING) and not _steps_begun.is_set()
        if not (is_to_end or is_second) or is_over.wait(GRACE_SECONDS):
            continue
        if is_second or not _steps_begun.is_set():
            if number != signal.SIGINT and log.isEnabledFor(logging.ERROR):
                os.write(2, f"vgmpi: {_line_of(number)}\n".encode())
            os._exit(128 + number)
    os.close(read_end)


def _leave_pipe_to_parent() -> None:
    """Keep the signals of a forked child out of its parent's pipe."""
    with contextlib.suppress(ValueError):  # forked from another thread
        signal.set_wakeup_fd(-1)


os.register_at_fork(after_in_child=_leave_pipe_to_parent)


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
        self.logged: set[str] = set()  # names of the signals whose effect was logged
        self.stop_steps = stop_steps
        self.stop_seconds = stop_seconds
        self.checkpoint_seconds = checkpoint_seconds

    def poll(self, steps: int) -> tuple[float, float]:
        """Return (stop, checkpoint) as this rank sees it after `steps` steps of this run.

        stop: The number of the signal that asks for it, AT_LIMIT at a limit, or 0.
        """
        now = time.monotonic()
        is_at_limit = 0 < self.stop_steps <= steps
        is_at_limit |= 0 < self.stop_seconds <= now - self.started
        stop = max([AT_LIMIT * is_at_limit, *(float(signal.Signals[name]) for name in _heard)])
        for name in list(_heard):
            self._log_signal(name)
        due = 0 < self.checkpoint_seconds <= now - self.last_checkpoint
        return stop, float(due)

    def log_stop(self, stop: float) -> None:
        """Log the signal that stops the run, which may have come to another rank first.

        Args:
            stop: Maximum over all ranks of what `poll` returned.
        """
        if stop > AT_LIMIT:
            self._log_signal(signal.Signals(int(stop)).name)

    def _log_signal(self, name: str) -> None:
        """Log what a signal does, once."""
        if name in self.logged:
            return
        self.logged.add(name)
        if name == signal.SIGINT.name:
            log.info("interrupted: stops with a checkpoint; Ctrl-C again ends at once")
        else:
            log.info("%s: stops with a checkpoint", name)

    def note_checkpoint(self) -> None:
        """Restart the clock of checkpoints."""
        self.last_checkpoint = time.monotonic()
