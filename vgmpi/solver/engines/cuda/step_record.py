"""Small arrays of a step in one piece of GPU memory, so that a step copies once in each direction.

A copy of some bytes costs as much time as a kernel on many particles.
"""

from typing import Any, NamedTuple

import numpy as np

from .device_memory import ALIGNMENT, read, to_card, write

FINE = (1 << 62) - 1  # value for: no particle failed, no sum left its range


class StepRecord(NamedTuple):
    """Values that a step needs and reports, besides particles and nodes."""

    gravity_increment: Any  # (4,) [m/s] change of the velocity by gravity, and 0
    peaks: Any  # (1,) largest squared stress over density
    maxima: Any  # (6,) of the particles, see `g2p`
    prescribed_maxima: Any  # (6,) of the particles of prescribed bodies, in double precision
    failure: Any  # (1,) first particle that failed, or FINE
    overflow: Any  # (fields,) first node block whose sums left their range + 1, or FINE


class RecordBuffer:
    """Record of the present step, on the GPU (`card`) and as the host resets and reads it."""

    def __init__(self, real: type, fields: int):
        """Create the record.

        Args:
            real: Working precision.
            fields: Number of nodal fields.
        """
        sections = (
            (4, real, 0), (1, real, 0), (6, real, 0), (6, np.float64, 0),
            (1, np.int64, FINE), (fields, np.int64, FINE),
        )  # fmt: skip
        sizes = [count * np.dtype(kind).itemsize for count, kind, _ in sections]
        first = np.cumsum([0] + [-(-size // ALIGNMENT) * ALIGNMENT for size in sizes])
        self._sections = [
            (begin, begin + size, kind)
            for begin, size, (_, kind, _) in zip(first, sizes, sections, strict=False)
        ]
        self._reset = np.zeros(first[-1], np.uint8)
        for values, (_, _, value) in zip(self._views(self._reset), sections, strict=True):
            values[:] = value
        self._bytes = to_card(self._reset)
        self._host = self._reset.copy()
        self._at_reset, self._at_host = self._views(self._reset), self._views(self._host)
        self.card = self._views(self._bytes)

    def _views(self, memory) -> StepRecord:
        return StepRecord(*(memory[i:j].view(kind) for i, j, kind in self._sections))

    def begin(self, gravity_increment: np.ndarray) -> None:
        """Reset the record on the GPU.

        Args:
            gravity_increment: Change of the velocity by gravity, shape (4,) [m/s].
        """
        self._at_reset.gravity_increment[:] = gravity_increment
        write(self._bytes, self._reset)

    def read(self) -> StepRecord:
        """Return the record after all kernels of the step."""
        read(self._bytes, self._host)
        return self._at_host
