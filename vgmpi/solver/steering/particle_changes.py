"""Velocities and forces that a program gives to single particles between two steps."""

import zlib
from typing import NamedTuple

import numpy as np

from vgmpi.features.active_feature import ActiveFeature
from vgmpi.features.particle_insertion import bounds_of_particles
from vgmpi.kernels.step_records import ParticleBounds, StepSpan
from vgmpi.parallel.particle_group import ParticleGroup

SETTABLE = {"velocity": ("v", 3), "C": ("C", 9)}  # channel and width, by the name in the files


class Owned(NamedTuple):
    """Particles of one group on this rank among those that a program names."""

    group: ParticleGroup
    indices: np.ndarray  # (m,) in the arrays of the group
    rows: np.ndarray  # (m,) in what the program gives


class ParticleChanges(ActiveFeature):
    """Changes of single particles by a program. All methods are collective.

    Every rank gives the same ids and values and changes the particles that it owns: the result has
    the same bits on any number of ranks.

    Attributes:
        impulse: Impulse that the changes have given to all particles so far, shape (3,) [N s].
    """

    def __init__(self, simulation):
        """Begin without any change."""
        self.simulation, self.impulse = simulation, np.zeros(3)
        plan, self.ranks = simulation.plan, simulation.ranks
        self.prescribed_groups = {g for g, group in enumerate(plan.groups) if group.is_carried}
        self._clear()

    def _clear(self) -> None:
        """Forget the forces."""
        self.accelerations: list[tuple[Owned, np.ndarray]] = []  # those of the next step [m/s2]
        self.fastest, self.force = 0.0, np.zeros(3)  # their bound [m/s2] and their sum [N]

    def set_values(self, name: str, ids, values) -> None:
        """Set the velocity or its gradient of particles, and bound the next step by it.

        Args:
            name: A key of SETTABLE.
            ids: Ids of the particles, shape (n,).
            values: Values, shape (n, width) or (width,) for all.

        Raises:
            ValueError: On all ranks, if something is wrong with the arguments; nothing is changed.
        """
        simulation, plan = self.simulation, self.simulation.plan
        channel, width = SETTABLE.get(name, ("", 0))
        problem = "" if channel else f"only {' and '.join(SETTABLE)} can be set"
        if name == "C" and not plan.affine:
            problem = "the transfer of this scene has no velocity gradient"
        what = f"set {name}"
        ids, values = self._checked(what, problem, ids, values, width)
        owned, mass, before = self._owned(what, ids)
        rounded = values.astype(plan.real)
        own = ParticleBounds()
        for group, indices, rows in owned:
            if len(indices):
                group.put(channel, indices, rounded[rows])
                own = own.merge(bounds_of_particles(plan, group, indices))
        rate, speed, turn, stress = self.ranks.max(np.array(own)).tolist()
        simulation.rate, was = max(simulation.rate, rate), simulation.particle_maxima
        simulation.particle_maxima = was._replace(
            speed=max(was.speed, speed), turn=max(was.turn, turn),
            stress=max(was.stress, stress), rate=max(was.rate, rate),
        )  # fmt: skip
        if name == "velocity":
            self.impulse += (mass[:, None] * (rounded.astype(float) - before)).sum(0)

    def add_forces(self, ids, forces) -> None:
        """Add forces that act on particles during the next step, and during that step only.

        Args:
            ids: Ids of the particles, shape (n,).
            forces: Forces, shape (n, 3) or (3,) for each [N].

        Raises:
            ValueError: On all ranks, if something is wrong with the arguments; nothing is added.
        """
        ids, forces = self._checked("add_force", "", ids, forces, 3)
        owned, mass, _ = self._owned("add_force", ids)
        acceleration = forces / mass[:, None]
        if len(ids):
            self.fastest += float(np.sqrt((acceleration**2).sum(1)).max())
        self.force += forces.sum(0)
        self.accelerations += [(part, acceleration[part.rows]) for part in owned]

    def limit_rate(self, time: float, rate: float) -> float:
        """Return the least 1/dt [1/s] with the speeds that the forces add in a step."""
        plan = self.simulation.plan
        if not self.fastest:
            return rate
        cells = min(plan.time_step.cfl, plan.time_step.max_cells)
        return rate + self.fastest / (rate * cells * plan.dx)

    def push_particles(self, span: StepSpan) -> float:
        """Apply the forces of a step to the velocities; return a bound [m/s] of what they add."""
        dt = span.dt
        if not self.accelerations:
            return 0.0
        for (group, indices, _), acceleration in self.accelerations:
            v = group.get("v", indices) + dt * acceleration
            group.put("v", indices, v.astype(group.real))
        bound = dt * self.fastest
        self.impulse += dt * self.force
        self._clear()
        return bound

    def _checked(self, what: str, problem: str, ids, values, width: int):
        """Return ids (n,) and values (n, width); raise ValueError on all ranks if they are wrong.

        Args:
            what: What the program asks for, as a message names it.
            problem: What is already known to be wrong, or "".
            ids: Ids as given.
            values: Values as given.
            width: Numbers of a particle.
        """
        plan = self.simulation.plan
        if not problem:
            try:
                ids = checked_ids(ids, plan.particles)
                values = checked_values(values, ids, width, plan.real)
            except ValueError as error:
                problem = str(error)
        digest = 0 if problem else zlib.crc32(values.tobytes(), zlib.crc32(ids.tobytes()))
        wrong, high, low = self.ranks.max(np.array([bool(problem), digest, -digest], float))
        if wrong:
            problem = problem or "another rank gives what is not allowed"
        elif high != -low:
            problem = "all ranks must give the same ids and values"
        if problem:
            raise ValueError(f"{what}: {problem}")
        return ids, values

    def _owned(self, what: str, ids: np.ndarray) -> tuple[list[Owned], np.ndarray, np.ndarray]:
        """Return this rank's particles among ids (n,), and the state of all of them.

        Returns:
            Particles by group, masses of all (n,) [kg] and velocities of all (n, 3) [m/s].

        Raises:
            ValueError: On all ranks, if one is absent or moves as prescribed.
        """
        order = np.argsort(ids)
        ordered, owned, states = ids[order], [], [np.zeros((0, 6))]
        for g, group in enumerate(self.simulation.groups if len(ids) else ()):
            indices = group.index()
            place = np.minimum(np.searchsorted(ordered, group.ids[indices]), len(ids) - 1)
            is_named = ordered[place] == group.ids[indices]
            part = Owned(group, indices[is_named], order[place[is_named]])
            owned.append(part)
            mass = group.plan.density * group.get("vol0", part.indices).astype(float)
            is_prescribed = np.full(len(part.rows), g in self.prescribed_groups)
            for feature in self.simulation.features.values():
                is_prescribed |= np.isin(part.indices, feature.carried_particles(group))
            v = group.get("v", part.indices)
            states.append(np.column_stack([part.rows, is_prescribed, mass, v]))
        state = self.ranks.all_rows(np.concatenate(states))
        state = state[np.argsort(state[:, 0])]
        if len(state) < len(ids):
            absent = np.setdiff1d(np.arange(len(ids)), state[:, 0].astype(np.int64))
            message = f"particle {ids[absent[0]]} is not in the domain at this time"
            raise ValueError(f"{what}: {message}")
        if state[:, 1].any():
            first = ids[np.flatnonzero(state[:, 1])[0]]
            message = f"particle {first} moves as prescribed: by a motion, a pin or an inlet"
            raise ValueError(f"{what}: {message}")
        return owned, state[:, 2], state[:, 3:]


