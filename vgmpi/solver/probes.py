"""Probes: numbers measured while a run goes on, the same on any number of ranks.

What is measured at a point needs few particles: their rows travel to rank 0 in the order of the
segments' keys, and all arithmetic is done there on one array. What is measured of a body is summed
segment by segment, as in the ledger.
"""

from pathlib import Path

import numpy as np

from ..materials.base import function
from ..output import layout
from ..output.ledger import Rows
from ..scene.probes import SIDES, Probe
from ..scene.scene import Scene
from .step import Simulation
from .watch import about


def files(scene: Scene, folder: Path) -> dict[Path, list[layout.Dataset]]:
    """The files of all probes and their columns."""
    return {
        folder / layout.PROBE_NAME.format(probe.name): layout.PROBE_COLUMNS[probe.kind]
        for probe in scene.probe
    }


class Probes:
    """All probes of a run and their rows so far, on rank 0. Collective.

    rows: by the name of the probe, dicts of layout.PROBE_COLUMNS. folder: None: no files.
    """

    def __init__(
        self, scene: Scene, simulation: Simulation, folder: Path | None, last_step: int | None
    ):
        self.scene, self.simulation = scene, simulation
        self.rows: dict[str, list[dict]] = {probe.name: [] for probe in scene.probe}
        self.files: dict[str, Rows] = {}
        if folder is None:
            return
        for probe, (path, columns) in zip(scene.probe, files(scene, folder).items(), strict=True):
            self.files[probe.name] = Rows(path, columns, simulation.ranks, last_step)
            self.rows[probe.name] = list(self.files[probe.name].kept)

    def first(self) -> None:
        """The rows of the start."""
        for probe in self.scene.probe:
            self._sample(probe)

    def after_step(self, before: float) -> None:
        """The rows that are due after a step that began at `before` [s]."""
        for probe in self.scene.probe:
            if probe.due(before, self.simulation.time):
                self._sample(probe)

    def _sample(self, probe: Probe) -> None:
        measured = MEASURE[probe.kind](self, probe)
        if self.simulation.ranks.rank == 0:
            when = {"time": self.simulation.time, "step": self.simulation.step}
            self.rows[probe.name].append(when | measured)
        if probe.name in self.files:
            self.files[probe.name].append(self.rows[probe.name][-1:])

    def pressure(self, probe: Probe) -> dict:
        assert probe.pressure is not None  # the kind says so, here and below
        weight, total = 0.0, 0.0
        for g, near in self._near(probe.pressure, fluids=True):
            law, state = self.simulation.plan.groups[g].law, tuple(near.state.T)
            tau = function(law, "stress")(law, state, (0.0,) * 9)
            # of Kirchhoff stress tau = J sigma, so that volume times pressure is vol0 tr tau
            J = function(law, "volume_ratio")(law, state)
            weight += float((near.weight * near.volume * J).sum())
            total -= float((near.weight * near.volume * (tau[0] + tau[1] + tau[2]) / 3).sum())
        return {"pressure": total / weight if weight else np.nan}

    def velocity(self, probe: Probe) -> dict:
        assert probe.velocity is not None
        mass, momentum = 0.0, np.zeros(3)
        for g, near in self._near(probe.velocity, fluids=False):
            m = near.weight * near.volume * self.simulation.plan.groups[g].density
            mass += float(m.sum())
            momentum += (m[:, None] * near.v).sum(0)
        return _vector("velocity", momentum / mass if mass else np.full(3, np.nan))

    def level(self, probe: Probe) -> dict:
        """Particles are cubes of one cell, so that layers fill smoothly; what would stick out of
        the box is folded back into it.
        """
        assert probe.level is not None
        plan = self.simulation.plan
        filled = np.zeros(plan.cells[2] + 2)  # a layer below the floor and one above the roof
        for g, near in self._near((*probe.level, None), fluids=True):
            law = plan.groups[g].law
            share = function(law, "volume_ratio")(law, tuple(near.state.T))
            share = near.weight * near.volume * share / plan.dx**3
            at = near.x[:, 2] / plan.dx + 0.5
            layer = np.clip(np.floor(at).astype(np.int64), 0, plan.cells[2])
            filled += np.bincount(layer, share * (1 - (at - layer)), len(filled))
            filled += np.bincount(layer + 1, share * (at - layer), len(filled))
        filled[1] += filled[0]
        filled[-2] += filled[-1]
        return {"level": _surface(filled[1:-1]) * plan.dx}

    def _near(self, point: tuple, fluids: bool) -> list[tuple[int, "_Near"]]:
        """The particles within a cell of a point, group after group; on the other ranks, none."""
        plan, found = self.simulation.plan, []
        for g, group in enumerate(self.simulation.groups):
            if fluids and group.plan.family != "fluid":
                continue
            rows = self.simulation.ranks.root_rows(_rows_near(group, point, plan.dx))
            if rows is not None and len(rows):
                found.append((g, _Near(rows, point, plan)))
        return found

    def object(self, probe: Probe) -> dict:
        assert probe.object is not None
        plan = self.simulation.plan
        k = [thing.name for thing in self.scene.object].index(probe.object)
        members = [plan.group_of[k]]
        members += [one.joins for one in plan.driven if k in one.things]
        last = plan.first_id[k] + plan.count[k] - 1
        rows = np.zeros((0, 7))
        for g in members:
            mine = about(self.simulation, self.simulation.groups[g], plan.first_id[k], last)
            found = self.simulation.ranks.root_rows(mine)
            rows = rows if found is None else np.concatenate([rows, found])
        if self.simulation.ranks.rank != 0:
            return {}
        total = rows.sum(0)
        mass, momentum = float(total[0]), total[1:4]
        rate, dt = self._rate(probe, momentum)
        weight = mass * self._gravity(dt)
        return (
            {"mass": mass}
            | _vector("center", total[4:7] / mass)
            | _vector("velocity", momentum / mass)
            | _vector("momentum", momentum)
            | _vector("force", rate - weight)
        )

    def wall(self, probe: Probe) -> dict:
        mass, momentum = 0.0, np.zeros(3)
        for group in self.simulation.groups:
            mine = about(self.simulation, group, 0, self.simulation.plan.particles)
            rows = self.simulation.ranks.root_rows(mine)
            if rows is not None and len(rows):
                total = rows.sum(0)
                mass, momentum = mass + float(total[0]), momentum + total[1:4]
        if self.simulation.ranks.rank != 0:
            return {}
        rate, dt = self._rate(probe, momentum)
        given = mass * self._gravity(dt)
        if dt and self.simulation.loads is not None:
            now = self.simulation.time
            given = given + self.simulation.loads.impulse(now - dt, now) / dt
        return _vector("momentum", momentum) | _vector("force", given - rate)

    def one_wall(self, probe: Probe) -> dict:
        return self._given(probe, SIDES.index(probe.wall or "") - len(SIDES))

    def collider(self, probe: Probe) -> dict:
        assert self.simulation.given is not None
        names = [thing.name for thing in self.scene.object]
        name = probe.collider or ""
        row = self.simulation.given.row(name, names.index(name))
        work = float(self.simulation.given.totals[row, 6])
        before = self.rows[probe.name][-1]["all_work"] if self.rows[probe.name] else np.nan
        return self._given(probe, row) | {"work": work - before, "all_work": work}

    def _given(self, probe: Probe, row: int) -> dict:
        """Force and torque on a collider or a wall, by its row in Given."""
        assert self.simulation.given is not None
        so_far = -self.simulation.given.totals[row]  # of the bodies on it
        impulse, swing = _vector("impulse", so_far[:3]), _vector("swing", so_far[3:6])
        force, torque = np.full((2, 3), np.nan)
        if self.rows[probe.name]:
            last = self.rows[probe.name][-1]
            dt = self.simulation.time - last["time"]
            force = np.array([impulse[name] - last[name] for name in impulse]) / dt
            torque = np.array([swing[name] - last[name] for name in swing]) / dt
        return _vector("force", force) | _vector("torque", torque) | impulse | swing

    def _rate(self, probe: Probe, momentum: np.ndarray) -> tuple[np.ndarray, float]:
        """Mean rate of momentum [N] since the row before, and the time [s] since then; nan and 0 in
        the first row."""
        if not self.rows[probe.name]:
            return np.full(3, np.nan), 0.0
        before = self.rows[probe.name][-1]
        dt = self.simulation.time - before["time"]
        return (momentum - [before[f"momentum_{a}"] for a in "xyz"]) / dt, dt

    def _gravity(self, dt: float) -> np.ndarray:
        """Its mean over the last dt [s]: (3,) [m/s2]."""
        now = self.simulation.time
        return self.simulation.plan.gravity_between(now - dt, now) if dt else np.zeros(3)


