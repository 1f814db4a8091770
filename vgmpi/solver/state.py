"""A simulation's state as rows: for frames in single precision, for checkpoints bit by bit."""

import numpy as np

from ..domain.census import Census, census
from ..domain.ranks import Alone
from ..domain.state import LANES
from ..engines.base import UNKNOWN, Reach
from ..materials.base import function
from .bounds import Mismatch, check_attrs, check_flow, check_given, check_rows
from .step import Simulation


def frame_rows(simulation: Simulation, names: tuple[str, ...]) -> tuple[np.ndarray, dict]:
    """Ids (n_local,) and the fields of a frame, rows in any order.

    names: of velocity, J, F; x, object and phase are always there. F only where a body in the
    scene carries it, colour where colours travel with the steps.
    """
    ids, found = [], []
    deforms = any("H" in group.carries or group.followed for group in simulation.plan.groups)
    for group in simulation.groups:
        at = group.index()
        state = group.law_state(at)
        J = np.asarray(function(group.plan.law, "volume_ratio")(group.plan.law, state), np.float32)
        row = {
            "x": group.positions().astype(np.float32),
            "object": simulation.object_of(group.ids[at]).astype(np.int32),
            "phase": np.full(len(at), group.plan.phase, np.int32),
        }
        if "velocity" in names:
            row["velocity"] = group.get("v", at).astype(np.float32)
        if "J" in names:
            row["J"] = J
        if "F" in names and deforms:
            row["F"] = _gradient(group, at, J)
        if simulation.plan.colours is not None:
            row["colour"] = _colour(group, at, simulation.plan.colours)
        ids.append(group.ids[at])
        found.append(row)
    return np.concatenate(ids), {k: np.concatenate([row[k] for row in found]) for k in found[0]}


def _gradient(group, at, J) -> np.ndarray:
    """F, row by row, (n, 9): where nothing carries it the isotropic one of the volume."""
    if "H" not in group.plan.carries and not group.plan.followed:
        return (np.cbrt(J)[:, None] * np.eye(3).ravel()).astype(np.float32)
    carried = group.get("F" if group.plan.followed else "H", at)
    return (carried + np.eye(3).ravel()).astype(np.float32)


def _colour(group, at, colours) -> np.ndarray:
    """Coefficients of colours, (n, 3 K) with K the most of any; nan where none travel."""
    out = np.full((len(at), 3 * colours.coefficients.max()), np.nan, np.float32)
    count = 3 * group.plan.coefficients
    least = colours.least[group.plan.phase].ravel()[:count]
    if count:
        out[:, :count] = group.get("colour", at) + least
    return out


def by_id(simulation: Simulation, *names: str) -> list[np.ndarray]:
    """Arrays of all particles of all ranks in the order of their ids, on every rank. Collective.

    names: x (n, 3) [m], v (n, 3) [m/s], C (n, 9) [1/s], vol0 (n,) [m3], J (n,), object (n,), id
    (n,). Double precision, or whole numbers.
    """
    parts = {
        "id": lambda group, at: group.ids[at],
        "x": lambda group, at: group.positions(),
        "v": lambda group, at: group.get("v", at),
        "C": lambda group, at: group.get("C", at),
        "vol0": lambda group, at: group.get("vol0", at)[:, 0],
        "J": lambda group, at: function(group.plan.law, "volume_ratio")(
            group.plan.law, group.law_state(at)
        ),
        "object": lambda group, at: simulation.object_of(group.ids[at]),
    }

    def rows(name: str) -> np.ndarray:
        mine = [parts[name](group, group.index()) for group in simulation.groups]
        whole = simulation.ranks.all_rows(np.concatenate(mine))
        return whole if whole.dtype.kind == "i" else whole.astype(np.float64)

    order = np.argsort(rows("id"))
    return [rows(name)[order] for name in names]