def checked_ids(ids, particles: int) -> np.ndarray:
    """Return ids of particles, shape (n,); raise ValueError if they are none.

    Args:
        ids: Ids as given.
        particles: Number of particles of the run.
    """
    array = np.atleast_1d(np.asarray(ids))
    if array.size == 0:
        array = array.astype(np.int64)
    if array.ndim != 1 or array.dtype.kind not in "iu":
        got = f"{array.dtype} of shape {array.shape}"
        raise ValueError(f"ids must be whole numbers, shape (n,); got {got}")
    outside = (array < 0) | (array >= particles)
    if outside.any():
        first = array[outside][0]
        raise ValueError(f"there is no particle {first}; their ids are 0 to {particles - 1}")
    ordered = np.sort(array)
    twice = ordered[1:][ordered[1:] == ordered[:-1]]
    if len(twice):
        raise ValueError(f"particle {twice[0]} is given twice")
    return np.ascontiguousarray(array, np.int64)


def checked_values(values, ids: np.ndarray, width: int, real: np.dtype) -> np.ndarray:
    """Return values of particles, shape (n, width); raise ValueError if they are none.

    Args:
        values: Values as given.
        ids: Ids of the particles, shape (n,).
        width: Numbers of a particle.
        real: Type of the run's numbers.
    """
    shape = (len(ids), width)
    try:
        array = np.asarray(values, np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"values must be numbers of shape {shape} or ({width},)") from None
    if array.shape not in (shape, (width,)):
        raise ValueError(f"values must have the shape {shape} or ({width},); got {array.shape}")
    array = np.ascontiguousarray(np.broadcast_to(array, shape))
    allowed = (np.abs(array) <= np.finfo(real).max).all(1)  # False for nan
    if not allowed.all():
        first = int(np.flatnonzero(~allowed)[0])
        got = ", ".join(f"{value:g}" for value in array[first])
        raise ValueError(f"values must be finite; that of particle {ids[first]} is [{got}]")
    return array
