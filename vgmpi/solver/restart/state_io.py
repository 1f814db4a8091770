"""State of a simulation as rows: single precision for frames, bit by bit for checkpoints."""

import numpy as np

from vgmpi.io.checkpoint import Mismatch
from vgmpi.kernels.step_records import ParticleMaxima
from vgmpi.materials.material import law_function
from vgmpi.parallel.block_ownership import BlockDirectory, build_block_directory
from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.parallel.particle_group import SIMD_WIDTH, ParticleGroup
from vgmpi.solver.diagnostics.particle_fields import continuum_rows
from vgmpi.solver.diagnostics.volume_fractions import volume_fractions
from vgmpi.solver.simulation import Simulation

from .checkpoint_validation import check_attrs, check_rows


def frame_rows(simulation: Simulation, names: tuple[str, ...]) -> tuple[np.ndarray, dict]:
    """Return the ids (n_local,) and the fields of a frame, rows in any order.

    Args:
        simulation: The simulation.
        names: Optional fields: velocity, J, F, stress, pressure, strain, volume_fraction. Fields x,
            object and phase are always included. F is left out unless a body of the scene carries
            it; features add fields of their own. Collective with volume_fraction.
    """
    ids, group_rows = [], []
    deforms = any(group.has_deformation for group in simulation.plan.groups)
    if "volume_fraction" in names:
        fractions = volume_fractions(simulation)
    for g, group in enumerate(simulation.groups):
        indices = group.index()
        state = group.law_state(indices)
        J = np.asarray(
            law_function(group.plan.law, "volume_ratio")(group.plan.law, state), np.float32
        )
        row = {
            "positions": group.positions().astype(np.float32),
            "object": simulation.object_of(group.ids[indices]).astype(np.int32),
            "phase": np.full(len(indices), group.plan.phase, np.int32),
        }
        if "velocity" in names:
            row["velocity"] = group.get("v", indices).astype(np.float32)
        if "J" in names:
            row["J"] = J
        if "F" in names and deforms:
            row["F"] = _gradient(group, indices, J).astype(np.float32)
        fields = continuum_rows(group, indices, names)
        row |= {name: rows.astype(np.float32) for name, rows in fields.items()}
        if "volume_fraction" in names:
            row["volume_fraction"] = fractions[g].astype(np.float32)
        for feature in simulation.features.values():
            row |= feature.frame_rows(group, indices)
        ids.append(group.ids[indices])
        group_rows.append(row)
    return np.concatenate(ids), {
        k: np.concatenate([row[k] for row in group_rows]) for k in group_rows[0]
    }


def _gradient(group, indices, J) -> np.ndarray:
    """Return the deformation gradients F, row by row, shape (n, 9).

    A material without F gets the isotropic one of its volume ratio.
    """
    if "H" not in group.plan.carries and not group.plan.tracks_deformation:
        return np.cbrt(J)[:, None] * np.eye(3).ravel()
    carried = group.get("F" if group.plan.tracks_deformation else "H", indices)
    return carried + np.eye(3).ravel()


def by_id(simulation: Simulation, *names: str) -> list[np.ndarray]:
    """Return particle arrays of all ranks in the order of their ids, on every rank. Collective.

    Args:
        simulation: The simulation.
        names: x (n, 3) [m], v (n, 3) [m/s], C (n, 9) [1/s], vol0 (n,) [m3], J (n,), F (n, 9),
            stress (n, 6) [Pa], pressure (n,) [Pa], strain (n, 6), object (n,), phase (n,), id (n,).

    Returns:
        One array per name, in double precision or int64.
    """

    def rows(name: str) -> np.ndarray:
        """Return one array of all ranks, unsorted."""
        local = [_rows(simulation, group, name) for group in simulation.groups]
        gathered = simulation.ranks.all_rows(np.concatenate(local))
        return gathered if gathered.dtype.kind == "i" else gathered.astype(np.float64)

    order = np.argsort(rows("id"))
    return [rows(name)[order] for name in names]


def _rows(simulation: Simulation, group: ParticleGroup, name: str) -> np.ndarray:
    """Return an array of `by_id` for the particles of a group on this rank."""
    indices, plan = group.index(), group.plan
    if name == "id":
        return group.ids[indices]
    if name == "x":
        return group.positions()
    if name == "object":
        return simulation.object_of(group.ids[indices])
    if name == "phase":
        return np.full(len(indices), plan.phase)
    if name in ("J", "F"):
        J = law_function(plan.law, "volume_ratio")(plan.law, group.law_state(indices))
        return _gradient(group, indices, J) if name == "F" else np.asarray(J)
    if name in ("stress", "pressure", "strain"):
        return continuum_rows(group, indices, (name,))[name]
    values = group.get(name, indices)
    return values[:, 0] if name == "vol0" else values