MEASURE = {
    "pressure": Probes.pressure,
    "level": Probes.level,
    "velocity": Probes.velocity,
    "object": Probes.object,
    "wall": Probes.wall,
    "one wall": Probes.one_wall,
    "collider": Probes.collider,
}


class _Near:
    """Particles within a cell of a point: x (n, 3) [m], v (n, 3) [m/s], rest volume (n,) [m3],
    state (n, channels), and weight (n,), 1 - distance / cell along each axis."""

    def __init__(self, rows: np.ndarray, point: tuple, plan):
        self.x, self.v, self.volume = rows[:, 0:3], rows[:, 3:6], rows[:, 6]
        self.state = rows[:, 7:]
        self.weight = np.ones(len(rows))
        for a, middle in enumerate(point):
            if middle is None:
                continue
            x, size = self.x[:, a], plan.cells[a] * plan.dx
            # with what the walls mirror: a point at a wall sees a full cell
            images = (x, -x, 2 * size - x)
            hats = [np.maximum(1.0 - np.abs(image - middle) / plan.dx, 0.0) for image in images]
            self.weight *= hats[0] + hats[1] + hats[2]


def _rows_near(group, point: tuple, dx: float) -> np.ndarray:
    """Position, velocity, rest volume and state of this rank's particles within a cell of a point,
    in the order of their segments: (n, 7 + channels)."""
    near = np.ones(len(group.start), bool)
    for a, middle in enumerate(point):
        if middle is not None:
            # a particle strays at most 3 cells from its block's middle
            near &= np.abs(4 * group.block[:, a] + 1.5 - middle / dx) <= 5.0
    kept = np.flatnonzero(near)
    places = [np.arange(group.start[s], group.start[s] + group.count[s]) for s in kept]
    at = np.concatenate([np.zeros(0, np.int64), *places])
    block = np.repeat(group.block[kept], group.count[kept], axis=0)
    x = group.lattice.position(block, group.xi[:, at], group.real)
    inside = np.ones(len(at), bool)
    for a, middle in enumerate(point):
        if middle is not None:
            inside &= np.abs(x[:, a] - middle) < dx
    at = at[inside]
    state = [group.get(name, at) for name in group.plan.carries]
    parts = [x[inside], group.get("v", at), group.get("vol0", at), *state]
    return np.concatenate(parts, 1).astype(np.float64)


def _surface(filled: np.ndarray) -> float:
    """Height [cells] of what fills the layers (n,) from below: of the highest layer that is filled
    by half, told by the volume in it and in its neighbours; lower layers are taken as full."""
    half = np.flatnonzero(filled >= 0.5)
    top = int(half[-1]) if len(half) else 0
    base = max(top - 1, 0)
    return base + float(filled[base : top + 3].sum())


def _vector(name: str, values: np.ndarray) -> dict:
    return {f"{name}_{a}": float(value) for a, value in zip("xyz", values)}
