"""Probes: quantities measured during a run, the same on any number of ranks.

A point probe needs few particles: their rows travel to rank 0 in the order of the segments'
keys, and all arithmetic is done there on one array. A body probe is summed segment by segment,
as in the conservation log.
"""

from pathlib import Path
from typing import Any

import numpy as np

from vgmpi.io import file_layout
from vgmpi.io.csv_log import CsvLog, read_rows
from vgmpi.materials.material import law_function
from vgmpi.scene.probes import WALL_NAMES, Probe
from vgmpi.scene.scene import Scene
from vgmpi.solver.simulation import Simulation

from .conservation import body_momentum


def files(scene: Scene, folder: Path) -> dict[Path, list[file_layout.Dataset]]:
    """Return the files of all probes and their columns."""
    rigid = {obj.name for obj in scene.object if obj.rigid}
    kinds = {probe.name: probe.kind_among(rigid) for probe in scene.probe}
    return {
        folder / file_layout.PROBE_NAME.format(name): file_layout.PROBE_COLUMNS[kind]
        for name, kind in kinds.items()
    }


class Probes:
    """All probes of a run and their rows, on rank 0. Collective.

    `rows` holds, by the name of the probe, dicts of file_layout.PROBE_COLUMNS: all of them without
    an output folder, else the last one, as the others are in the files.
    """

    def __init__(
        self, scene: Scene, simulation: Simulation, folder: Path | None, last_step: int | None
    ):
        """Open the files of the probes.

        Args:
            scene: The scene.
            simulation: The simulation.
            folder: Output folder, or None to write no files.
            last_step: Step of the checkpoint from which the run goes on, or None.
        """
        self.scene, self.simulation = scene, simulation
        self.rows: dict[str, list[dict]] = {probe.name: [] for probe in scene.probe}
        self.files: dict[str, CsvLog] = {}
        self.given_impulses: dict[str, np.ndarray] = {}  # (3,) [N s] at the last row, by probe
        self.rigid = {obj.name for obj in scene.object if obj.rigid}
        if folder is None:
            return
        for probe, (path, columns) in zip(scene.probe, files(scene, folder).items(), strict=True):
            self.files[probe.name] = CsvLog(path, columns, simulation.ranks, last_step)
            self.rows[probe.name] = self.files[probe.name].retained_rows[-1:]
            self.files[probe.name].retained_rows = []

    def first(self) -> None:
        """Record the rows of the start."""
        for probe in self.scene.probe:
            self._sample(probe)

    def after_step(self, before: float) -> None:
        """Record the rows that are due after a step that began at `before` [s]."""
        for probe in self.scene.probe:
            if probe.due(before, self.simulation.time):
                self._sample(probe)

    def _sample(self, probe: Probe) -> None:
        """Measure one probe and append its row."""
        measured = MEASURE[probe.kind_among(self.rigid)](self, probe)
        rows = self.rows[probe.name]
        if self.simulation.ranks.rank == 0:
            clock = {"time": self.simulation.time, "step": self.simulation.step}
            rows.append(clock | measured)
        if probe.name in self.files:
            self.files[probe.name].append(rows[-1:])
            del rows[:-1]

    def all_rows(self) -> dict[str, list[dict]]:
        """Return all rows by the name of the probe; without any on ranks other than 0.

        Raises:
            RunError: A file of the output folder is not as it was written.
        """
        if self.simulation.ranks.rank != 0:
            return self.rows
        read = {name: read_rows(log.path, log.columns) for name, log in self.files.items()}
        return self.rows | read

    def pressure(self, probe: Probe) -> dict:
        """Measure the pressure [Pa] of fluids at a point; NaN without fluid."""
        assert probe.pressure is not None  # guaranteed by the kind, here and below
        weight, total = 0.0, 0.0
        for g, particles in self._particles_near(probe.pressure, fluids=True):
            law, state = self.simulation.plan.groups[g].law, tuple(particles.state.T)
            tau = law_function(law, "stress")(law, state, (0.0,) * 9)
            # Kirchhoff stress tau = J sigma, so that volume times pressure is vol0 tr tau
            J = law_function(law, "volume_ratio")(law, state)
            weight += float((particles.weight * particles.volume * J).sum())
            total -= float(
                (particles.weight * particles.volume * (tau[0] + tau[1] + tau[2]) / 3).sum()
            )
        return {"pressure": total / weight if weight else np.nan}

    def velocity(self, probe: Probe) -> dict:
        """Measure the mean velocity [m/s] at a point, weighted by mass; NaN without particles."""
        assert probe.velocity is not None
        mass, momentum = 0.0, np.zeros(3)
        for g, particles in self._particles_near(probe.velocity, fluids=False):
            m = particles.weight * particles.volume * self.simulation.plan.groups[g].density
            mass += float(m.sum())
            momentum += (m[:, None] * particles.v).sum(0)
        return _vector("velocity", momentum / mass if mass else np.full(3, np.nan))

    def surface_height(self, probe: Probe) -> dict:
        """Measure the height [m] of the fluid surface over a point of the floor.

        Particles are cubes of one cell, so that layers fill smoothly; volume that would stick
        out of the box is folded back into it.
        """
        assert probe.surface_height is not None
        plan = self.simulation.plan
        filled = np.zeros(plan.cells[2] + 2)  # with a layer below the floor and one above the roof
        for g, particles in self._particles_near((*probe.surface_height, None), fluids=True):
            law = plan.groups[g].law
            fraction = law_function(law, "volume_ratio")(law, tuple(particles.state.T))
            fraction = particles.weight * particles.volume * fraction / plan.dx**3
            height = particles.x[:, 2] / plan.dx + 0.5
            layer = np.clip(np.floor(height).astype(np.int64), 0, plan.cells[2])
            filled += np.bincount(layer, fraction * (1 - (height - layer)), len(filled))
            filled += np.bincount(layer + 1, fraction * (height - layer), len(filled))
        filled[1] += filled[0]
        filled[-2] += filled[-1]
        return {"surface_height": _surface(filled[1:-1]) * plan.dx}

    def _particles_near(self, point: tuple, fluids: bool) -> list[tuple[int, "_Neighborhood"]]:
        """Return particles within a cell of a point by group, on rank 0; else nothing."""
        plan, neighborhoods = self.simulation.plan, []
        for g, group in enumerate(self.simulation.groups):
            if fluids and group.plan.family != "fluid":
                continue
            rows = self.simulation.ranks.gather_rows(_rows_near(group, point, plan.dx))
            if rows is not None and len(rows):
                neighborhoods.append((g, _Neighborhood(rows, point, plan)))
        return neighborhoods

    def object(self, probe: Probe) -> dict:
        """Measure mass, center, velocity, momentum and the contact force [N] of a body."""
        assert probe.object is not None
        plan = self.simulation.plan
        k = [obj.name for obj in self.scene.object].index(probe.object)
        members = [plan.group_of[k]]
        later = (feature.groups_after_release() for feature in plan.features)
        members += [groups[k] for groups in later if k in groups]
        members += sorted({region.group for region in plan.regions if region.object == k})
        parts = [part for feature in plan.features for part in feature.parts()]
        members += [part.group for part in parts if part.object == k]
        last = plan.first_id[k] + plan.count[k] - 1
        rows = np.zeros((0, 7))
        for g in members:
            local = body_momentum(
                self.simulation, self.simulation.groups[g], plan.first_id[k], last
            )
            gathered = self.simulation.ranks.gather_rows(local)
            rows = rows if gathered is None else np.concatenate([rows, gathered])
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

    def rigid_body(self, probe: Probe) -> dict:
        """Measure pose, velocities, momenta and mean force and torque of a rigid body."""
        coupling: Any = self.simulation.features["rigid_bodies"]
        bodies = coupling.bodies
        names = [coupling.movers.colliders[row].name for row in bodies.rows]
        k = names.index(probe.object)
        rate, dt = self._rate(probe, bodies.momentum[k])
        torque, _ = self._rate(probe, bodies.spin[k], "angular_momentum")
        return (
            {"mass": float(bodies.mass[k])}
            | _vector("center", bodies.x[k])
            | _vector("velocity", bodies.v[k, :3])
            | _vector("momentum", bodies.momentum[k])
            | _vector("force", rate - bodies.mass[k] * self._gravity(dt))
            | {f"rotation_{a}": float(value) for a, value in zip("wxyz", bodies.q[k])}
            | _vector("angular_velocity", bodies.v[k, 3:])
            | _vector("angular_momentum", bodies.spin[k])
            | _vector("torque", torque)
        )

    def wall(self, probe: Probe) -> dict:
        """Measure the momentum of all particles and the force [N] of the bodies on all walls."""
        mass, momentum = 0.0, np.zeros(3)
        for group in self.simulation.groups:
            local = body_momentum(self.simulation, group, 0, self.simulation.plan.particles)
            rows = self.simulation.ranks.gather_rows(local)
            if rows is not None and len(rows):
                total = rows.sum(0)
                mass, momentum = mass + float(total[0]), momentum + total[1:4]
        if self.simulation.ranks.rank != 0:
            return {}
        rate, dt = self._rate(probe, momentum)
        external_force = mass * self._gravity(dt) + self._force_of_changes(probe, dt)
        now = self.simulation.time
        for feature in self.simulation.features.values() if dt else ():
            external_force = external_force + feature.external_impulse(now - dt, now) / dt
        return _vector("momentum", momentum) | _vector("force", external_force - rate)

    def _force_of_changes(self, probe: Probe, dt: float) -> np.ndarray:
        """Return the mean force (3,) [N] that a program gave within dt [s] since the last row."""
        changes: Any = self.simulation.features.get("particle_changes")
        if changes is None:
            return np.zeros(3)
        before = self.given_impulses.get(probe.name, np.zeros(3))
        self.given_impulses[probe.name] = changes.impulse.copy()
        return (changes.impulse - before) / dt if dt else np.zeros(3)

    def one_wall(self, probe: Probe) -> dict:
        """Measure the force and torque of the bodies on one wall."""
        return self._reaction(probe, WALL_NAMES.index(probe.wall or "") - len(WALL_NAMES))

    def collider(self, probe: Probe) -> dict:
        """Measure force, torque and work of the bodies on a collider or of a prescribed body."""
        reactions: Any = self.simulation.features["reactions"]
        names = [obj.name for obj in self.scene.object]
        name = probe.collider or ""
        row = reactions.row(name, names.index(name))
        work = float(reactions.totals[row, 6])
        before = self.rows[probe.name][-1]["cumulative_work"] if self.rows[probe.name] else np.nan
        return self._reaction(probe, row) | {"work": work - before, "cumulative_work": work}

    def joint(self, probe: Probe) -> dict:
        """Measure position, force, torque and motor power of a joint in the last step."""
        bodies: Any = self.simulation.features["rigid_bodies"]
        names = [joint.name for joint in self.scene.lists["joint"]]
        state = bodies.joints.state(names.index(probe.joint))
        is_angle = self.scene.lists["joint"][names.index(probe.joint)].kind == "hinge"
        return (
            {"angle": state.coordinate if is_angle else np.nan}
            | {"length": np.nan if is_angle else state.coordinate}
            | _vector("force", state.force)
            | _vector("torque", state.torque)
            | {"motor_power": state.power}
        )

    def _reaction(self, probe: Probe, row: int) -> dict:
        """Return force [N] and torque [N m] on a collider or a wall, by its row in Reactions."""
        reactions: Any = self.simulation.features["reactions"]
        reaction = -reactions.totals[row]  # reaction of the bodies on it
        impulse = _vector("impulse", reaction[:3])
        angular_impulse = _vector("angular_impulse", reaction[3:6])
        force, torque = np.full((2, 3), np.nan)
        if self.rows[probe.name]:
            last = self.rows[probe.name][-1]
            dt = self.simulation.time - last["time"]
            force = np.array([impulse[name] - last[name] for name in impulse]) / dt
            torque = np.array([angular_impulse[k] - last[k] for k in angular_impulse]) / dt
        return _vector("force", force) | _vector("torque", torque) | impulse | angular_impulse

    def _rate(
        self, probe: Probe, momentum: np.ndarray, name: str = "momentum"
    ) -> tuple[np.ndarray, float]:
        """Return the mean rate of a momentum since the last row, and the time [s] since then.

        Both are undefined in the first row: NaN and 0.
        """
        if not self.rows[probe.name]:
            return np.full(3, np.nan), 0.0
        before = self.rows[probe.name][-1]
        dt = self.simulation.time - before["time"]
        return (momentum - [before[f"{name}_{a}"] for a in "xyz"]) / dt, dt

    def _gravity(self, dt: float) -> np.ndarray:
        """Return the mean gravity over the last dt [s], shape (3,) [m/s2]."""
        now = self.simulation.time
        return self.simulation.plan.gravity.mean_between(now - dt, now) if dt else np.zeros(3)


