"""Channels of the particle arrays: names, rows, units, reference values and checkpoint datasets.

This table is the single source; records, state, files, memory estimates and documentation read it.
"""

from functools import cached_property
from typing import NamedTuple

# A surface descriptor has the normal in rows 0-2, the distance in row 3, and the six distinct
# entries of the normal's gradient in rows 4-9. The list gives the row of each of its nine entries.
SURFACE = 10
CURVATURE_TO_FULL = [4, 5, 6, 5, 7, 8, 6, 8, 9]


class Channel(NamedTuple):
    """One named quantity of a particle, stored in consecutive rows of its floats."""

    name: str
    first: int  # first row
    width: int  # number of rows
    unit: str
    reference: tuple[float, ...]  # (width,) values in the reference state
    dataset: str  # checkpoint dataset; channels of one dataset are adjacent

    @property
    def rows(self) -> slice:
        """Rows of the channel, as a slice."""
        return slice(self.first, self.first + self.width)


# Every particle has these channels; kernels rely on their rows (kernels/particle_records.py).
COMMON_CHANNELS = (("v", 3, "m/s"), ("C", 9, "1/s"), ("vol0", 1, "m3"))


class Channels:
    """Channels of a group in storage order; `channels["C"]` returns one by name."""

    def __init__(
        self,
        state: dict[str, tuple[float, ...]],
        share: bool = False,
        follows: bool = False,
        surface: bool = False,
        extra: tuple[tuple[str, str, int], ...] = (),
    ):
        """Lay out the rows of all channels.

        Args:
            state: State variables of the law by name, with their reference values.
            share: Store the volume fraction, for fluids in pores.
            follows: Store the total deformation gradient minus the identity.
            surface: Store the surface descriptor of the body at rest: outward normal [1], whose
                length is its certainty, signed distance [m], and the gradient of the normal [1/m],
                ordered xx, xy, xz, yy, yz, zz.
            extra: Name, unit and width of further channels.
        """
        rows = [(name, unit, (0.0,) * width, name) for name, width, unit in COMMON_CHANNELS]
        rows += [(name, "1", tuple(values), "state") for name, values in state.items()]
        rows += [("share", "1", (1.0,), "state")] * share
        rows += [("F", "1", (0.0,) * 9, "state")] * follows
        rows += [("surface", "1, m, 1/m", (0.0,) * SURFACE, "state")] * surface
        rows += [(name, unit, (0.0,) * width, "state") for name, unit, width in extra]
        self._by_name: dict[str, Channel] = {}
        self.count = 0  # floats per particle
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
        """Return the first row of a channel, -1 if the group does not have it."""
        return self._by_name[name].first if name in self._by_name else -1

    def width(self, dataset: str) -> int:
        """Return the number of floats per particle in a checkpoint dataset."""
        rows = self.datasets.get(dataset, slice(0, 0))
        return rows.stop - rows.start

    @cached_property
    def reference(self) -> tuple[float, ...]:
        """Reference values of all channels, shape (count,); the volume is 0."""
        return tuple(value for channel in self for value in channel.reference)

    @cached_property
    def datasets(self) -> dict[str, slice]:
        """Rows of each checkpoint dataset, by its name."""
        rows_of: dict[str, slice] = {}
        for channel in self:
            begin = rows_of[channel.dataset].start if channel.dataset in rows_of else channel.first
            rows_of[channel.dataset] = slice(begin, channel.first + channel.width)
        return rows_of
