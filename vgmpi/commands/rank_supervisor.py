"""Ranks that a plain start of the program begins by mpirun, and what it does for them.

Every rank connects to a socket of its parent first. It gets the parent's stdout and stderr, so that
nothing of what it writes passes through mpirun, and sends its exit code at the end. mpirun runs in
a session of its own: signals of the terminal reach the parent, which hands them to the ranks.
"""

import contextlib
import logging
import os
import secrets
import select
import shutil
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from vgmpi.parallel.communicator import joined_ranks
from vgmpi.parallel.launch import OPEN_MPI, SUPERVISOR_VARIABLE
from vgmpi.runtime.death_signal import die_with_parent
from vgmpi.solver.stop_requests import hold_ending_signals

log = logging.getLogger("vgmpi")

SOCKET_VARIABLE = "VGMPI_RANK_SOCKET"
FORWARDED = (
    signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGXCPU, signal.SIGUSR1
)  # fmt: skip
ALONE = 255  # sent in place of an exit code by a rank that MPI does not join to the others
# [s] from the end of one rank by an error or a signal to that of those that wait for it
LAST_RANK_SECONDS = 20.0
_CREDENTIALS = struct.Struct("3i")  # process, user, group
# like `python -m vgmpi` in the folder of this very package, wherever it was started
_PROGRAM = """import sys
del sys.path[0]
if {root!r} not in sys.path:
    sys.path.insert(0, {root!r})
from vgmpi.__main__ import main
sys.exit(main())
"""


class LaunchError(RuntimeError):
    """Error of ranks that could not be started: one line."""


def find_mpirun() -> str | None:
    """Return the path of mpirun: one beside the interpreter before one of the search path."""
    return shutil.which("mpirun", path=os.path.dirname(sys.executable)) or shutil.which("mpirun")


def run_on_ranks(mpirun: str, count: int, words: list[str]) -> int:
    """Run the program with a command line on ranks of this machine; return the exit code.

    Args:
        mpirun: Path of the launcher.
        count: Number of ranks.
        words: Words of the command line.

    Raises:
        LaunchError: The ranks do not start, or MPI does not join them.
    """
    with tempfile.TemporaryFile() as messages, contextlib.closing(_Listener(count)) as listener:
        root = str(Path(__file__).parents[2])
        program = [sys.executable, "-c", _PROGRAM.format(root=root), *words]
        environment = OPEN_MPI | os.environ
        environment |= {SOCKET_VARIABLE: listener.name, SUPERVISOR_VARIABLE: str(os.getpid())}
        try:
            process = subprocess.Popen(
                [mpirun, *_flags(mpirun), "-n", str(count), *program], env=environment,
                stdin=subprocess.DEVNULL, stdout=messages, stderr=messages,
                start_new_session=True, preexec_fn=die_with_parent(signal.SIGTERM),
            )  # fmt: skip
        except OSError as error:
            raise LaunchError(f"{mpirun}: {error.strerror}") from None
        supervisor = _Supervisor(process, listener)
        with supervisor.forwarding():
            supervisor.wait()
        messages.seek(0)
        return supervisor.exit_code(messages.read().decode("utf-8", errors="replace"))


def _flags(mpirun: str) -> list[str]:
    """Return the flags for a launcher: no comments on exit codes, ranks on any core."""
    try:
        job = subprocess.run([mpirun, "--version"], capture_output=True, text=True, check=False)
    except OSError:
        return []
    return ["--quiet", "--bind-to", "none"] if "Open MPI" in job.stdout else []


class _Listener:
    """Socket of the parent and the ranks that have connected to it.

    Attributes:
        processes: Process of each rank by its connection.
        codes: Exit codes of the ranks that have sent one.
    """

    def __init__(self, count: int):
        """Listen under a name that nobody guesses and that no file system holds."""
        self.name, self.count = f"vgmpi-{os.getpid()}-{secrets.token_hex(16)}", count
        self.socket = socket.socket(socket.AF_UNIX)
        self.socket.bind(f"\0{self.name}")
        self.socket.listen(count)
        self.processes: dict[socket.socket, int] = {}
        self.codes: list[int] = []
        self.connected = 0  # ranks that have ever connected
        self.is_asked_to_stop = False  # SIGUSR1 came, which every rank gets

    def receive(self, ready: list) -> None:
        """Take connections and exit codes from what is ready to be read."""
        for connection in [c for c in ready if c in self.processes]:
            try:
                data = connection.recv(1)
            except OSError:
                data = b""
            if data:
                self.codes.append(data[0])
            del self.processes[connection]
            connection.close()
        if self.socket in ready:
            self._accept()

    def _accept(self) -> None:
        """Give a new rank the number of ranks and what this process writes to."""
        connection, _ = self.socket.accept()
        size = _CREDENTIALS.size
        credentials = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, size)
        process, user, _ = _CREDENTIALS.unpack(credentials)
        if user != os.getuid():
            connection.close()
            return
        try:
            socket.send_fds(connection, [str(self.count).encode()], [1, 2])
        except OSError:  # it has ended
            connection.close()
            return
        self.processes[connection] = process
        self.connected += 1
        if self.is_asked_to_stop:
            with contextlib.suppress(ProcessLookupError):
                os.kill(process, signal.SIGUSR1)

    def close(self) -> None:
        """Close all connections."""
        for each in (self.socket, *self.processes):
            each.close()


