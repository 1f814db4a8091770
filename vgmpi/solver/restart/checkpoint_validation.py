"""Validation of a checkpoint's content against the scene, before any of it reaches a kernel.

Checksums find accidental damage. This module looks at every number, so that a fabricated file
also ends in one clear line: each rank looks at its share of the rows, and all ranks raise the
first complaint.
"""

import math
from typing import Any

import numpy as np

from vgmpi.io import checkpoint, file_layout
from vgmpi.io.checkpoint import Mismatch, is_count, is_number
from vgmpi.kernels.transfer.g2p import MAX_STRAY_CELLS
from vgmpi.parallel.block_lattice import BITS, BLOCK_CENTER, BLOCK_EDGE, INTEGER
from vgmpi.planning.region_groups import groups_of_particles
from vgmpi.solver.simulation import Simulation

ROWS = 1 << 20  # number of rows validated together


def check_attrs(path: Any, attrs: dict, run: bool = True) -> None:
    """Validate the clock and the numbers in the attributes of a checkpoint.

    Args:
        path: The checkpoint, for messages.
        attrs: Its attributes.
        run: Also validate the attributes that only a run writes: scene, frame, history, tables.

    Raises:
        Mismatch: If an attribute is missing or impossible.
    """
    reach = attrs.get("reach")
    checks = {
        "time": is_number(attrs.get("time")) and 0.0 <= attrs["time"] < 1e100,
        "sorted_time": is_number(sorted_time := attrs.get("sorted_time", 0.0))
        and 0.0 <= sorted_time < 1e100,
        "step": is_count(attrs.get("step")),
        "since": is_count(attrs.get("since", 0)),
        "rate": is_number(attrs.get("rate")) and 0.0 <= attrs["rate"] < math.inf,
        "reach": isinstance(reach, list)
        and all(is_number(value) and value >= 0.0 for value in reach),
    }
    if run:
        frame = attrs.get("frame")
        checks["frame"] = is_count(frame, file_layout.MAX_FRAMES)
        checks["scene"] = isinstance(attrs.get("scene"), dict)
        history = attrs.get("resume_history", [])
        checks["resume_history"] = isinstance(history, list)
        checks["log_checksums"] = isinstance(attrs.get("log_checksums", {}), dict)
    for name, is_good in checks.items():
        if not is_good:
            raise Mismatch(f"{path}: attrs: {name} cannot be {attrs.get(name)!r:.60}")


