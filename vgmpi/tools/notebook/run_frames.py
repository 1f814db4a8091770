"""Frames of a run as arrays and as pyvista data."""

import functools
from collections.abc import Iterator, Sequence

import numpy as np

from vgmpi.io.run_reader import RunError, RunReader

ARRAYS_OF_OBJECTS = ("poses",)  # arrays of a frame without a row per particle


class Frame:
    """One frame of a run; its arrays are read when they are first used, and checked.

    Attributes:
        number: Number of the frame.
    """

    def __init__(self, reader: RunReader, number: int):
        """Name a frame.

        Args:
            reader: Files of the run.
            number: Number of the frame.
        """
        self._reader, self.number = reader, number

    def __repr__(self) -> str:
        return f"<frame {self.number} at {self.time:.4g} s>"

    @functools.cached_property
    def arrays(self) -> dict[str, np.ndarray]:
        """All arrays by their names in the file, in SI units. Raises RunError."""
        return self._reader.frame(self.number)

    def __getitem__(self, name: str) -> np.ndarray:
        """Return an array by its name in the file, such as "J". Raises RunError."""
        if name not in self.arrays:
            message = f"frame {self.number} has no array '{name}'; it has {', '.join(self.names)}"
            raise RunError(f"{self._reader.folder}: {message}")
        return self.arrays[name]

    @property
    def names(self) -> list[str]:
        """Names of the arrays."""
        return list(self.arrays)

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return float(self._reader.times[self.number])

    @functools.cached_property
    def positions(self) -> np.ndarray:
        """Positions of the particles, shape (n, 3) [m]; alone, they are read fastest."""
        if "arrays" in self.__dict__:
            return self.arrays["positions"]
        return self._reader.positions(self.number)

    @property
    def ids(self) -> np.ndarray:
        """Numbers of the particles, shape (n,): the same particle has the same in each frame."""
        return self["id"]

    @property
    def velocities(self) -> np.ndarray:
        """Velocities of the particles, shape (n, 3) [m/s]."""
        return self["velocity"]

    def to_pyvista(self):
        """Return a `pyvista.PolyData` of the particles with all arrays that have a row for each."""
        import pyvista

        cloud = pyvista.PolyData(np.asarray(self["positions"], np.float64))
        for name, array in self.arrays.items():
            if name != "positions" and name not in ARRAYS_OF_OBJECTS:
                cloud.point_data[name] = array.reshape(len(array), -1).squeeze()
        return cloud


class Frames(Sequence[Frame]):
    """The frames of a run by their numbers; negative numbers count from the end."""

    def __init__(self, reader: RunReader):
        """Name the frames of a run.

        Args:
            reader: Files of the run.
        """
        self._reader = reader

    def __len__(self) -> int:
        """Return the number of frames, including missing ones."""
        return len(self._reader)

    def __getitem__(self, number):
        """Return a frame, or a list of the present ones of a slice. Raises RunError."""
        count = len(self)
        if isinstance(number, slice):
            return [self[k] for k in range(count)[number] if k in self._reader.frames]
        if not -count <= number < count:
            raise IndexError(f"{self._reader.folder}: no frame {number}, there are {count}")
        number %= count
        if number not in self._reader.frames:
            raise RunError(f"{self._reader.folder}: frame {number} is missing")
        return Frame(self._reader, number)

    def __iter__(self) -> Iterator[Frame]:
        """Return an iterator over the present frames."""
        return (Frame(self._reader, number) for number in sorted(self._reader.frames))