MEASURE = {
    "pressure": Probes.pressure,
    "surface_height": Probes.surface_height,
    "velocity": Probes.velocity,
    "object": Probes.object,
    "rigid body": Probes.rigid_body,
    "wall": Probes.wall,
    "one wall": Probes.one_wall,
    "collider": Probes.collider,
    "joint": Probes.joint,
}


class _Neighborhood:
    """Particles within a cell of a point.

    x (n, 3) [m], v (n, 3) [m/s], rest volume (n,) [m3], state (n, channels), and weight (n,):
    the product of 1 - distance / cell over the axes.
    """

    def __init__(self, rows: np.ndarray, point: tuple, plan):
        self.x, self.v, self.volume = rows[:, 0:3], rows[:, 3:6], rows[:, 6]
        self.state = rows[:, 7:]
        self.weight = np.ones(len(rows))
        for a, middle in enumerate(point):
            if middle is None:
                continue
            x, size = self.x[:, a], plan.cells[a] * plan.dx
            # the walls mirror particles: a point at a wall sees a full cell
            images = (x, -x, 2 * size - x)
            hats = [np.maximum(1.0 - np.abs(image - middle) / plan.dx, 0.0) for image in images]
            self.weight *= hats[0] + hats[1] + hats[2]


def _rows_near(group, point: tuple, dx: float) -> np.ndarray:
    """Return this rank's particles within a cell of a point, in the order of their segments.

    The rows (n, 7 + channels) hold position, velocity, rest volume and state.
    """
    is_near = np.ones(len(group.start), bool)
    for a, middle in enumerate(point):
        if middle is not None:
            # a particle strays at most 3 cells from its block's middle
            is_near &= np.abs(4 * group.block[:, a] + 1.5 - middle / dx) <= 5.0
    segments = np.flatnonzero(is_near)
    index_ranges = [np.arange(group.start[s], group.start[s] + group.count[s]) for s in segments]
    indices = np.concatenate([np.zeros(0, np.int64), *index_ranges])
    block = np.repeat(group.block[segments], group.count[segments], axis=0)
    x = group.lattice.position(block, group.xi[:, indices], group.real)
    inside = np.ones(len(indices), bool)
    for a, middle in enumerate(point):
        if middle is not None:
            inside &= np.abs(x[:, a] - middle) < dx
    indices = indices[inside]
    state = [group.get(name, indices) for name in group.plan.carries]
    parts = [x[inside], group.get("v", indices), group.get("vol0", indices), *state]
    return np.concatenate(parts, 1).astype(np.float64)


def _surface(filled: np.ndarray) -> float:
    """Return the height [cells] of the surface over layers filled to the fractions `filled` (n,).

    The surface is in the highest layer that is filled by half; its height follows from the volume
    in that layer and its neighbors. Lower layers are taken as full.
    """
    half = np.flatnonzero(filled >= 0.5)
    top = int(half[-1]) if len(half) else 0
    base = max(top - 1, 0)
    return base + float(filled[base : top + 3].sum())


def _vector(name: str, values: np.ndarray) -> dict:
    """Return a dict of a vector's components by the names name_x, name_y, name_z."""
    return {f"{name}_{a}": float(value) for a, value in zip("xyz", values)}
