"""The few MPI verbs the program speaks, and their one-rank stand-in.

Every verb is collective unless it says otherwise: all ranks call it, in the same order. Arrays
travel as buffers; only `bcast` pickles, and it is used at set-up alone.
"""

import logging
import os
import sys
import traceback

import numpy as np

log = logging.getLogger("vgmpi")


class Alone:
    """One rank without MPI: every verb is the identity."""

    rank = 0
    size = 1
    here = 1  # ranks on this machine
    place = 0  # which of them this is
    mpi = None

    def barrier(self) -> None:
        pass

    def bcast(self, thing):
        return thing

    def max(self, values: np.ndarray) -> np.ndarray:
        """Element-wise maximum over the ranks, in place of the values or not; exact, so independent
        of the number of ranks.
        """
        return values

    def sum(self, numbers: np.ndarray) -> np.ndarray:
        """Element-wise sum of whole numbers over the ranks, in place of them or not; exact."""
        return numbers

    def all_rows(self, rows: np.ndarray) -> np.ndarray:
        """Rows of all ranks one after the other, in rank order, on every rank."""
        return rows

    def root_rows(self, rows: np.ndarray) -> np.ndarray | None:
        """As `all_rows`, on rank 0 only; None elsewhere."""
        return rows

    def before(self, count: int) -> int:
        """Sum of `count` over the ranks below this one."""
        return 0

    def total(self, count: int) -> int:
        """Sum of `count` over all ranks."""
        return count

    def each(self, numbers: np.ndarray) -> np.ndarray:
        """The same few numbers (n,) of every rank: (ranks, n)."""
        return numbers[None]

    def exchange(self, parts: list[np.ndarray]) -> list[np.ndarray]:
        """Send parts[r] to rank r; returns what each rank sent here. One dtype and row shape for
        all parts. Its work grows with the number of ranks.
        """
        return [parts[0]]

    def deliver(self, rows: np.ndarray, to: np.ndarray) -> np.ndarray:
        """Send rows[i] to rank to[i]; returns the rows that came here, ascending by their sender
        and in the sender's order. Only ranks that have something for each other speak, and nobody
        needs to know who will: the work does not grow with the number of ranks.
        """
        return rows

    def link(self, sends, receives) -> "Link":
        """Transfers between fixed buffers; `sends` and `receives` are lists of (rank, contiguous
        array). Not collective.
        """
        assert not sends and not receives
        return Link()

    def abort(self, code: int) -> None:
        """End all ranks now."""
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


class Link:
    """Transfers between the same buffers again and again. Nothing here is collective."""

    def start(self) -> None:
        """Begin to send what the buffers hold."""

    def nudge(self) -> None:
        """Let messages under way move on: many MPI libraries work only when called."""

    def wait(self) -> None:
        """Return when all has arrived and all buffers may be written again."""

    def close(self) -> None:
        """Give back what MPI holds; the last call."""


class _MpiLink(Link):
    def __init__(self, MPI, communicator, sends, receives):
        self._MPI = MPI
        self._requests = [communicator.Recv_init(buffer, source=r) for r, buffer in receives]
        self._requests += [communicator.Send_init(buffer, dest=r) for r, buffer in sends]

    def start(self):
        self._MPI.Prequest.Startall(self._requests)

    def nudge(self):
        self._MPI.Request.Testall(self._requests)

    def wait(self):
        self._MPI.Request.Waitall(self._requests)

    def close(self):
        for request in self._requests:
            request.Free()


