"""How much has come and gone: particles and rest volume of every group, exactly, so that their
order and the ranks on which it was do not matter."""

import numpy as np

from ..domain.ranks import Alone
from ..domain.state import Group
from ..planning.plan import Plan
from .enter import Rows

BITS = 52  # of a cell's volume: no particle's volume is finer
LIMB, LIMBS = 31, 4  # bits and number of the whole numbers by which a sum travels
MASK = (1 << LIMB) - 1


class Tally:
    """This rank's part of what came, at the start and since, and of what went: whole numbers
    (groups, 4), particles and 2^-52 cells in and out."""

    def __init__(self, plan: Plan):
        self.plan = plan
        self.part = [[0, 0, 0, 0] for _ in plan.groups]

    def come(self, rows: Rows) -> None:
        """Particles that came on this rank."""
        if len(rows.ids):
            group_of = np.array(self.plan.group_of)[rows.thing]
            for g in np.unique(group_of):
                self._add(int(g), rows.volume[group_of == g], 0)

    def take(self, group: int, volume: np.ndarray) -> None:
        """volume: (n,) [m3] of the particles that went."""
        self._add(group, volume, 2)

    def goes_over(self, group: int, joins: int, volume: np.ndarray) -> None:
        """volume: (n,) [m3] of the particles that went from one group to another."""
        self._add(group, volume, 2)
        self._add(joins, volume, 0)

    def _add(self, group: int, volume: np.ndarray, first: int) -> None:
        self.part[group][first] += len(volume)
        self.part[group][first + 1] += self._counted(volume)

    def _counted(self, volume: np.ndarray) -> int:
        """The sum of volumes (n,) [m3] in whole numbers, in two parts that hold it."""
        cells = np.asarray(volume, self.plan.real).astype(np.float64) / self.plan.dx**3
        whole = np.rint(np.ldexp(cells, BITS)).astype(np.int64)
        high, low = int((whole >> LIMB).sum()), int((whole & MASK).sum())
        return (high << LIMB) + low

    def there(self, groups: list[Group], ranks: Alone) -> list[list[int]]:
        """Particles and volume of each group that are there now, as they are counted here: rows
        [particles, volume], on every rank. Collective."""
        mine = []
        for group in groups:
            volume = group.get("vol0", group.index())[:, 0]
            mine.append([len(volume), self._counted(volume)])
        return united(mine, ranks)

    def totals(self, ranks: Alone) -> list[list[int]]:
        """The same of all ranks together, on every rank. Collective."""
        return united(self.part, ranks)

    def adopt(self, totals: list[list[int]], ranks: Alone) -> None:
        """Go on from what all ranks had together."""
        if ranks.rank == 0:
            self.part = [list(row) for row in totals]

    def mass(self, group: int, volume: int) -> float:
        """Mass [kg] of a volume as it is counted here."""
        cells = volume / (1 << BITS)
        return float(self.plan.groups[group].density * self.plan.dx**3 * cells)


def united(rows: list[list[int]], ranks: Alone) -> list[list[int]]:
    """Sums over all ranks of whole numbers of any size, on every rank. Collective."""
    mine = [[one >> LIMB * k & MASK for one in row for k in range(LIMBS)] for row in rows]
    every = ranks.all_rows(np.array(mine, np.int64)[None]).sum(0).tolist()
    return [
        [sum(row[at + k] << LIMB * k for k in range(LIMBS)) for at in range(0, len(row), LIMBS)]
        for row in every
    ]
