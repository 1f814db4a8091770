"""What a simulation holds and calls: arrays by name, and the kernels with the kinds of their
arguments."""

from collections.abc import Iterator
from unittest import mock

import numpy as np

from vgmpi.runtime import compiled_kernels
from vgmpi.solver.simulation import Simulation


def arrays(simulation: Simulation) -> dict[str, np.ndarray]:
    """Every array that can be reached from it, by the first way there: attributes, fields and keys
    with dots between. Lists and tuples without names count from 0."""
    found: dict[str, np.ndarray] = {}
    seen: dict[int, object] = {}  # kept alive, so that no id stands for two
    waiting: list[tuple[str, object]] = [("", simulation)]
    while waiting:  # near ones first
        waiting = [step for one in waiting for step in _steps(*one, found, seen)]
    return found


def _steps(name: str, thing: object, found: dict, seen: dict) -> Iterator[tuple[str, object]]:
    """What lies behind a thing; arrays are noted."""
    if id(thing) in seen:
        return
    seen[id(thing)] = thing
    if isinstance(thing, np.ndarray):
        found[name] = thing
        return
    fields: dict = {}
    if isinstance(thing, dict):
        fields = thing
    elif hasattr(thing, "_fields"):
        fields = dict(zip(thing._fields, thing, strict=True))
    elif isinstance(thing, list | tuple):
        fields = dict(enumerate(thing))
    elif type(thing).__module__.startswith("vgmpi."):
        fields = vars(thing)
    for key, value in fields.items():
        yield f"{name}.{key}".lstrip("."), value


class Calls:
    """The kernels that the engine has compiled for it while this is in force, by name: the kinds of
    their arguments, of each specialisation."""

    def __enter__(self) -> "Calls":
        self.entries: dict[tuple, object] = {}
        self.patch = mock.patch.object(compiled_kernels, "_entries", self.entries)
        self.patch.start()
        return self

    def __exit__(self, *error) -> None:
        self.patch.stop()

    @property
    def compiled(self) -> set[str]:
        """The specialisations: what tells a kernel's types apart besides its arrays and numbers."""
        return {f"{kernel.__name__}({_inside(kinds)})" for kernel, kinds in self.entries}


def _inside(kinds: tuple) -> str:
    """Names of the tuples with names among some arguments, with what these hold, and of what is not
    there."""
    found = []
    for kind in kinds[1:]:
        if kind is type(None):
            found.append("None")
        elif isinstance(kind, tuple) and hasattr(kind[0], "_fields"):
            inside = _inside(kind)
            found.append(kind[0].__name__ + (f"({inside})" if inside else ""))
    return ", ".join(found)
