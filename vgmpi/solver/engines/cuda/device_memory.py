"""GPU memory besides particles: nodal fields, and copies of the host's tables."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numba import cuda

from vgmpi.kernels import reproducible_sums
from vgmpi.kernels.kernel_arguments import Sums
from vgmpi.solver.engines.nodal_field_storage import NodalField

from .translation_types import SIMULATED

if not SIMULATED:
    from numba.cuda.cudadrv import devicearray, driver

ALIGNMENT = 64  # [bytes] of arrays in a common piece of memory

# Module that allocates arrays; without a GPU, kernels can be compiled for host arrays.
WHERE: list[Any] = [cuda]


def to_card(array: np.ndarray):
    """Copy an array to GPU memory."""
    return WHERE[0].to_device(np.ascontiguousarray(array))


def to_card_together(arrays: list[np.ndarray]) -> list:
    """Copy arrays to one piece of GPU memory, with one copy."""
    if WHERE[0] is not cuda or SIMULATED:
        return [to_card(array) for array in arrays]
    first = np.cumsum([0, *[-(-array.nbytes // ALIGNMENT) * ALIGNMENT for array in arrays]])
    joined = np.empty(max(int(first[-1]), 1), np.uint8)
    for begin, array in zip(first.tolist(), arrays, strict=False):
        section = joined[begin : begin + array.nbytes]
        section.view(array.dtype).reshape(array.shape)[...] = array
    memory = to_card(joined)
    return [
        devicearray.DeviceNDArray(
            array.shape, np.empty(array.shape, array.dtype).strides, array.dtype,
            gpu_data=memory.gpu_data.view(begin, begin + array.nbytes),
        )
        for begin, array in zip(first.tolist(), arrays, strict=False)
    ]  # fmt: skip


def new(shape, kind):
    """Allocate an uninitialized array in GPU memory."""
    return WHERE[0].device_array(shape, kind)


def write(target, values: np.ndarray) -> None:
    """Copy an array over a GPU array of its size."""
    if WHERE[0] is cuda and not SIMULATED and values.nbytes:  # numba takes as long as some kernels
        driver.host_to_device(target, np.ascontiguousarray(values), values.nbytes)
    else:
        target.copy_to_device(values)


def read(source, values: np.ndarray) -> None:
    """Copy a GPU array to a contiguous array of its size, after all kernels."""
    if WHERE[0] is cuda and not SIMULATED and values.nbytes:
        driver.device_to_host(values, source, values.nbytes)
    else:
        source.copy_to_host(values)


def clear(array) -> None:
    """Set the bytes of a GPU array to 0."""
    if WHERE[0] is cuda and not SIMULATED and array.size:
        driver.device_memset(array, 0, array.size * array.dtype.itemsize)
    else:
        array.copy_to_device(np.zeros(array.shape, array.dtype))


class ChannelMemory:
    """Channels in GPU memory with a spare one before or behind them.

    A sort writes each channel over its neighbor, so that channels need no second copy.
    """

    def __init__(self, shape: tuple, kind):
        """Allocate channels.

        Args:
            shape: Shape (channels, capacity) or (capacity,).
            kind: Data type.
        """
        self.capacity, self.channels = shape[-1], len(shape) > 1 and shape[0] or 1
        size = self.channels * self.capacity
        self.all = new(max(size + self.capacity, 1), kind)
        self.is_shifted = False  # whether the spare channel is the first
        first = [0, self.capacity]
        self._arrays = [
            self.all[i : i + size].reshape(shape) if size else to_card(np.zeros(shape, kind))
            for i in first
        ]

    @property
    def array(self):
        """Channels without the spare one."""
        return self._arrays[self.is_shifted]

    def moves(self) -> list[tuple[int, int]]:
        """Return the old and the new first number of each channel, in the order of a sort."""
        c = self.capacity
        old = [(k + self.is_shifted) * c for k in range(self.channels)]
        if self.is_shifted:
            return [(first, first - c) for first in old]
        return [(first, first + c) for first in reversed(old)]


def flattened(array):
    """Return a GPU array as one dimension."""
    return array.reshape(array.size)


class Copies:
    """Copies of host arrays in GPU memory, made at their first use."""

    def __init__(self) -> None:
        self.by_id: dict[int, tuple] = {}  # id of a host array -> array and copy

    def on_device(self, value):
        """Return the copy of an array, or of a tuple the tuple of its copies."""
        if isinstance(value, np.ndarray):
            if id(value) not in self.by_id:
                self.by_id[id(value)] = value, to_card(value)
            return self.by_id[id(value)][1]
        return map_tuple(value, self.on_device) if isinstance(value, tuple) else value

    def add(self, values: tuple) -> None:
        """Copy arrays, and those of tuples, with one copy, for `on_device` to return."""
        arrays: dict[int, np.ndarray] = {}
        _collect(values, arrays)
        missing = [array for key, array in arrays.items() if key not in self.by_id]
        for array, copy in zip(missing, to_card_together(missing), strict=True):
            self.by_id[id(array)] = array, copy

    def of_table(self, value: tuple):
        """Return the copies of a tuple that stays until the next sort, as the same tuple."""
        if id(value) not in self.by_id:
            self.by_id[id(value)] = value, self.on_device(value)
        return self.by_id[id(value)][1]

    def refreshed(self, value):
        """Return the copies of arrays that may have changed, written again."""
        if isinstance(value, tuple):
            return map_tuple(value, self.refreshed)
        if id(value) in self.by_id:
            self.by_id[id(value)][1].copy_to_device(value)
        return self.on_device(value)

    def forget(self, value) -> None:
        """Drop the copies of an array, or of the arrays of a tuple, that have changed."""
        if isinstance(value, tuple):
            for member in value:
                self.forget(member)
        self.by_id.pop(id(value), None)

    def clear(self) -> None:
        """Drop all copies."""
        self.by_id.clear()


def _collect(value, arrays: dict[int, np.ndarray]) -> None:
    """Collect the host arrays of a value by id."""
    if isinstance(value, np.ndarray):
        arrays[id(value)] = value
    elif isinstance(value, tuple):
        for member in value:
            _collect(member, arrays)


def map_tuple(value: tuple, function) -> tuple:
    """Return a tuple of the same class with a function applied to its members."""
    members = [function(member) for member in value]
    return type(value)(*members) if hasattr(value, "_fields") else tuple(members)


class CardLayer(NodalField):
    """Sums and values of a nodal field in GPU memory."""

    reset: Callable  # reset(field) of the engine: sets the sums to their bias
    sums: Any
    nodes: Any
    device_bias: Any

    @staticmethod
    def grow_nodes(nodes, count: int):
        """Return an array of node blocks with room for `count` of them."""
        return card_room(nodes, count, (reproducible_sums.BLOCK,), nodes.dtype)

    def set_topology(self, requested: np.ndarray, phase_of_row: np.ndarray) -> None:
        """Allocate node blocks.

        Args:
            requested: Blocks that have the field, shape (n,).
            phase_of_row: Velocity field of each row of sums.
        """
        row_count = len(phase_of_row) if requested.any() else 0
        self.has_terms, self.phase = requested.astype(np.uint8), phase_of_row[:row_count]
        words = reproducible_sums.accumulator_words(self.real)
        self.sums = card_room(self.sums, row_count, (words, reproducible_sums.BLOCK), np.float64)
        self.nodes = card_room(
            self.nodes, len(requested) if row_count else 0, (reproducible_sums.BLOCK,), self.real
        )
        clear(self.nodes)
        self.device_has_terms, self.device_phase = to_card_together([self.has_terms, self.phase])
        self.speed, self.current_bounds = 0.0, np.zeros(0)

    def begin(self, speed: float) -> None:
        """Choose the quanta of a step, and reset the sums if their bias changes."""
        if speed == self.speed:
            return
        self.speed, bounds = speed, self.sum_bounds(speed)
        if not np.array_equal(bounds, self.current_bounds):
            self.current_bounds, self.bias = (
                bounds,
                reproducible_sums.accumulator_biases(bounds, self.real),
            )
            self.device_bias = to_card(self.bias)
            flat_arrays = map(flattened, (self.sums, self.device_bias, self.nodes))
            flat_sums, flat_bias, flat_nodes = flat_arrays
            self.tables = Sums(flat_sums, flat_bias, self.device_has_terms, flat_nodes)
            self.reset(self)


def card_room(array, rows: int, shape: tuple, kind):
    """Return a GPU array of at least that many rows.

    An existing array is reused if it is large enough and not much larger.

    Args:
        array: Existing array.
        rows: Number of rows.
        shape: Shape of a row.
        kind: Data type.
    """
    if not isinstance(array, np.ndarray) and rows <= array.shape[0] <= 2 * rows:
        return array
    return new((rows + rows // 8, *shape), kind)
