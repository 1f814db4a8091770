"""Insertion and removal of particles: from rows in SI units to the channels of their groups."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from vgmpi.kernels.kernel_arguments import MAX_VOLUME_STRAIN_PER_STEP
from vgmpi.kernels.step_records import ParticleBounds
from vgmpi.materials.material import law_function
from vgmpi.parallel import migration
from vgmpi.parallel.block_lattice import BlockLattice
from vgmpi.parallel.particle_group import ParticleGroup
from vgmpi.planning.phases_and_groups import GroupPlan
from vgmpi.planning.plan import Plan
from vgmpi.planning.region_groups import groups_of_particles


class ParticleRows(NamedTuple):
    """Particles to be inserted, as rows in SI units."""

    x: np.ndarray  # (n, 3) [m] positions
    v: np.ndarray  # (n, 3) [m/s] velocities
    volume: np.ndarray  # (n,) [m3] rest volumes
    ids: np.ndarray  # (n,)
    owner: np.ndarray  # (n,) object or particle source of each particle
    theta: np.ndarray | None = None  # (n,) ln J of fluids, None for 0
    C: np.ndarray | None = None  # (n, 9) [1/s] velocity gradients, None for 0
    sh: np.ndarray | None = None  # (n, K, 3) colors
    surface: np.ndarray | None = None  # (n, 10) surface descriptors of solids

    def select(self, mask: np.ndarray) -> "ParticleRows":
        """Return the particles selected by a mask (n,)."""
        parts: list = [None if rows is None else rows[mask] for rows in self]
        return ParticleRows(*parts)


def insert_particles(
    plan: Plan, lattice: BlockLattice, groups: list[ParticleGroup], rows: ParticleRows,
    features: Iterable,
) -> ParticleBounds:  # fmt: skip
    """Insert particles into the groups of this rank; a sort must follow.

    Args:
        plan: Plan of the run.
        lattice: Block lattice of the domain.
        groups: Particle groups (in/out).
        rows: Particles to insert.
        features: Features of the run (ActiveFeature), which may choose other groups.

    Returns:
        Bounds of the time step and the sums.
    """
    group_of = groups_of_particles(plan, rows.ids, rows.owner)
    for feature in features:
        group_of = feature.assign_groups(group_of, rows.x)
    bounds = ParticleBounds()
    for g, group in enumerate(groups):
        selected = rows.select(group_of == g)
        block, xi = lattice.place(selected.x, plan.real)
        channels, states = _channels(plan, group.plan, selected, len(xi[0]), features)
        if len(selected.x):
            gradients = selected.C if selected.C is not None else np.zeros((1, 9))
            own = bounds_of(plan, group.plan, states, selected.v, gradients)
            bounds = bounds.merge(own)
        migration.append_particles(group, block, xi, channels, selected.ids)
    return bounds


def _channels(
    plan: Plan, group: GroupPlan, rows: ParticleRows, count: int, features: Iterable
) -> tuple[np.ndarray, list]:
    """Return channel values (channels, count) and the states that bound those of the particles."""
    channels = group.channels
    values = np.repeat(np.array(channels.reference, plan.real)[:, None], count, axis=1)
    values[channels["v"].rows] = rows.v.T
    if rows.C is not None:
        values[channels["C"].rows] = rows.C.T
    values[channels["vol0"].rows] = rows.volume
    if group.surface and rows.surface is not None:
        values[channels["surface"].rows] = rows.surface.T
    for feature in features:
        for name, own in feature.channel_values(group, rows).items():
            values[channels[name].rows] = own.T
    states = [group.reference]
    if rows.theta is not None and group.family == "fluid":
        values[channels["theta"].rows] = rows.theta
        # the fastest wave is at an end of the range, on which all ranks agree bit by bit
        states += [(end, *group.reference[1:]) for end in _ends(rows.theta)]
    return values, states


def bounds_of(
    plan: Plan, group: GroupPlan, states: list, v: np.ndarray, C: np.ndarray
) -> ParticleBounds:
    """Bound the time step and the nodal sums for particles of one group.

    Args:
        plan: Plan of the run.
        group: Plan of the group.
        states: Constitutive states in which particles begin.
        v: Velocities, shape (n, 3) [m/s].
        C: Velocity gradients, shape (n, 9) [1/s].
    """
    law, dx, cfl = group.law, plan.dx, plan.time_step.cfl
    wave2 = group.bound(max(law_function(law, "wave_speed2")(law, state) for state in states))
    tau = [np.abs(law_function(law, "stress")(law, state, (0.0,) * 9)).sum() for state in states]
    speed, wave = float(np.sqrt((v**2).sum(1)).max()), float(np.sqrt(wave2))
    rate = max((wave + speed) / (cfl * dx), speed / (plan.time_step.max_cells * dx))
    rate = max(rate, float(np.abs(C[:, 0] + C[:, 4] + C[:, 8]).max()) / MAX_VOLUME_STRAIN_PER_STEP)
    stress = float(max(tau)) / (group.density * group.wave.min_porosity)
    return ParticleBounds(rate, speed, float(np.sqrt((C**2).sum(1)).max()), stress)


def bounds_of_particles(plan: Plan, group: ParticleGroup, indices: np.ndarray) -> ParticleBounds:
    """Return `bounds_of` for particles (n,) of a group in their present states."""
    law, state = group.plan.law, group.law_state(indices)
    wave2 = np.broadcast_to(law_function(law, "wave_speed2")(law, state), len(indices))
    tau = np.abs(
        np.stack(np.broadcast_arrays(*law_function(law, "stress")(law, state, (0.0,) * 9)))
    )
    worst = {int(np.argmax(wave2)), int(np.argmax(np.broadcast_to(tau.sum(0), len(indices))))}
    states = [tuple(row[k] for row in state) for k in sorted(worst)]
    return bounds_of(plan, group.plan, states, group.get("v", indices), group.get("C", indices))


def bounds_of_idle_group(plan: Plan) -> ParticleBounds:
    """Return the bounds for a state without any particle.

    A particle of the first group at its reference state stands in, moving at its wave speed.
    """
    group = plan.groups[0]
    wave2 = float(law_function(group.law, "wave_speed2")(group.law, group.reference))
    v = np.array([[np.sqrt(group.bound(wave2)), 0.0, 0.0]])
    return bounds_of(plan, group, [group.reference], v, np.zeros((1, 9)))


def remove_particles(group: ParticleGroup, indices: np.ndarray) -> None:
    """Remove particles from their segments; the others move up in order.

    Freed slots are cleared as a sort leaves them. Segments stay until the next sort, even if they
    are empty: the exchange tables follow from the segments, here and in a run that restarts from a
    checkpoint.

    Args:
        group: Particle group (in/out).
        indices: Indices of the particles to remove, shape (n,).
    """
    segment_of = group.segment_of(indices)
    segments = np.unique(segment_of)
    old_slots = group.places(segments)
    survivors = old_slots[~np.isin(old_slots, indices)]
    group.count = group.count - np.bincount(segment_of, minlength=len(group.count))
    new_slots = group.places(segments)
    freed_slots = np.setdiff1d(old_slots, new_slots, assume_unique=True)
    for rows, blank in ((group.xi, 0), (group.f, 0), (group.ids[None], -1)):
        rows[:, new_slots] = rows[:, survivors]  # the right-hand side is a copy
        rows[:, freed_slots] = blank


def _ends(values: np.ndarray) -> list[float]:
    """Return the smallest and the largest of (n,) values; nothing if there are none."""
    return [float(values.min()), float(values.max())] if len(values) else []
