"""Body forces and impulses of a run, applied to the loaded particles of this rank."""

import math

import numpy as np

from vgmpi.features.active_feature import ActiveFeature, StartContext
from vgmpi.kernels.step_records import StepSpan
from vgmpi.parallel.particle_group import ParticleGroup
from vgmpi.runtime.jit import kernel
from vgmpi.scene.rigid_motion import spin_tensor

from .plan import ResolvedLoad


class Loads(ActiveFeature):
    """Loads acting on the particles of this rank.

    They are applied before every particle-to-grid transfer. The result has the same bits on any
    number of ranks: each particle is pushed on its own, or about a center of mass that is summed in
    the order of the segments.
    """

    def __init__(self, loads: tuple[ResolvedLoad, ...], context: StartContext):
        """Hold the loads; `find_particles` locates their particles."""
        self.loads = loads
        self.plan, self.ranks, self.groups = context.plan, context.ranks, context.groups
        self.places: list[list[np.ndarray]] = []  # particle indices of each load in each group
        self.dv = np.zeros(3, self.plan.real)

    def compile_kernels(self) -> None:
        """Compile the kernels by calls without particles."""
        none, real = np.zeros(0, np.int64), self.plan.real
        for group in self.groups:
            push(group.f, none, np.zeros(3, real))

    def find_particles(self, time: float) -> None:
        """Locate the particles of each load in the groups."""
        indexed = [(group, group.index()) for group in self.groups]
        self.places = [
            [indices[within(group.ids[indices], load.ids)] for group, indices in indexed]
            for load in self.loads
        ]

    def limit_rate(self, time: float, rate: float) -> float:
        """Return 1 / dt [1/s] with the impulsive velocity changes within that step."""
        plan, speed = self.plan, self.impulsive_speed_ahead(time, 1.0 / rate)
        return rate + speed / (min(plan.time_step.cfl, plan.time_step.max_cells) * plan.dx)

    def push_particles(self, span: StepSpan) -> float:
        """Apply the loads of one time step to the particle velocities.

        Returns:
            Upper bound of the velocity change [m/s], the same on all ranks.
        """
        groups, bound = self.groups, 0.0
        for loaded, indices in zip(self.loads, self.places, strict=True):
            amount = loaded.load.amount(span.start, span.end, span.dt)
            if amount == 0.0:
                continue
            if loaded.load.damping is not None:
                self._damp(math.exp(-amount * loaded.load.damping), groups, indices)
                continue
            if loaded.load.delta_angular_velocity is not None:
                bound += self._spin(loaded, groups, indices)
                continue
            fastest = 0.0
            for group, index in zip(groups, indices, strict=True):
                self.dv[:] = [amount * a for a in strength(loaded, group.plan.density)]
                push(group.f, index, self.dv)
                fastest = max(fastest, float(np.abs(self.dv).max()))
            bound += fastest
        return bound

    def _damp(self, left: float, groups: list[ParticleGroup], indices: list[np.ndarray]) -> None:
        """Leave a fraction of the velocities, and of the gradients that continue them.

        Args:
            left: The fraction.
            groups: Particle groups (in/out); a given motion is not damped.
            indices: Particle indices in each group, shape (n,).
        """
        for group, index in zip(groups, indices, strict=True):
            if group.plan.is_carried:
                continue
            first = group.plan.channels.first("C")
            rows = [0, 1, 2, *(range(first, first + 9) if self.plan.affine else ())]
            damp(group.f, index, np.array(rows), self.plan.real.type(left))

    def _spin(
        self, loaded: ResolvedLoad, groups: list[ParticleGroup], indices: list[np.ndarray]
    ) -> float:
        """Spin the particles of a load about their center of mass. Collective.

        Returns:
            Largest velocity change along an axis [m/s], the same on all ranks.
        """
        x = [group.positions_at(index) for group, index in zip(groups, indices, strict=True)]
        center = self._center_of_mass(groups, indices, x)
        spin = loaded.load.delta_angular_velocity or (0.0, 0.0, 0.0)
        gradient = np.array(spin_tensor(spin))
        fastest = 0.0
        for group, index, position in zip(groups, indices, x, strict=True):
            dv = np.cross(spin, position - center).astype(group.f.dtype)
            group.put("v", index, group.get("v", index) + dv)
            if self.plan.affine:
                group.put("C", index, group.get("C", index) + gradient.astype(group.f.dtype))
            fastest = max(fastest, float(np.abs(dv).max(initial=0.0)))
        return float(self.ranks.max(np.array([fastest]))[0])

    def _center_of_mass(self, groups: list[ParticleGroup], indices: list, x: list) -> np.ndarray:
        """Return the center of mass (3,) [m] of particles on all ranks. Collective.

        Masses are summed segment by segment in the order of the segments' keys.
        """
        total = np.zeros(4)
        for group, index, position in zip(groups, indices, x, strict=True):
            mass = group.plan.density * group.get("vol0", index).astype(float)
            rows = np.zeros((len(group.start), 4))
            np.add.at(
                rows, group.segment_of(index), np.concatenate([mass, mass * position], axis=1)
            )
            gathered = self.ranks.gather_rows(rows)
            if gathered is not None:
                total += gathered.sum(0)
        total = self.ranks.bcast(total)
        return total[1:] / total[0]

    def impulsive_speed_ahead(self, time: float, dt: float) -> float:
        """Return an upper bound [m/s] of the impulsive velocity changes within dt.

        It is the same on all ranks.

        Args:
            time: Current time [s].
            dt: Length of the interval [s].
        """
        bound = 0.0
        for loaded in self.loads:
            if not (loaded.load.at_once and time <= loaded.load.start_time < time + dt):
                continue
            if loaded.load.delta_angular_velocity is not None:
                bound += (
                    math.hypot(*loaded.load.delta_angular_velocity)
                    * self.plan.dx
                    * math.hypot(*self.plan.cells)
                )
            else:
                bound += max(math.hypot(*strength(loaded, g.plan.density)) for g in self.groups)
        return bound

    def external_impulse(self, t0: float, t1: float) -> np.ndarray:
        """Return the impulse of all loads on all ranks between two times [s], shape (3,) [N s]."""
        total = np.zeros(3)
        for loaded in self.loads:
            total += loaded.load.amount(t0, t1, t1 - t0) * np.array(loaded.total)
        return total


