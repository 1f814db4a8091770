"""What simulated ranks hold in the end, as rows to be compared byte by byte."""

import json

import numpy as np

from tests.support import simulated_ranks
from tests.support.simulate import begin
from vgmpi.parallel.particle_group import SIMD_WIDTH
from vgmpi.solver.restart.state_io import save


def state(folder, n, text, steps, threads=1):
    """The particles after some steps on n simulated ranks of `threads` threads: {group/dataset:
    rows as a checkpoint has them}, and what each rank saw: (sorts, least and most particles it
    held).
    """

    def job(ranks):
        home = folder / f"rank{ranks.rank}"
        home.mkdir(exist_ok=True)
        simulation, _ = begin(home, text, ranks, threads=threads)
        held = []
        for _ in range(steps):
            simulation.advance(simulation.bound())
            held.append(int(sum(len(group) for group in simulation.groups)))
        return save(simulation), simulation.sorts, min(held), max(held)

    found = simulated_ranks.run(n, job)
    return joined([saved for saved, *_ in found]), [seen for _, *seen in found]


def joined(saved):
    """The rows of all ranks, one after the other as a checkpoint has them: {group/dataset: rows}.

    saved: what solver.state.save returned on each rank.
    """
    return {
        f"{name}/{key}": np.concatenate([one["groups"][name][key] for one in saved])
        for name, group in saved[0]["groups"].items()
        for key in group
    }


def in_key_order(rows, lattice):
    """The segments of each group by their keys, whichever rank held them."""
    out = {}
    for name in {key.split("/")[0] for key in rows}:
        block, count = rows[f"{name}/block"], rows[f"{name}/count"]
        order = np.argsort(lattice.key(lattice.block(block)))
        first = np.cumsum(count) - count
        at = [np.arange(a, a + n) for a, n in zip(first[order], count[order], strict=True)]
        at = np.concatenate([np.zeros(0, np.int64), *at])
        for key in ("block", "count", "id", "x", "v", "C", "vol0", "state"):
            whole = key in ("block", "count")
            out[f"{name}/{key}"] = rows[f"{name}/{key}"][order if whole else at]
    return out


def by_id(rows):
    """Particles in the order of their ids, so that only their values count; positions are whole
    numbers within blocks.
    """
    out = {}
    for name in {key.split("/")[0] for key in rows}:
        order = np.argsort(rows[f"{name}/id"])
        block = np.repeat(rows[f"{name}/block"], rows[f"{name}/count"])
        out[f"{name}/block"] = block[order]
        for key in ("id", "x", "v", "C", "vol0", "state"):
            out[f"{name}/{key}"] = rows[f"{name}/{key}"][order]
    return out


def different(one, other):
    """Names of the arrays whose bytes differ."""
    assert one.keys() == other.keys()
    return [name for name in one if one[name].tobytes() != other[name].tobytes()]


def padding(group):
    """Places behind the last particle of each segment, up to the next full vector."""
    behind = -group.count % SIMD_WIDTH
    places = [e + np.arange(n) for e, n in zip(group.start + group.count, behind, strict=True)]
    return np.concatenate([np.zeros(0, np.int64), *places])


class Kept:
    """A checkpoint in memory, as far as solver.state.restore reads one."""

    path = "a checkpoint in memory"

    def __init__(self, attrs, rows):
        self.attrs = json.loads(json.dumps(attrs))  # as it comes back from a file
        self.rows = rows

    def names(self, group):
        if group == "/":
            return ["attrs", *sorted({name.partition("/")[0] for name in self.rows})]
        return sorted(name.partition("/")[2] for name in self.rows if name.startswith(f"{group}/"))

    def form(self, name):
        return self.rows[name].shape, self.rows[name].dtype

    def count(self, name):
        return len(self.rows[name])

    def width(self, name):
        return int(np.prod(self.rows[name].shape[1:]))

    def read_rows(self, name, start, stop):
        return self.rows[name][start:stop]
