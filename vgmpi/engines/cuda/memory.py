"""What lies in a card's memory beside particles: layers, and copies of the host's tables."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numba import cuda

from ...kernels import sums
from ...kernels.tables import Sums
from ..layers import Layer

# where arrays are made; without a card kernels can be compiled for arrays of the host's
WHERE: list[Any] = [cuda]


def to_card(array: np.ndarray):
    """A copy of an array in the card's memory."""
    return WHERE[0].to_device(np.ascontiguousarray(array))


def new(shape, kind):
    """An array in the card's memory, of any values."""
    return WHERE[0].device_array(shape, kind)


def flattened(array):
    """An array of the card's as a row of numbers."""
    return array.reshape(array.size)


class Copies:
    """Copies of the host's arrays, made when they are first asked for."""

    def __init__(self) -> None:
        self.kept: dict[int, tuple] = {}  # id of the host's array: it, and its copy

    def of(self, one):
        """An array's copy; of a tuple the tuple of what its arrays have for copies."""
        if isinstance(one, np.ndarray):
            if id(one) not in self.kept:
                self.kept[id(one)] = one, to_card(one)
            return self.kept[id(one)][1]
        return like(one, self.of) if isinstance(one, tuple) else one

    def new(self, one):
        """The same of arrays that may have changed."""
        self.forget(one)
        return self.of(one)

    def forget(self, one) -> None:
        """An array, or those of a tuple, have changed."""
        if isinstance(one, tuple):
            for part in one:
                self.forget(part)
        else:
            self.kept.pop(id(one), None)

    def clear(self) -> None:
        self.kept.clear()


def like(one: tuple, go) -> tuple:
    """A tuple of what `go` makes of its parts."""
    parts = [go(part) for part in one]
    return type(one)(*parts) if hasattr(one, "_fields") else tuple(parts)


class CardLayer(Layer):
    """Sums and values of a layer in the card's memory."""

    reset: Callable  # reset(layer): puts the sums to rest; the engine's
    sums: Any
    nodes: Any
    of_rest: Any

    def adopt(self, asked: np.ndarray, phase_of_row: np.ndarray) -> None:
        """Make room for node blocks (n,)."""
        needed = len(phase_of_row) if asked.any() else 0
        self.asked, self.phase = asked.astype(np.uint8), phase_of_row[:needed]
        words = sums.words(self.real)
        self.sums = card_room(self.sums, needed, (words, sums.BLOCK), np.float64)
        self.nodes = card_room(self.nodes, len(asked) if needed else 0, (sums.BLOCK,), self.real)
        self.nodes.copy_to_device(np.zeros(self.nodes.shape, self.real))
        self.of_asked, self.of_phase = to_card(self.asked), to_card(self.phase)
        self.speed, self.sized = 0.0, np.zeros(0)

    def begin(self, speed: float) -> None:
        """Choose the quanta; sums that rest elsewhere are put to rest."""
        if speed == self.speed:
            return
        self.speed, full = speed, self.full(speed)
        if not np.array_equal(full, self.sized):
            self.sized, self.rest = full, sums.rests(full, self.real)
            self.of_rest = to_card(self.rest)
            of = map(flattened, (self.sums, self.of_rest, self.nodes))
            flat_sums, flat_rest, flat_nodes = of
            self.tables = Sums(flat_sums, flat_rest, self.of_asked, flat_nodes)
            self.reset(self)


def card_room(array, rows: int, shape: tuple, kind):
    """An array of the card with that many rows: the one there is, if it is large enough and not
    much larger."""
    if not isinstance(array, np.ndarray) and rows <= array.shape[0] <= 2 * rows:
        return array
    return new((rows + rows // 8, *shape), kind)