def save(simulation: Simulation) -> dict:
    """What a checkpoint holds, see output/checkpoint.py: segments and particles in key order,
    fixed-point positions.

    Ranks own consecutive pieces of that order, so their rows one after the other do not depend on
    their number.
    """
    groups = {}
    for g, group in enumerate(simulation.groups):
        at = group.index()
        rows = {"block": group.code, "count": group.count, "id": group.ids[at]}
        rows["x"] = np.ascontiguousarray(group.xi[:, at].T)
        for name, channels in group.plan.channels.datasets.items():
            rows[name] = np.ascontiguousarray(group.f[channels, at].T)
        groups[f"group_{g:03d}"] = rows
    attrs = {
        "time": simulation.time,
        "step": simulation.step,
        "rate": simulation.rate,
        "reach": list(simulation.reach),
        "group_names": [group.name for group in simulation.plan.groups],
        "precision": simulation.plan.real.name,
        "cells": list(simulation.plan.cells),
        "dx": simulation.plan.dx,
    }
    if simulation.movers is not None:
        attrs["sorted_time"] = simulation.movers.since
    if simulation.releases is not None:
        attrs["since"] = simulation.since
    if simulation.given is not None:
        attrs["given"] = simulation.given.saved()
    if simulation.tally is not None:
        attrs["flow"] = simulation.tally.totals(simulation.ranks)
    return {"attrs": attrs, "groups": groups}


def restore(simulation: Simulation, saved) -> None:
    """Take up a checkpoint (output.checkpoint.Checkpoint) on this number of ranks, without
    re-sorting. Collective. Raises Mismatch on all ranks.
    """
    plan = simulation.plan
    want = {
        "group_names": [group.name for group in plan.groups],
        "precision": plan.real.name,
        "cells": list(plan.cells),
        "dx": plan.dx,
    }
    for name, value in want.items():
        if saved.attrs.get(name) != value:
            raise Mismatch(
                f"{saved.path}: {name} is {saved.attrs.get(name)}, the scene has {value}"
            )
    check_attrs(saved.path, saved.attrs, run=False)
    shares = check_rows(simulation, saved)
    if simulation.tally is not None:
        simulation.tally.adopt(check_flow(simulation, saved), simulation.ranks)
    simulation.time, simulation.step = saved.attrs["time"], saved.attrs["step"]
    simulation.rate = saved.attrs["rate"]
    simulation.reach = Reach(*saved.attrs.get("reach", UNKNOWN))
    simulation.sorted_at = simulation.step
    simulation.since = saved.attrs.get("since", 0)
    if simulation.releases is not None:
        simulation.releases.open_walls(simulation.time)
    if simulation.movers is not None:  # the blocks near them are those of the last sort
        simulation.movers.stand(saved.attrs.get("sorted_time", simulation.time))
    rows = [_segments(simulation, g, *share) for g, share in enumerate(shares)]
    costs = np.array([group.cost for group in plan.groups])
    table, simulation.cut = census(
        np.concatenate(rows), simulation.lattice, simulation.ranks, costs, None, 0
    )
    for g, group in enumerate(simulation.groups):
        _read_group(group, saved, f"group_{g:03d}", table, g, simulation.ranks)
    simulation.adopt(table)
    if simulation.given is not None:
        simulation.given.weigh(simulation.groups)
        simulation.given.adopt(check_given(saved))


def _segments(simulation: Simulation, g: int, code: np.ndarray, count: np.ndarray) -> np.ndarray:
    """Segments of a group, whoever will own them: (n, 4) of key, code, group, count."""
    key = simulation.lattice.key(simulation.lattice.block(code))
    return np.stack([key, code, np.full_like(key, g), count], 1)


def _read_group(group, saved, name: str, table: Census, g: int, ranks: Alone) -> None:
    """Read the particles of this rank's blocks: the rows behind those of the ranks below it."""
    own = (table.group == g) & (table.owner == ranks.rank)
    code, count = table.code[own], table.particles[own]
    first = ranks.before(int(count.sum()))
    last = first + int(count.sum())
    padded = (count + LANES - 1) // LANES * LANES
    start = np.concatenate([[0], np.cumsum(padded)])
    group.reserve(int(start[-1]))
    group.segments(code, start[:-1], count)
    group.used = int(start[-1])
    at = group.index()
    group.ids[at] = saved.read_rows(f"{name}/id", first, last)
    group.xi[:, at] = saved.read_rows(f"{name}/x", first, last).T
    for piece, channels in group.plan.channels.datasets.items():
        group.f[channels, at] = saved.read_rows(f"{name}/{piece}", first, last).T