class Mpi(Alone):
    """The same verbs over an MPI communicator."""

    def __init__(self, communicator=None):
        from mpi4py import MPI

        self._MPI = MPI
        self.mpi = MPI.COMM_WORLD if communicator is None else communicator
        self.rank = self.mpi.Get_rank()
        self.size = self.mpi.Get_size()
        self._round = 1
        neighbours = self.mpi.Split_type(MPI.COMM_TYPE_SHARED)
        self.here, self.place = neighbours.Get_size(), neighbours.Get_rank()
        neighbours.Free()

    def barrier(self):
        self.mpi.Barrier()

    def bcast(self, thing):
        return self.mpi.bcast(thing, root=0)

    def max(self, values):
        self.mpi.Allreduce(self._MPI.IN_PLACE, values, self._MPI.MAX)
        return values

    def sum(self, numbers):
        self.mpi.Allreduce(self._MPI.IN_PLACE, numbers, self._MPI.SUM)
        return numbers

    def each(self, numbers):
        out = np.empty((self.size, len(numbers)), numbers.dtype)
        self.mpi.Allgather(np.ascontiguousarray(numbers), out)
        return out

    def _counts(self, count):
        """`count` of every rank, (size,)."""
        return self.each(np.array([count], np.int64))[:, 0]

    def _type(self, rows):
        """A committed MPI type of one row, so that counts stay below 2^31."""
        size = int(np.prod(rows.shape[1:], dtype=np.int64)) * rows.dtype.itemsize
        return self._MPI.BYTE.Create_contiguous(size).Commit()

    def all_rows(self, rows):
        rows = np.ascontiguousarray(rows)
        counts = self._counts(len(rows))
        out = np.empty((int(counts.sum()), *rows.shape[1:]), rows.dtype)
        row = self._type(rows)
        self.mpi.Allgatherv([rows, len(rows), row], [out, counts, _starts(counts), row])
        row.Free()
        return out

    def root_rows(self, rows):
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
        mine, below = np.array([count], np.int64), np.zeros(1, np.int64)
        self.mpi.Exscan(mine, below, self._MPI.SUM)
        return int(below[0]) if self.rank else 0  # what rank 0 finds there is not defined

    def total(self, count):
        mine = np.array([count], np.int64)
        self.mpi.Allreduce(self._MPI.IN_PLACE, mine, self._MPI.SUM)
        return int(mine[0])

    def exchange(self, parts):
        sent = np.array([len(p) for p in parts], np.int64)
        got = np.empty(self.size, np.int64)
        self.mpi.Alltoall(sent, got)
        packed = np.ascontiguousarray(np.concatenate(parts))
        out = np.empty((int(got.sum()), *packed.shape[1:]), packed.dtype)
        row = self._type(packed)
        self.mpi.Alltoallv([packed, sent, _starts(sent), row], [out, got, _starts(got), row])
        row.Free()
        return np.split(out, np.cumsum(got)[:-1])

    def deliver(self, rows, to):
        if self.size == 1:
            return rows
        order = np.argsort(to, kind="stable")
        rows, to = np.ascontiguousarray(rows[order]), to[order]
        targets, start = np.unique(to, return_index=True)
        parts = dict(zip(targets.tolist(), np.split(rows, start[1:]), strict=False))
        mine = parts.pop(self.rank, rows[:0])
        row = self._type(rows)
        came = self._sparse(parts, row, rows[:0]) | {self.rank: mine}
        row.Free()
        return np.concatenate([came[r] for r in sorted(came)])

    def _sparse(self, parts, row, like):
        """Send parts[r] to each rank r in it; returns what came, by rank (Hoefler, Siebert,
        Lumsdaine 2010). A message counts as sent when it was taken in; a rank whose messages were
        enters a barrier and goes on taking in others' until all have entered it.
        """
        MPI, status, came = self._MPI, self._MPI.Status(), {}
        # a rank that is through may begin anew while others still look: at most once, so that two
        # numbers in turn keep the rounds apart; links use 0
        self._round = 3 - self._round
        sent = [self.mpi.Issend([p, len(p), row], r, self._round) for r, p in parts.items()]
        barrier = None
        while barrier is None or not barrier.Test():
            while self.mpi.Iprobe(MPI.ANY_SOURCE, self._round, status):
                source, n = status.Get_source(), status.Get_count(row)
                came[source] = part = np.empty((n, *like.shape[1:]), like.dtype)
                self.mpi.Recv([part, n, row], source, self._round)
            if barrier is None and MPI.Request.Testall(sent):
                barrier = self.mpi.Ibarrier()
            os.sched_yield()  # more ranks than cores: let another answer
        return came

    def link(self, sends, receives):
        return _MpiLink(self._MPI, self.mpi, sends, receives)

    def abort(self, code):
        sys.stdout.flush()
        sys.stderr.flush()
        self.mpi.Abort(code)


def _starts(counts: np.ndarray) -> np.ndarray:
    return np.concatenate([[0], np.cumsum(counts)[:-1]])


def world() -> Alone:
    """The ranks of this run: MPI where there is an MPI library, otherwise one rank with a one-line
    notice.

    Installs an excepthook on more than one rank: an exception on one ends all, with its rank named.
    """
    try:
        ranks = Mpi()
    except (ImportError, RuntimeError) as error:
        log.warning("no MPI library found (%s): running on one rank", str(error).splitlines()[0])
        return Alone()
    if ranks.size > 1:
        sys.excepthook = _abort_all(ranks)
    return ranks


def _abort_all(ranks: Alone):
    def hook(kind, error, trace):
        text = "".join(traceback.format_exception(kind, error, trace))
        sys.stderr.write(f"vgmpi: rank {ranks.rank} of {ranks.size} failed; all ranks end\n{text}")
        ranks.abort(1)

    return hook
