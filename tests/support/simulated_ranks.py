"""Simulated ranks: n threads of one process that speak the verbs of vgmpi/parallel/communicator.py.

Cheaper than mpirun, and stricter: ranks that call different verbs, a message whose size differs
from its buffer, a send buffer changed before it was sent, and a rank that leaves early are errors
at once instead of deadlocks.
"""

import pickle
import threading

import numpy as np

from tests.support.launch import PATIENCE
from vgmpi.parallel.communicator import PersistentExchange, SerialCommunicator


class Aborted(Exception):
    """A rank called `abort`; args: (rank, code)."""


class Simulated(SerialCommunicator):
    """One of n ranks; made by `run`."""

    def __init__(self, rank: int, shared: "_Shared"):
        self.rank = rank
        self.size = shared.size
        self.delivered = 0  # rows that came by `deliver`
        self.partners = set()  # ranks they came from
        self._shared = shared

    def _all(self, verb, thing):
        """What every rank gave, in rank order; all must be in the same verb."""
        shared = self._shared
        shared.slots[self.rank] = (verb, thing)
        shared.barrier.wait(PATIENCE)
        slots = list(shared.slots)
        shared.barrier.wait(PATIENCE)  # nobody overwrites a slot before all have read it
        verbs = [v for v, _ in slots]
        if len(set(verbs)) > 1:
            raise AssertionError(f"ranks are in different verbs: {verbs}")
        return [t for _, t in slots]

    def _done(self, result):
        """Hold the others' arrays until all have copied from them."""
        self._shared.barrier.wait(PATIENCE)
        return result

    def barrier(self):
        self._all("barrier", None)

    def bcast(self, thing):
        packed = pickle.dumps(thing) if self.rank == 0 else None
        return pickle.loads(self._all("bcast", packed)[0])

    def max(self, values):
        given = self._all("max", values)
        _same({(v.shape, v.dtype) for v in given}, "max")
        return self._done(np.maximum.reduce(given))

    def sum(self, numbers):
        given = self._all("sum", numbers)
        _same({(v.shape, v.dtype) for v in given}, "sum")
        return self._done(np.add.reduce(given))

    def all_rows(self, rows):
        given = self._all("all_rows", rows)
        _same({(r.shape[1:], r.dtype) for r in given}, "all_rows")
        return self._done(np.concatenate(given))

    def gather_rows(self, rows):
        given = self._all("root_rows", rows)
        _same({(r.shape[1:], r.dtype) for r in given}, "root_rows")
        return self._done(np.concatenate(given) if self.rank == 0 else None)

    def before(self, count):
        return int(sum(self._all("before", count)[: self.rank]))

    def total(self, count):
        return int(sum(self._all("total", count)))

    def exchange(self, parts):
        if len(parts) != self.size:
            raise AssertionError(f"exchange: {len(parts)} parts for {self.size} ranks")
        given = self._all("exchange", parts)
        _same({(p.shape[1:], p.dtype) for sent in given for p in sent}, "exchange")
        return self._done([sent[self.rank].copy() for sent in given])

    def each(self, numbers):
        given = self._all("each", numbers)
        _same({(v.shape, v.dtype) for v in given}, "each")
        return self._done(np.stack(given))

    def sparse_exchange(self, rows, to):
        if len(rows) != len(to) or not ((to >= 0) & (to < self.size)).all():
            raise AssertionError(f"deliver: {len(rows)} rows to ranks {to} of {self.size}")
        given = self._all("deliver", (rows, to))
        _same({(r.shape[1:], r.dtype) for r, _ in given}, "deliver")
        came = [r[t == self.rank] for r, t in given]
        self.delivered += sum(len(part) for part in came)
        self.partners.update(r for r, part in enumerate(came) if len(part))
        return self._done(np.concatenate(came))

    def link(self, sends, receives):
        return SimulatedLink(self.rank, self._shared, sends, receives)

    def abort(self, code):
        raise Aborted(self.rank, code)


