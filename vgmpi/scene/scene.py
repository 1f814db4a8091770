"""What a scene file says, as typed, checked, frozen tables."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from vgmpi.couplings.base import MIXING
from vgmpi.scene.loads import Load
from vgmpi.scene.objects import Object
from vgmpi.scene.probes import Probe
from vgmpi.scene.settings import (
    SECTIONS,
    Accuracy,
    Appearance,
    Domain,
    Output,
    Time,
)
from vgmpi.scene.sources import Inflow, Sink
from vgmpi.source import Source, printable
from vgmpi.tables import SceneError


@dataclass(frozen=True)
class Scene:
    """Everything a scene file says, with defaults filled in. SI units.

    `object`, `inflow` and `coupling` are in file order; `folder` is where the file lies; `text`
    is its text, without the overrides, which `overrides` lists.
    """

    path: Path
    folder: Path
    text: str
    title: str
    seed: int
    domain: Domain
    time: Time
    material: dict[str, Any]
    object: tuple[Object, ...]
    coupling: tuple[Any, ...] = ()
    load: tuple[Load, ...] = ()
    probe: tuple[Probe, ...] = ()
    inflow: tuple[Inflow, ...] = ()  # [[source]]
    sink: tuple[Sink, ...] = ()
    appearance: Appearance = Appearance()
    accuracy: Accuracy = Accuracy()
    output: Output = Output()
    files: dict[str, Path] = field(default_factory=dict)  # of each object that has one, by its name
    overrides: tuple[str, ...] = ()
    source: Source | None = field(default=None, repr=False, compare=False)

    @property
    def things(self) -> tuple[Object | Inflow, ...]:
        """Objects, then sources: all that particles can be of."""
        return (*self.object, *self.inflow)

    @property
    def flows(self) -> bool:
        """Whether particles come or go."""
        return bool(self.inflow or self.sink or self.domain.open_walls)

    def phase_of(self, thing: Object | Inflow) -> str | None:
        """Name of the velocity field a body shares; None for scenery."""
        if thing.material is None:
            return None
        return phase_of(thing, self.material[thing.material].family, mixed(self.coupling))

    def error(self, found: list[tuple[tuple, str]]) -> SceneError:
        """The error for (path of a key, what is wrong with it), found after loading."""
        source = self.source or Source(self.path, self.overrides)
        return SceneError(source.lines(found))

    def place(self, path: tuple) -> str:
        """A key and where it stands, or what holds it: "material.water.gamma (scene.toml:12)"."""
        source = self.source or Source(self.path, self.overrides)
        return printable(f"{source.key(path)} ({source.place(path)[1]})")

    def resolved(self) -> dict[str, Any]:
        """Everything with defaults filled in, as plain JSON values."""
        tables = {name: getattr(self, name).model_dump(mode="json") for name in SECTIONS}
        # left out where there are none, as in runs begun before they could be
        some = {"source": self.inflow, "sink": self.sink}
        flows = {
            name: [x.model_dump(mode="json", exclude_none=True) for x in found]
            for name, found in some.items()
            if found
        }
        return {
            "title": self.title,
            "seed": self.seed,
            **tables,
            "material": {k: m.model_dump(mode="json") for k, m in self.material.items()},
            "object": [o.model_dump(mode="json", exclude_none=True) for o in self.object],
            "coupling": [c.model_dump(mode="json") for c in self.coupling],
            "load": [x.model_dump(mode="json", exclude_none=True) for x in self.load],
            "probe": [p.model_dump(mode="json", exclude_none=True) for p in self.probe],
            **flows,
        }


def phase_of(thing: Object | Inflow, family: str, mixed: frozenset[str] = frozenset()) -> str:
    """Name of the velocity field a body shares: all fluids one, but those of a material that is
    `mixed` with another; all sand, all snow one each; every solid its own."""
    alone = {"solid": thing.name, "fluid": thing.material if thing.material in mixed else family}
    return thing.phase or alone.get(family, family)


def mixed(couplings: Iterable[Any]) -> frozenset[str]:
    """Names of the materials that mix with others. couplings: tables of the scene."""
    return frozenset(name for c in couplings if c.rule == MIXING for name in c.between)
