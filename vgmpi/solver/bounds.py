"""Whether what a checkpoint holds can be a state of this scene, before any of it reaches a kernel.

Checksums find what was changed by chance. Here every number is looked at, so that also a file that
was made up is one clear line: each rank looks at its share of the rows, and all hear the first
complaint.
"""

import math
from typing import Any

import numpy as np

from ..domain.blocks import BITS, EDGE, INTEGER, MIDDLE
from ..kernels.g2p import REACH
from ..kernels.given import NUMBERS
from ..output import checkpoint, layout
from .step import Simulation

ROWS = 1 << 20  # looked at together


class Mismatch(checkpoint.CheckpointError):
    """A checkpoint does not belong to this scene."""


def check_attrs(path: Any, attrs: dict, run: bool = True) -> None:
    """Raises Mismatch where clock and numbers of a checkpoint's attrs are none.

    run: also of what only a run's checkpoints have: scene, frame, history, tables.
    """
    reach = attrs.get("reach", [0.0])
    good = {
        "time": _number(attrs.get("time")) and 0.0 <= attrs["time"] < 1e100,
        "sorted_time": _number(since := attrs.get("sorted_time", 0.0)) and 0.0 <= since < 1e100,
        "step": _count(attrs.get("step")),
        "since": _count(attrs.get("since", 0)),
        "rate": _number(attrs.get("rate")) and 0.0 <= attrs["rate"] < math.inf,
        "reach": isinstance(reach, list) and all(_number(one) and one >= 0.0 for one in reach),
    }
    if run:
        frame = attrs.get("frame")
        good["frame"] = _count(frame, layout.MOST_FRAMES)
        good["scene"] = isinstance(attrs.get("scene"), dict)
        history = attrs.get("history", [])
        good["history"] = isinstance(history, list)
        good["tables"] = isinstance(attrs.get("tables", {}), dict)
    for name, is_good in good.items():
        if not is_good:
            raise Mismatch(f"{path}: attrs: {name} cannot be {attrs.get(name)!r:.60}")


def _number(value):
    return isinstance(value, int | float) and not isinstance(value, bool)


def _count(value, most=1 << 62):
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < most


def check_flow(simulation: Simulation, saved: checkpoint.Checkpoint) -> list[list[int]]:
    """What came and went so far (tally.Tally.totals). Raises Mismatch where that does not fit the
    particles that are there."""
    found: Any = saved.attrs.get("flow")
    groups = len(simulation.groups)
    good = isinstance(found, list) and len(found) == groups
    for g, row in enumerate(found if good else []):
        good = good and isinstance(row, list) and len(row) == 4
        good = good and all(_count(one, 1 << 120) for one in row)
        good = good and row[0] - row[2] == saved.count(f"group_{g:03d}/id")
    if not good:
        raise Mismatch(f"{saved.path}: attrs: flow cannot be {found!r:.60}")
    return found


def check_given(saved: checkpoint.Checkpoint) -> dict:
    """What colliders and walls gave so far (given.Given.saved); nothing where the run did not ask.
    Raises Mismatch where it cannot be."""
    found: Any = saved.attrs.get("given", {"mass": 0.0, "totals": []})
    good = isinstance(found, dict) and _number(found.get("mass")) and 0.0 <= found["mass"] < 1e100
    rows: Any = found.get("totals") if good else None
    good = isinstance(rows, list)
    for row in rows if good else []:
        good = good and isinstance(row, list) and len(row) == NUMBERS
        good = good and all(_number(one) and abs(one) < 1e100 for one in row)
    if not good:
        raise Mismatch(f"{saved.path}: attrs: given cannot be {found!r:.60}")
    return found


def check_rows(
    simulation: Simulation, saved: checkpoint.Checkpoint
) -> list[tuple[np.ndarray, np.ndarray]]:
    """This rank's share of the segments of every group: code and count of each, (n,). Raises
    Mismatch on all ranks where a dataset is not as this scene's plan has it, or a row cannot be.
    Collective."""
    names = [f"group_{g:03d}" for g in range(len(simulation.groups))]
    if saved.names("/") != ["attrs", *names]:
        raise Mismatch(f"{saved.path}: holds {', '.join(saved.names('/'))}")
    for name, group in zip(names, simulation.groups, strict=True):
        _check_form(simulation, saved, name, group)
    ranks = simulation.ranks
    shares = []
    problem = ""
    for name in names:
        found, code, count = _segments(simulation, saved, name)
        shares.append((code, count))
        problem = problem or found
    _agree(saved, ranks, problem)
    sums = [ranks.total(int(count.sum())) for _, count in shares]
    for name, total in zip(names, sums, strict=True):
        if total != saved.count(f"{name}/id"):
            raise Mismatch(f"{saved.path}: {name}/count: they are not the particles' sum")
    ids = []
    for g, (code, count) in enumerate(shares):
        first = ranks.before(int(count.sum()))
        block = np.repeat(simulation.lattice.block(code), count, axis=0)
        for start in range(0, len(block), ROWS):
            some = block[start : start + ROWS]
            found, mine = _rows(simulation, saved, g, first + start, some)
            problem = problem or found
            ids.append(mine)
    _agree(saved, ranks, problem)
    _agree(saved, ranks, _twice(simulation, ids))
    return shares