class _Supervisor:
    """Parent of mpirun, until all ranks have ended."""

    def __init__(self, process: subprocess.Popen, listener: _Listener):
        self.process, self.listener = process, listener
        self.received: list[int] = []  # signals that were handed on
        self.deadline = float("inf")  # time at which the ranks that are left are ended

    @contextlib.contextmanager
    def forwarding(self):
        """Hand signals to the ranks; stop and continue with them at Ctrl-Z."""
        handlers: dict[int, Callable] = dict.fromkeys(FORWARDED, self._forward)
        handlers |= {signal.SIGTSTP: self._stop, signal.SIGCONT: self._continue}
        before = {number: signal.getsignal(number) for number in handlers}
        for number, handler in handlers.items():
            if before[number] is not signal.SIG_IGN:  # as under nohup
                signal.signal(number, handler)
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, ())
        try:
            signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGUSR1})
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
            for number, old in before.items():
                signal.signal(number, old)

    def _forward(self, number: int, frame: object) -> None:
        """Hand a signal to all ranks; one to end ends mpirun if there are none yet."""
        if number == signal.SIGUSR1:
            self.listener.is_asked_to_stop = True
            self._signal_ranks(number)
            return
        self.received.append(number)
        if not self.listener.processes:
            self.deadline = min(self.deadline, time.monotonic())
        elif self.received.count(signal.SIGINT) > 1:
            self._end_rest_soon()
        self._signal_ranks(number)

    def _signal_ranks(self, number: int) -> None:
        """Send a signal to every rank that is there."""
        for process in list(self.listener.processes.values()):
            with contextlib.suppress(ProcessLookupError):
                os.kill(process, number)

    def _stop(self, number: int, frame: object) -> None:
        """Stop the ranks, then this process."""
        self._signal_ranks(signal.SIGSTOP)
        os.kill(os.getpid(), signal.SIGSTOP)

    def _continue(self, number: int, frame: object) -> None:
        """Let the ranks go on."""
        self._signal_ranks(signal.SIGCONT)

    def _end_rest_soon(self) -> None:
        """Give the ranks that are left some time to end by themselves."""
        self.deadline = min(self.deadline, time.monotonic() + LAST_RANK_SECONDS)

    def wait(self) -> None:
        """Wait until mpirun has ended; serve the ranks meanwhile."""
        end = os.pidfd_open(self.process.pid)
        try:
            while True:
                remaining = self.deadline - time.monotonic()
                if remaining <= 0:
                    self._end_mpirun()
                watched: list[Any] = [end, self.listener.socket, *self.listener.processes]
                ready = select.select(watched, [], [], min(max(remaining, 0.0), 0.5))[0]
                self.listener.receive(ready)
                if any(self.listener.codes):
                    self._end_rest_soon()
                if end in ready:
                    break
        finally:
            os.close(end)
            self.process.wait()
        self.listener.receive(select.select([*self.listener.processes], [], [], 0)[0])

    def _end_mpirun(self) -> None:
        """Ask mpirun to end the ranks; kill all if it does not."""
        self.process.terminate()
        try:
            self.process.wait(5.0)
        except subprocess.TimeoutExpired:
            self._signal_ranks(signal.SIGKILL)
            self.process.kill()
        self.deadline = float("inf")

    def exit_code(self, messages: str) -> int:
        """Return the exit code of the ranks.

        Args:
            messages: What mpirun and ranks without a connection have written.

        Raises:
            LaunchError: The ranks did not start, or MPI does not join them.
        """
        listener, code = self.listener, self.process.returncode
        if ALONE in listener.codes:
            raise LaunchError("mpirun is of another MPI than mpi4py: every rank is alone")
        if any(listener.codes) or (listener.codes and code == 0):
            return max(listener.codes)
        if self.received:
            number = self.received[-1]
            if listener.connected < listener.count:  # else they have said it
                log.error("%s before the ranks had begun", signal.Signals(number).name)
            return 128 + number
        if listener.connected < listener.count:
            lines = [line for line in messages.splitlines() if line.strip(" -")]
            raise LaunchError(f"mpirun starts no ranks: {' '.join(lines[:3]) or f'code {code}'}")
        if code < 0 or code > 128:
            number = -code if code < 0 else code - 128
            has_name = number in set(signal.Signals)
            name = signal.Signals(number).name if has_name else f"signal {number}"
            log.error("a rank was ended by %s; all ranks end", name)
            return 128 + number
        return code or 1


def run_as_rank(name: str, main: Callable[[list[str]], int], words: list[str]) -> int:
    """Run a command as a rank of a supervisor; return the exit code for mpirun.

    Args:
        name: Name of the supervisor's socket.
        main: Main function of the command.
        words: Words of the command line.
    """
    hold_ending_signals()  # the supervisor sends them from now on, and leaves the line to a rank
    with socket.socket(socket.AF_UNIX) as supervisor:
        supervisor.connect(f"\0{name}")
        count, descriptors, _, _ = socket.recv_fds(supervisor, 16, 2)
        for number, descriptor in zip((1, 2), descriptors, strict=True):
            os.dup2(descriptor, number)
            os.close(descriptor)
        code = ALONE
        if joined_ranks() == int(count):
            try:
                code = main(words)
            except KeyboardInterrupt:
                code = 130
        sys.stdout.flush()
        with contextlib.suppress(OSError):  # the supervisor may have gone
            supervisor.sendall(bytes([code]))
    return 0