def check_rows(
    simulation: Simulation, saved: checkpoint.Checkpoint
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Validate all datasets of the groups. Collective.

    Args:
        simulation: A simulation of the scene.
        saved: The checkpoint.

    Returns:
        Code and particle count (n,) of this rank's share of the segments, for every group.

    Raises:
        Mismatch: On all ranks, if a dataset does not fit the plan or a row is impossible.
    """
    names = [f"group_{g:03d}" for g in range(len(simulation.groups))]
    if saved.names("/") != ["attrs", *names]:
        raise Mismatch(f"{saved.path}: holds {', '.join(saved.names('/'))}")
    for name, group in zip(names, simulation.groups, strict=True):
        _check_form(simulation, saved, name, group)
    ranks = simulation.ranks
    segments = []
    problem = ""
    for name in names:
        new_problem, code, count = _segments(simulation, saved, name)
        segments.append((code, count))
        problem = problem or new_problem
    _agree(saved, ranks, problem)
    sums = [ranks.total(int(count.sum())) for _, count in segments]
    for name, total in zip(names, sums, strict=True):
        if total != saved.count(f"{name}/id"):
            raise Mismatch(f"{saved.path}: {name}/count: they are not the particles' sum")
    ids = []
    for g, (code, count) in enumerate(segments):
        first = ranks.before(int(count.sum()))
        block = np.repeat(simulation.lattice.block(code), count, axis=0)
        for start in range(0, len(block), ROWS):
            block_rows = block[start : start + ROWS]
            new_problem, own_ids = _rows(simulation, saved, g, first + start, block_rows)
            problem = problem or new_problem
            ids.append(own_ids)
    _agree(saved, ranks, problem)
    _agree(saved, ranks, _repeated_particle(simulation, ids))
    return segments


def _agree(saved, ranks, problem):
    """Raise Mismatch on all ranks if one of them has a problem. Collective."""
    message = checkpoint.lowest_rank_message(ranks, problem)
    if message:
        raise Mismatch(f"{saved.path}: {message}")


def _check_form(simulation, saved, name, group):
    """Validate types and shapes of a group's datasets; every rank finds the same."""
    real, channels = simulation.plan.real, group.plan.channels
    own_width = channels.width("state")
    width = saved.width(f"{name}/state") if "state" in saved.names(name) else 0
    if width != own_width:
        raise Mismatch(
            f"{saved.path}: a particle of {group.plan.name} carries {width} numbers besides its"
            f" motion, in this scene {own_width}"
            " (material, track_deformation, appearance.color_transfer)"
        )
    n, b = saved.count(f"{name}/id"), saved.count(f"{name}/block")
    integer = np.dtype(np.int64)
    expected = {"block": ((b,), integer), "count": ((b,), integer), "id": ((n,), integer)}
    expected["x"] = ((n, 3), np.dtype(INTEGER[np.dtype(real)]))
    expected |= {key: ((n, channels.width(key)), np.dtype(real)) for key in channels.datasets}
    if sorted(expected) != saved.names(name):
        raise Mismatch(f"{saved.path}: {name} holds {', '.join(saved.names(name))}")
    for key, own_form in expected.items():
        if saved.form(f"{name}/{key}") != own_form:
            shape, kind = saved.form(f"{name}/{key}")
            raise Mismatch(
                f"{saved.path}: {name}/{key} is {kind} {shape}, not {own_form[1]} {own_form[0]}"
            )


def _segments(simulation, saved, name):
    """Validate this rank's share of a group's segments.

    Returns:
        The problem, or "", and code and count of each segment.
    """
    ranks, lattice = simulation.ranks, simulation.lattice
    total = saved.count(f"{name}/block")
    first, last = (total * r // ranks.size for r in (ranks.rank, ranks.rank + 1))
    code = saved.read_rows(f"{name}/block", max(first - 1, 0), last)  # with the preceding segment
    count = saved.read_rows(f"{name}/count", first, last)
    max_count = saved.count(f"{name}/id")
    if ((code < 0) | (code >= math.prod(lattice.shape))).any():
        return f"{name}/block: names blocks outside the domain", code[:0], count[:0]
    if (np.diff(lattice.key(lattice.block(code))) <= 0).any():
        return f"{name}/block: is not in the order of the blocks", code[:0], count[:0]
    if ((count < 0) | (count > max_count)).any():
        return f"{name}/count: is not one of particles", code[:0], count[:0]
    return "", code[len(code) - len(count) :], count


def _rows(simulation, saved, g, first, block):
    """Validate the particles from row `first` on, which lie in the blocks (n, 3).

    Returns:
        The problem, or "", and the ids.
    """
    plan, name, last = simulation.plan, f"group_{g:03d}", first + len(block)
    ids = saved.read_rows(f"{name}/id", first, last)
    wrong = (ids < 0) | (ids >= plan.particles)
    if not wrong.any():
        owner = simulation.object_of(ids)
        usual = groups_of_particles(plan, ids, owner)
        wrong = usual != g
        # released particles are in the group that they join
        released = [part for feature in plan.features for part in feature.released_particles()]
        wrong &= ~np.isin(usual, [part.group for part in released if part.group_after_release == g])
        for feature in plan.features:
            wrong &= ~feature.may_hold(g, usual)
    if wrong.any():
        row = int(np.argmax(wrong))
        return f"{name}/id: row {first + row}: {ids[row]} is no particle of it", ids[:0]
    xi, bits = saved.read_rows(f"{name}/x", first, last), BITS[np.dtype(plan.real)]
    position = np.ldexp(xi.astype(np.float64), -bits) + BLOCK_CENTER + BLOCK_EDGE * block  # [cells]
    outside_block = (xi <= -MAX_STRAY_CELLS << bits) | (xi >= MAX_STRAY_CELLS << bits)
    wrong = (outside_block | (position <= -0.5) | (position >= np.array(plan.cells) + 0.5)).any(1)
    if wrong.any():
        row = int(np.argmax(wrong))
        reason = "outside its block or the domain"
        return f"{name}/x: row {first + row}: {xi[row].tolist()} is {reason}", ids
    for key in simulation.groups[g].plan.channels.datasets:
        values = saved.read_rows(f"{name}/{key}", first, last)
        wrong = ~np.isfinite(values).all(1)
        if key == "vol0":
            wrong |= ~(values[:, 0] > 0.0)
        if wrong.any():
            row = int(np.argmax(wrong))
            return f"{name}/{key}: row {first + row}: cannot be {values[row].tolist()}", ids
    return "", ids


def _repeated_particle(simulation, id_chunks):
    """Return the problem if a particle occurs twice, else "". Collective.

    Every rank looks at a range of ids.
    """
    ranks, total = simulation.ranks, simulation.plan.particles
    ids = np.sort(np.concatenate([np.zeros(0, np.int64), *id_chunks]))
    bounds = [total * r // ranks.size for r in range(1, ranks.size)]
    received = ranks.exchange(np.split(ids, np.searchsorted(ids, bounds)))
    ids = np.sort(np.concatenate(received))
    repeated = np.flatnonzero(np.diff(ids) == 0)
    return f"particle {ids[repeated[0]]} is in it twice" if len(repeated) else ""
