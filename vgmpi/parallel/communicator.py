"""Communicator: the few MPI operations that the program uses, and a serial stand-in.

Every operation is collective unless stated otherwise: all ranks call it, in the same order. Arrays
travel as buffers; only `bcast` pickles, and it is used during set-up alone.
"""

import atexit
import logging
import os
import sys
import traceback
from typing import Any

import numpy as np

log = logging.getLogger("vgmpi")


class SerialCommunicator:
    """Communicator of one rank without MPI: every operation is the identity."""

    rank = 0
    size = 1
    local_size = 1  # number of ranks on this machine
    place = 0  # number of this rank among them
    mpi = None

    def barrier(self) -> None:
        """Wait for all ranks."""
        pass

    def bcast(self, value):
        """Return the object of rank 0 on all ranks; it is pickled."""
        return value

    def max(self, values: np.ndarray) -> np.ndarray:
        """Return the element-wise maximum over the ranks; it may be in place.

        It is exact, so independent of the number of ranks.
        """
        return values

    def sum(self, numbers: np.ndarray) -> np.ndarray:
        """Return the exact element-wise sum of integers over the ranks; it may be in place."""
        return numbers

    def all_rows(self, rows: np.ndarray) -> np.ndarray:
        """Return the rows of all ranks in rank order, on every rank."""
        return rows

    def gather_rows(self, rows: np.ndarray) -> np.ndarray | None:
        """Return the rows of all ranks in rank order on rank 0, None elsewhere."""
        return rows

    def before(self, count: int) -> int:
        """Return the sum of `count` over the ranks below this one."""
        return 0

    def total(self, count: int) -> int:
        """Return the sum of `count` over all ranks."""
        return count

    def each(self, numbers: np.ndarray) -> np.ndarray:
        """Return the few numbers (n,) of every rank, shape (ranks, n)."""
        return numbers[None]

    def exchange(self, parts: list[np.ndarray]) -> list[np.ndarray]:
        """Send parts[r] to rank r and return the part that each rank sent to this one.

        All parts have one dtype and row shape. The work grows with the number of ranks.
        """
        return [parts[0]]

    def sparse_exchange(self, rows: np.ndarray, to: np.ndarray) -> np.ndarray:
        """Send rows[i] to rank to[i] and return the received rows, by sender and in its order.

        Only ranks with messages for each other communicate, and no rank needs to know its senders:
        the work does not grow with the number of ranks.
        """
        return rows

    def link(self, sends, receives) -> "PersistentExchange":
        """Return transfers between fixed buffers. Not collective.

        Args:
            sends: List of (rank, contiguous array) to send.
            receives: List of (rank, contiguous array) to receive into.
        """
        assert not sends and not receives
        return PersistentExchange()

    def abort(self, code: int) -> None:
        """End all ranks immediately with an exit code."""
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


class PersistentExchange:
    """Persistent exchange: repeated transfers between the same buffers. Nothing is collective."""

    def start(self) -> None:
        """Start sending the contents of the buffers."""

    def progress(self) -> None:
        """Let pending messages progress: many MPI libraries work only when called."""

    def wait(self) -> None:
        """Return when all messages have arrived and all buffers may be written again."""

    def close(self) -> None:
        """Free the resources of MPI; the last call."""


class _MpiLink(PersistentExchange):
    """Persistent exchange by MPI requests."""

    def __init__(self, MPI, communicator, sends, receives):
        self._MPI = MPI
        self.is_open = True
        self._requests = [communicator.Recv_init(buffer, source=r) for r, buffer in receives]
        self._requests += [communicator.Send_init(buffer, dest=r) for r, buffer in sends]

    def start(self):
        """Start all requests."""
        self._MPI.Prequest.Startall(self._requests)

    def progress(self):
        """Test the requests, so that MPI makes progress."""
        self._MPI.Request.Testall(self._requests)

    def wait(self):
        """Wait for all requests."""
        self._MPI.Request.Waitall(self._requests)

    def close(self):
        """Free all requests."""
        for request in self._requests:
            request.Free()
        self._requests = []
        self.is_open = False