def strength(loaded: ResolvedLoad, density: float) -> tuple[float, float, float]:
    """Return the acceleration [m/s2] or impulsive velocity change [m/s] at full strength.

    Args:
        loaded: Load and its particles.
        density: Density of the particles [kg/m3].
    """
    uniform = loaded.load.acceleration or loaded.load.delta_velocity
    if uniform is not None:
        return uniform
    x, y, z = loaded.density
    return x / density, y / density, z / density


def within(ids: np.ndarray, intervals: np.ndarray) -> np.ndarray:
    """Return a mask (n,) of the ids (n,) that lie in one of the inclusive intervals (m, 2)."""
    row = np.searchsorted(intervals[:, 0], ids, side="right") - 1
    return (row >= 0) & (ids <= intervals[row, 1])


@kernel
def push(f, indices, dv):
    """Add a velocity change to some particles.

    With linear transfers this is the grid force of these particles, m dv / dt each, spread by their
    own weights.

    Args:
        f: Particle channels (in/out), shape (channels, cap).
        indices: Particle indices, shape (n,).
        dv: Velocity change, shape (3,) [m/s].
    """
    for a in range(3):
        row, change = f[a], dv[a]
        for p in indices:
            row[p] += change


@kernel
def damp(f, indices, rows, factor):
    """Scale some channels of some particles.

    Args:
        f: Particle channels (in/out), shape (channels, cap).
        indices: Particle indices, shape (n,).
        rows: Numbers of the channels, shape (m,).
        factor: Fraction that is left [-].
    """
    for row in rows:
        for p in indices:
            f[row, p] *= factor
