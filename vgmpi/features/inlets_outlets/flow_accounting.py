"""Exact accounting of the particles and rest volume that enter and leave every group.

Totals are integers, so they depend neither on the order of the particles nor on their ranks.
"""

from typing import Any

import numpy as np

from vgmpi.features.active_feature import StartContext
from vgmpi.features.particle_insertion import ParticleRows
from vgmpi.io.checkpoint import Checkpoint, Mismatch, is_count
from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.planning.region_groups import groups_of_particles

BITS = 52  # [bits] resolution of a volume below one cell; particle volumes are not finer
LIMB, LIMBS = 31, 4  # [bits] size, and number, of the integers that carry a sum over MPI
MASK = (1 << LIMB) - 1


class FlowAccounting:
    """This rank's contribution to the inflow and outflow totals.

    `part` has one row per group: particles in (at the start and since), their volume, particles
    out, their volume. Volumes are counted in units of 2**-52 cell volumes.
    """

    def __init__(self, context: StartContext):
        """Begin with zero totals."""
        self.plan, self.ranks, self.groups = context.plan, context.ranks, context.groups
        self.part = [[0, 0, 0, 0] for _ in self.plan.groups]

    def insert(self, rows: ParticleRows) -> None:
        """Count the particles that entered on this rank."""
        if len(rows.ids):
            group_of = groups_of_particles(self.plan, rows.ids, rows.owner)
            for g in np.unique(group_of):
                self._add(int(g), rows.volume[group_of == g], 0)

    def remove(self, group: int, volume: np.ndarray) -> None:
        """Count particles of rest volumes (n,) [m3] that left a group."""
        self._add(group, volume, 2)

    def transfer(self, group: int, other: int, volume: np.ndarray) -> None:
        """Count particles that moved from one group to another.

        Args:
            group: Index of the group that they left.
            other: Index of the group that they joined.
            volume: Rest volumes, shape (n,) [m3].
        """
        self._add(group, volume, 2)
        self._add(other, volume, 0)

    def _add(self, group: int, volume: np.ndarray, first: int) -> None:
        self.part[group][first] += len(volume)
        self.part[group][first + 1] += self._counted(volume)

    def _counted(self, volume: np.ndarray) -> int:
        """Return the sum of rest volumes (n,) [m3] as an exact integer, added in two halves."""
        cells = np.asarray(volume, self.plan.real).astype(np.float64) / self.plan.dx**3
        counts = np.rint(np.ldexp(cells, BITS)).astype(np.int64)
        high, low = int((counts >> LIMB).sum()), int((counts & MASK).sum())
        return (high << LIMB) + low

    def current_totals(self) -> list[list[int]]:
        """Count the particles and the volume of each group at present. Collective.

        Returns:
            Rows [particles, volume] by group, in the units of `totals`, on every rank.
        """
        mine = []
        for group in self.groups:
            volume = group.get("vol0", group.index())[:, 0]
            mine.append([len(volume), self._counted(volume)])
        return allreduce_bigint(mine, self.ranks)

    def totals(self) -> list[list[int]]:
        """Return the totals of all ranks together, on every rank. Collective."""
        return allreduce_bigint(self.part, self.ranks)

    def restore(self, saved: Checkpoint) -> None:
        """Restore the totals of all ranks, which rank 0 then holds.

        Args:
            saved: The checkpoint.

        Raises:
            Mismatch: The totals do not fit the particles of the checkpoint.
        """
        totals: Any = saved.attrs.get("flow")
        is_valid = isinstance(totals, list) and len(totals) == len(self.groups)
        for g, row in enumerate(totals if is_valid else []):
            is_valid = is_valid and isinstance(row, list) and len(row) == 4
            is_valid = is_valid and all(is_count(value, 1 << 120) for value in row)
            is_valid = is_valid and row[0] - row[2] == saved.count(f"group_{g:03d}/id")
        if not is_valid:
            raise Mismatch(f"{saved.path}: attrs: flow cannot be {totals!r:.60}")
        if self.ranks.rank == 0:
            self.part = [list(row) for row in totals]

    def mass(self, group: int, volume: int) -> float:
        """Return the mass [kg] of a counted volume of a group."""
        cells = volume / (1 << BITS)
        return float(self.plan.groups[group].density * self.plan.dx**3 * cells)

    def phase_entries(self) -> list[dict[str, float]]:
        """Return particles and mass of each phase that came, went and are present. Collective.

        All are counted the same way.
        """
        passed, present = self.totals(), self.current_totals()
        totals = [[*row, *now] for row, now in zip(passed, present, strict=True)]
        return [self._entry(phase, totals) for phase in range(len(self.plan.phases))]

    def _entry(self, phase: int, totals: list[list[int]]) -> dict[str, float]:
        """Return the columns of one phase.

        Args:
            phase: Index of the phase.
            totals: Particles and volume in, out and present, by group.
        """
        members = [g for g, group in enumerate(self.plan.groups) if group.phase == phase]
        count_in, count_out, count = (sum(totals[g][c] for g in members) for c in (0, 2, 4))
        mass_in, mass_out, mass = (
            sum(self.mass(g, totals[g][c]) for g in members) for c in (1, 3, 5)
        )
        return {
            "particles": count,
            "mass": mass,
            "particles_in": count_in,
            "mass_in": mass_in,
            "particles_out": count_out,
            "mass_out": mass_out,
        }


def allreduce_bigint(rows: list[list[int]], ranks: SerialCommunicator) -> list[list[int]]:
    """Sum integers of any size over all ranks; the result is on every rank. Collective."""
    mine = [[number >> LIMB * k & MASK for number in row for k in range(LIMBS)] for row in rows]
    all_rows = ranks.all_rows(np.array(mine, np.int64)[None]).sum(0).tolist()
    return [
        [
            sum(row[offset + k] << LIMB * k for k in range(LIMBS))
            for offset in range(0, len(row), LIMBS)
        ]
        for row in all_rows
    ]