class MpiCommunicator(SerialCommunicator):
    """Communicator over MPI, with the operations of `SerialCommunicator`."""

    def __init__(self, communicator=None):
        self._MPI = MPI = start_mpi()
        self.mpi = MPI.COMM_WORLD if communicator is None else communicator
        self.rank = self.mpi.Get_rank()
        self.size = self.mpi.Get_size()
        self._round = 1
        neighbours = self.mpi.Split_type(MPI.COMM_TYPE_SHARED)
        self.local_size, self.place = neighbours.Get_size(), neighbours.Get_rank()
        neighbours.Free()
        self._links: list[_MpiLink] = []  # those whose requests are not freed
        atexit.register(self._close_links)  # before mpi4py ends MPI

    def _close_links(self):
        """Free the requests that are left at the end of the program: MPICH reports each of them."""
        for link in self._links:
            link.close()

    @property
    def library(self) -> str:
        """Name and version of the MPI library, such as "Open MPI v5.0.11, ..."."""
        return self._MPI.Get_library_version().splitlines()[0]

    def barrier(self):
        """Wait for all ranks."""
        self.mpi.Barrier()

    def bcast(self, value):
        """Return the object of rank 0 on all ranks; it is pickled."""
        return self.mpi.bcast(value, root=0)

    def max(self, values):
        """Return the element-wise maximum over the ranks, in place."""
        self.mpi.Allreduce(self._MPI.IN_PLACE, values, self._MPI.MAX)
        return values

    def sum(self, numbers):
        """Return the element-wise sum over the ranks, in place."""
        self.mpi.Allreduce(self._MPI.IN_PLACE, numbers, self._MPI.SUM)
        return numbers

    def each(self, numbers):
        """Return the few numbers (n,) of every rank, shape (ranks, n)."""
        out = np.empty((self.size, len(numbers)), numbers.dtype)
        self.mpi.Allgather(np.ascontiguousarray(numbers), out)
        return out

    def _counts(self, count):
        """Return `count` of every rank, shape (size,)."""
        return self.each(np.array([count], np.int64))[:, 0]

    def _type(self, rows):
        """Return a committed MPI type of one row, so that counts stay below 2^31."""
        size = int(np.prod(rows.shape[1:], dtype=np.int64)) * rows.dtype.itemsize
        return self._MPI.BYTE.Create_contiguous(size).Commit()

    def all_rows(self, rows):
        """Return the rows of all ranks in rank order, on every rank."""
        rows = np.ascontiguousarray(rows)
        counts = self._counts(len(rows))
        out = np.empty((int(counts.sum()), *rows.shape[1:]), rows.dtype)
        row = self._type(rows)
        self.mpi.Allgatherv([rows, len(rows), row], [out, counts, _starts(counts), row])
        row.Free()
        return out

    def gather_rows(self, rows):
        """Return the rows of all ranks in rank order on rank 0, None elsewhere."""
        rows = np.ascontiguousarray(rows)
        counts = self._counts(len(rows))
        row = self._type(rows)
        if self.rank == 0:
            out = np.empty((int(counts.sum()), *rows.shape[1:]), rows.dtype)
            self.mpi.Gatherv([rows, len(rows), row], [out, counts, _starts(counts), row])
        else:
            out = None
            self.mpi.Gatherv([rows, len(rows), row], None)
        row.Free()
        return out

    def before(self, count):
        """Return the sum of `count` over the ranks below this one."""
        mine, below = np.array([count], np.int64), np.zeros(1, np.int64)
        self.mpi.Exscan(mine, below, self._MPI.SUM)
        return int(below[0]) if self.rank else 0  # MPI leaves the result on rank 0 undefined

    def total(self, count):
        """Return the sum of `count` over all ranks."""
        mine = np.array([count], np.int64)
        self.mpi.Allreduce(self._MPI.IN_PLACE, mine, self._MPI.SUM)
        return int(mine[0])

    def exchange(self, parts):
        """Send parts[r] to rank r and return the part that each rank sent to this one."""
        sent = np.array([len(p) for p in parts], np.int64)
        received = np.empty(self.size, np.int64)
        self.mpi.Alltoall(sent, received)
        packed = np.ascontiguousarray(np.concatenate(parts))
        out = np.empty((int(received.sum()), *packed.shape[1:]), packed.dtype)
        row = self._type(packed)
        self.mpi.Alltoallv(
            [packed, sent, _starts(sent), row], [out, received, _starts(received), row]
        )
        row.Free()
        return np.split(out, np.cumsum(received)[:-1])

    def sparse_exchange(self, rows, to):
        """Send rows[i] to rank to[i] and return the received rows, by sender and in its order."""
        if self.size == 1:
            return rows
        order = np.argsort(to, kind="stable")
        rows, to = np.ascontiguousarray(rows[order]), to[order]
        targets, start = np.unique(to, return_index=True)
        parts = dict(zip(targets.tolist(), np.split(rows, start[1:]), strict=False))
        mine = parts.pop(self.rank, rows[:0])
        row = self._type(rows)
        received = self._sparse(parts, row, rows[:0]) | {self.rank: mine}
        row.Free()
        return np.concatenate([received[r] for r in sorted(received)])

    def _sparse(self, parts, row, like):
        """Send parts[r] to each rank r in it and return the received parts by rank.

        A message counts as sent once it is received. A rank enters a barrier when all of its
        messages are, and continues to receive others' until all ranks have entered it.

        References:
            Hoefler, Siebert and Lumsdaine 2010.
        """
        MPI, status, received = self._MPI, self._MPI.Status(), {}
        # A rank that has finished may begin the next round while others still probe, but no later
        # one: two alternating tags separate the rounds. Persistent exchanges use tag 0.
        self._round = 3 - self._round
        sent = [self.mpi.Issend([p, len(p), row], r, self._round) for r, p in parts.items()]
        barrier = None
        while barrier is None or not barrier.Test():
            while self.mpi.Iprobe(MPI.ANY_SOURCE, self._round, status):
                source, n = status.Get_source(), status.Get_count(row)
                received[source] = part = np.empty((n, *like.shape[1:]), like.dtype)
                self.mpi.Recv([part, n, row], source, self._round)
            if barrier is None and MPI.Request.Testall(sent):
                barrier = self.mpi.Ibarrier()
            os.sched_yield()  # with more ranks than cores another rank can answer
        return received

    def link(self, sends, receives):
        """Return transfers between fixed buffers. Not collective."""
        self._links = [link for link in self._links if link.is_open]
        self._links.append(_MpiLink(self._MPI, self.mpi, sends, receives))
        return self._links[-1]

    def abort(self, code):
        """End all ranks immediately with an exit code."""
        sys.stdout.flush()
        sys.stderr.flush()
        self.mpi.Abort(code)


