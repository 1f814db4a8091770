"""What a particle carries, told once: names, places, units, values at rest, and which dataset of a
checkpoint holds them. Records, state, files, memory and docs read it.
"""

from functools import cached_property
from typing import NamedTuple

# of a body's surface: normal 0-2, distance 3, and the normal's gradient, whose six make nine
SURFACE = 10
BEND = [4, 5, 6, 5, 7, 8, 6, 8, 9]


class Channel(NamedTuple):
    """Numbers of a particle that belong together: rows first .. first + width of its floats."""

    name: str
    first: int
    width: int
    unit: str
    rest: tuple[float, ...]  # (width,) where nothing has happened yet
    dataset: str  # of a checkpoint; those of one name follow each other

    @property
    def rows(self) -> slice:
        return slice(self.first, self.first + self.width)


# what every particle has; kernels know these places (kernels/records.py)
HEAD = (("v", 3, "m/s"), ("C", 9, "1/s"), ("vol0", 1, "m3"))


class Channels:
    """The channels of a group, in their order; by name: `channels["C"]`."""

    def __init__(
        self,
        state: dict[str, tuple[float, ...]],
        share: bool = False,
        follows: bool = False,
        surface: bool = False,
        hues: int = 0,
    ):
        """state: what the law carries, by name, at rest; share: of space, of fluids in pores;
        follows: the total deformation gradient less 1; surface: of its body at rest, the outward
        normal [1], as long as it is sure, and signed distance [m] there, and the normal's gradient
        [1/m]: xx, xy, xz, yy, yz, zz; hues: coefficients of colour that travel with every step."""
        rows = [(name, unit, (0.0,) * width, name) for name, width, unit in HEAD]
        rows += [(name, "1", tuple(values), "state") for name, values in state.items()]
        rows += [("share", "1", (1.0,), "state")] * share
        rows += [("F", "1", (0.0,) * 9, "state")] * follows
        rows += [("surface", "1, m, 1/m", (0.0,) * SURFACE, "state")] * surface
        rows += [("colour", "1", (0.0,) * 3 * hues, "state")] * (hues > 0)
        self._by_name: dict[str, Channel] = {}
        self.count = 0  # numbers of a particle
        for name, unit, values, dataset in rows:
            if name in self._by_name:
                raise TypeError(f"two channels are called {name!r}")
            self._by_name[name] = Channel(name, self.count, len(values), unit, values, dataset)
            self.count += len(values)

    def __iter__(self):
        return iter(self._by_name.values())

    def __contains__(self, name: str) -> bool:
        return name in self._by_name

    def __getitem__(self, name: str) -> Channel:
        return self._by_name[name]

    def first(self, name: str) -> int:
        """First row of a channel, -1 where there is none."""
        return self._by_name[name].first if name in self._by_name else -1

    def width(self, dataset: str) -> int:
        """Numbers of a particle in a dataset of a checkpoint."""
        rows = self.datasets.get(dataset, slice(0, 0))
        return rows.stop - rows.start

    @cached_property
    def rest(self) -> tuple[float, ...]:
        """(count,) a particle at rest, of no volume."""
        return tuple(value for channel in self for value in channel.rest)

    @cached_property
    def datasets(self) -> dict[str, slice]:
        """Rows of each dataset of a checkpoint."""
        found: dict[str, slice] = {}
        for channel in self:
            begin = found[channel.dataset].start if channel.dataset in found else channel.first
            found[channel.dataset] = slice(begin, channel.first + channel.width)
        return found