class SimulatedLink(PersistentExchange):
    """Messages lie in the shared mail box until taken."""

    def __init__(self, rank, shared, sends, receives):
        self.rank = rank
        self._shared = shared
        self._sends = [(target, _flat(buffer)) for target, buffer in sends]
        self._receives = [(source, _flat(buffer)) for source, buffer in receives]
        self._under_way = None

    def start(self):
        if self._under_way is not None:
            raise AssertionError(f"rank {self.rank} started a link twice without waiting")
        shared = self._shared
        expected, sent = [], []
        with shared.mail:
            for source, buffer in self._receives:
                expected.append((shared.ticket("recv", source, self.rank), buffer))
            for target, buffer in self._sends:
                copy = buffer.copy()
                shared.messages[shared.ticket("send", self.rank, target)] = copy
                sent.append((buffer, copy))
            shared.mail.notify_all()
        self._under_way = expected, sent

    def wait(self):
        if self._under_way is None:
            return
        expected, sent = self._under_way
        self._under_way = None
        for buffer, copy in sent:
            if not np.array_equal(buffer, copy):
                raise AssertionError(f"rank {self.rank} changed a buffer before it was sent")
        for ticket, buffer in expected:
            message = self._shared.take(ticket)
            if len(message) != len(buffer):
                source, _, number = ticket
                raise AssertionError(
                    f"message {number} from rank {source} to rank {self.rank} has {len(message)} "
                    f"bytes, its buffer {len(buffer)}"
                )
            buffer[:] = message

    def close(self):
        if self._under_way is not None:
            raise AssertionError(f"rank {self.rank} closes a link with messages under way")


class _Shared:
    """What the ranks of one run have in common."""

    def __init__(self, size):
        self.size = size
        self.slots = [None] * size
        self.barrier = threading.Barrier(size)
        self.mail = threading.Condition()
        self.messages = {}  # (source, target, number) -> bytes
        self.numbers = {}  # (kind, source, target) -> messages so far
        self.broken = False

    def ticket(self, kind, source, target):
        """Messages between two ranks match in the order they were posted, as in MPI."""
        number = self.numbers.get((kind, source, target), 0)
        self.numbers[kind, source, target] = number + 1
        return source, target, number

    def take(self, ticket):
        with self.mail:
            there = self.mail.wait_for(lambda: self.broken or ticket in self.messages, PATIENCE)
            if self.broken or not there:
                raise threading.BrokenBarrierError(f"no message {ticket} (source, target, number)")
            return self.messages.pop(ticket)

    def break_all(self):
        self.barrier.abort()
        with self.mail:
            self.broken = True
            self.mail.notify_all()


def _flat(array):
    """The bytes of a contiguous array, not a copy."""
    if not array.flags.c_contiguous:
        raise AssertionError("messages must be contiguous arrays")
    return array.reshape(-1).view(np.uint8)


def _same(kinds, verb):
    if len(kinds) > 1:
        raise AssertionError(f"{verb}: ranks give different shapes or types: {kinds}")


def run(n: int, function) -> list:
    """Call `function(ranks)` on n simulated ranks; returns their results in rank order.

    The first exception of any rank ends all and is raised here.
    """
    shared = _Shared(n)
    results = [None] * n
    errors = []

    def work(ranks):
        try:
            results[ranks.rank] = function(ranks)
            ranks._all("end", None)  # a rank that leaves while another is in a verb is an error
        except BaseException as error:
            errors.append(error)
            shared.break_all()

    threads = [
        threading.Thread(target=work, args=(Simulated(r, shared),), daemon=True, name=f"rank {r}")
        for r in range(n)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    if errors:
        first = [e for e in errors if not isinstance(e, threading.BrokenBarrierError)]
        raise (first or errors)[0]
    if shared.messages:
        raise AssertionError(
            f"messages nobody received (source, target, number): {sorted(shared.messages)}"
        )
    return results


def last_first(engine, work, *arguments):
    """In place of Cpu.each: its threads take turns, the last one first, where a pool hardly ever
    lets them race.
    """
    for thread in reversed(range(engine.threads)):
        work(thread, *arguments)