def _starts(counts: np.ndarray) -> np.ndarray:
    """Return the exclusive prefix sum of counts."""
    return np.concatenate([[0], np.cumsum(counts)[:-1]])


def start_mpi() -> Any:
    """Return the module MPI of mpi4py, which starts MPI when it is first imported.

    Ranks of Open MPI that wait then leave their core to other programs, unless the user has set it
    otherwise: on busy cores a message takes a third of the time, on idle ones as long as before.
    """
    os.environ.setdefault("OMPI_MCA_mpi_yield_when_idle", "1")
    from mpi4py import MPI

    return MPI


def joined_ranks() -> int:
    """Return the number of ranks that MPI joins; 1 without an MPI library."""
    try:
        return start_mpi().COMM_WORLD.Get_size()
    except (ImportError, RuntimeError):
        return 1


def init_communicator() -> SerialCommunicator:
    """Return the communicator of this run: MPI if there is an MPI library, else one rank.

    Without a library it logs a one-line notice. On more than one rank it installs an excepthook: an
    exception on one rank ends all, and names the rank.
    """
    try:
        ranks = MpiCommunicator()
    except (ImportError, RuntimeError) as error:
        log.warning("no MPI library found (%s): running on one rank", str(error).splitlines()[0])
        return SerialCommunicator()
    if ranks.size > 1:
        sys.excepthook = _abort_all(ranks)
    return ranks


def _abort_all(ranks: SerialCommunicator):
    """Return an excepthook that prints the rank and ends all ranks."""

    def hook(kind, error, trace):
        """Report the exception of this rank and end all ranks."""
        text = "".join(traceback.format_exception(kind, error, trace))
        sys.stderr.write(f"vgmpi: rank {ranks.rank} of {ranks.size} failed; all ranks end\n{text}")
        ranks.abort(1)

    return hook