def save(simulation: Simulation) -> dict:
    """Return the content of a checkpoint, see io/checkpoint.py.

    It holds segments and particles in key order with fixed-point positions. Ranks own consecutive
    pieces of that order, so their concatenated rows do not depend on the number of ranks.
    """
    groups = {}
    for g, group in enumerate(simulation.groups):
        indices = group.index()
        rows = {"block": group.code, "count": group.count, "id": group.ids[indices]}
        rows["x"] = np.ascontiguousarray(group.xi[:, indices].T)
        for name, channels in group.plan.channels.datasets.items():
            rows[name] = np.ascontiguousarray(group.f[channels, indices].T)
        groups[f"group_{g:03d}"] = rows
    attrs = {
        "time": simulation.time,
        "step": simulation.step,
        "rate": simulation.rate,
        "reach": list(simulation.particle_maxima),
        "group_names": [group.name for group in simulation.plan.groups],
        "precision": simulation.plan.real.name,
        "cells": list(simulation.plan.cells),
        "dx": simulation.plan.dx,
    }
    for feature in simulation.features.values():
        attrs |= feature.saved()
    return {"attrs": attrs, "groups": groups}


def restore(simulation: Simulation, saved) -> None:
    """Restore a checkpoint on this number of ranks, without a sort. Collective.

    Args:
        simulation: A simulation without particles (in/out).
        saved: An open io.checkpoint.Checkpoint.

    Raises:
        Mismatch: On all ranks, if the checkpoint does not belong to the scene.
    """
    plan = simulation.plan
    expected = {
        "group_names": [group.name for group in plan.groups],
        "precision": plan.real.name,
        "cells": list(plan.cells),
        "dx": plan.dx,
    }
    for name, value in expected.items():
        if saved.attrs.get(name) != value:
            raise Mismatch(
                f"{saved.path}: {name} is {saved.attrs.get(name)}, the scene has {value}"
            )
    check_attrs(saved.path, saved.attrs, run=False)
    segments = check_rows(simulation, saved)
    simulation.time, simulation.step = saved.attrs["time"], saved.attrs["step"]
    simulation.rate = saved.attrs["rate"]
    simulation.particle_maxima = ParticleMaxima(*saved.attrs["reach"])
    simulation.sorted_at = simulation.step
    for feature in simulation.features.values():
        feature.place_saved(saved.attrs, simulation.time)
    rows = [_segments(simulation, g, *share) for g, share in enumerate(segments)]
    costs = np.array([group.cost for group in plan.groups])
    table, simulation.cut = build_block_directory(
        np.concatenate(rows), simulation.lattice, simulation.ranks, costs, None, 0
    )
    for g, group in enumerate(simulation.groups):
        _read_group(group, saved, f"group_{g:03d}", table, g, simulation.ranks)
    simulation.set_directory(table)
    for feature in simulation.features.values():
        feature.restore(saved)


def _segments(simulation: Simulation, g: int, code: np.ndarray, count: np.ndarray) -> np.ndarray:
    """Return the segments of a group without owners, shape (n, 4): key, code, group, count."""
    key = simulation.lattice.key(simulation.lattice.block(code))
    return np.stack([key, code, np.full_like(key, g), count], 1)


def _read_group(
    group, saved, name: str, table: BlockDirectory, g: int, ranks: SerialCommunicator
) -> None:
    """Read the particles of this rank's blocks, which follow the rows of lower ranks.

    Args:
        group: Particle group (in/out).
        saved: The checkpoint.
        name: Name of the group in the file.
        table: Directory of blocks and their owners.
        g: Index of the group.
        ranks: Communicator.
    """
    is_local = (table.group == g) & (table.owner == ranks.rank)
    code, count = table.code[is_local], table.particles[is_local]
    first = ranks.before(int(count.sum()))
    last = first + int(count.sum())
    padded = (count + SIMD_WIDTH - 1) // SIMD_WIDTH * SIMD_WIDTH
    start = np.concatenate([[0], np.cumsum(padded)])
    group.reserve(int(start[-1]))
    group.segments(code, start[:-1], count)
    group.used = int(start[-1])
    indices = group.index()
    group.ids[indices] = saved.read_rows(f"{name}/id", first, last)
    group.xi[:, indices] = saved.read_rows(f"{name}/x", first, last).T
    for dataset, channels in group.plan.channels.datasets.items():
        group.f[channels, indices] = saved.read_rows(f"{name}/{dataset}", first, last).T