def _agree(saved, ranks, problem):
    said = checkpoint.first_of(ranks, problem)
    if said:
        raise Mismatch(f"{saved.path}: {said}")


def _check_form(simulation, saved, name, group):
    """Types and shapes of a group's datasets; every rank finds the same."""
    real, channels = simulation.plan.real, group.plan.channels
    have = channels.width("state")
    found = saved.width(f"{name}/state") if "state" in saved.names(name) else 0
    if found != have:
        raise Mismatch(
            f"{saved.path}: a particle of {group.plan.name} carries {found} numbers besides its"
            f" motion, in this scene {have} (material, deforms, appearance.colour_transfer)"
        )
    n, b = saved.count(f"{name}/id"), saved.count(f"{name}/block")
    whole = np.dtype(np.int64)
    want = {"block": ((b,), whole), "count": ((b,), whole), "id": ((n,), whole)}
    want["x"] = ((n, 3), np.dtype(INTEGER[np.dtype(real)]))
    want |= {key: ((n, channels.width(key)), np.dtype(real)) for key in channels.datasets}
    if sorted(want) != saved.names(name):
        raise Mismatch(f"{saved.path}: {name} holds {', '.join(saved.names(name))}")
    for key, form in want.items():
        if saved.form(f"{name}/{key}") != form:
            shape, kind = saved.form(f"{name}/{key}")
            raise Mismatch(f"{saved.path}: {name}/{key} is {kind} {shape}, not {form[1]} {form[0]}")


def _segments(simulation, saved, name):
    """What is wrong with this rank's share of a group's segments, or ""; code and count of each."""
    ranks, lattice = simulation.ranks, simulation.lattice
    total = saved.count(f"{name}/block")
    first, last = (total * r // ranks.size for r in (ranks.rank, ranks.rank + 1))
    code = saved.read_rows(f"{name}/block", max(first - 1, 0), last)  # and the one above
    count = saved.read_rows(f"{name}/count", first, last)
    most = saved.count(f"{name}/id")
    if ((code < 0) | (code >= math.prod(lattice.shape))).any():
        return f"{name}/block: names blocks outside the domain", code[:0], count[:0]
    if (np.diff(lattice.key(lattice.block(code))) <= 0).any():
        return f"{name}/block: is not in the order of the blocks", code[:0], count[:0]
    if ((count < 0) | (count > most)).any():
        return f"{name}/count: is not one of particles", code[:0], count[:0]
    return "", code[len(code) - len(count) :], count


def _rows(simulation, saved, g, first, block):
    """What is wrong with the particles from row `first` on in these blocks (n, 3), or ""; and their
    ids."""
    plan, name, last = simulation.plan, f"group_{g:03d}", first + len(block)
    ids = saved.read_rows(f"{name}/id", first, last)
    wrong = (ids < 0) | (ids >= plan.particles)
    if not wrong.any():
        thing = simulation.object_of(ids)
        wrong = np.array(plan.group_of)[thing] != g
        for one in plan.driven:  # what was let go is in the group that it joins
            wrong &= ~(np.isin(thing, one.things) & (one.joins == g))
    if wrong.any():
        row = int(np.argmax(wrong))
        return f"{name}/id: row {first + row}: {ids[row]} is no particle of it", ids[:0]
    xi, bits = saved.read_rows(f"{name}/x", first, last), BITS[np.dtype(plan.real)]
    at = np.ldexp(xi.astype(np.float64), -bits) + MIDDLE + EDGE * block  # [cells]
    far = (xi <= -REACH << bits) | (xi >= REACH << bits)
    wrong = (far | (at <= -0.5) | (at >= np.array(plan.cells) + 0.5)).any(1)
    if wrong.any():
        row = int(np.argmax(wrong))
        where = "outside its block or the domain"
        return f"{name}/x: row {first + row}: {xi[row].tolist()} is {where}", ids
    for key in simulation.groups[g].plan.channels.datasets:
        values = saved.read_rows(f"{name}/{key}", first, last)
        wrong = ~np.isfinite(values).all(1)
        if key == "vol0":
            wrong |= ~(values[:, 0] > 0.0)
        if wrong.any():
            row = int(np.argmax(wrong))
            return f"{name}/{key}: row {first + row}: cannot be {values[row].tolist()}", ids
    return "", ids


def _twice(simulation, parts):
    """What is wrong where a particle is there twice, or ""; every rank looks at a range of ids.
    Collective."""
    ranks, total = simulation.ranks, simulation.plan.particles
    ids = np.sort(np.concatenate([np.zeros(0, np.int64), *parts]))
    bounds = [total * r // ranks.size for r in range(1, ranks.size)]
    came = ranks.exchange(np.split(ids, np.searchsorted(ids, bounds)))
    ids = np.sort(np.concatenate(came))
    same = np.flatnonzero(np.diff(ids) == 0)
    return f"particle {ids[same[0]]} is in it twice" if len(same) else ""
