"""Dense background grid: B-spline weights, sums and gathers of particles, and walls.

Arrays cover the nodes -1 to cells + 1 along each axis, one beyond each wall. With quadratic
B-splines a particle touches the 27 nodes from its base node on.
"""

import numpy as np

from vgmpi.parallel.block_lattice import BLOCK_EDGE
from vgmpi.parallel.particle_group import ParticleGroup
from vgmpi.planning.phases_and_groups import PhasePlan
from vgmpi.planning.plan import Plan
from vgmpi.solver.engines.nodal_field_storage import FieldRequests

PUSHING = "separate", "yielding"  # kinds of walls that let go


class Stencil:
    """Nodes, weights and offsets of n particles.

    Args:
        base: Base nodes, shape (n, 3).
        inside: Position in the cell, shape (n, 3), 0 to 1.
        dx: Cell size [m].
    """

    def __init__(self, base: np.ndarray, inside: np.ndarray, dx: float):
        self.base, self.inside, self.dx = base, inside, dx
        f = inside
        self.w = np.stack([0.5 * (1.0 - f) ** 2, 0.75 - (f - 0.5) ** 2, 0.5 * f**2])  # (3, n, 3)
        self.d = np.stack([f - 1.0, 1.0 - 2.0 * f, f]) / dx  # [1/m] gradients of the weights
        self.r = np.stack([k - 0.5 - f for k in range(3)]) * dx  # [m] node minus particle

    def by_cells(self):
        """Yield 27 times index and gradient (n, 3) [1/m] by the means of cells.

        The gradient has the slopes of B-splines along its axis, and the weights of the two cells'
        means along the others (kernels/cell_stencil_sums.py).
        """
        f = self.inside
        mean = np.stack([0.5 * (1.0 - f), np.full_like(f, 0.5), 0.5 * f])
        for i, j, k in np.ndindex(3, 3, 3):
            index = tuple((self.base + (i, j, k) + 1).T)
            m, d = ([a[c, :, axis] for axis, c in enumerate((i, j, k))] for a in (mean, self.d))
            yield index, _product_gradient(m, d)

    def __iter__(self):
        """Yield 27 times index, weight, offset and gradient of the weight.

        The index selects nodes of dense arrays; the weight has shape (n,), node minus particle (n,
        3) [m], the gradient of the weight (n, 3) [1/m].
        """
        for i, j, k in np.ndindex(3, 3, 3):
            index = tuple((self.base + (i, j, k) + 1).T)
            w = [self.w[c, :, a] for a, c in enumerate((i, j, k))]
            d = [self.d[c, :, a] for a, c in enumerate((i, j, k))]
            r = np.stack([self.r[c, :, a] for a, c in enumerate((i, j, k))], 1)
            yield index, w[0] * w[1] * w[2], r, _product_gradient(w, d)


def _product_gradient(w: list[np.ndarray], d: list[np.ndarray]) -> np.ndarray:
    """Return the gradient (n, 3) of a product of weights (n,) along the axes, with slopes `d`."""
    return np.stack([d[0] * w[1] * w[2], w[0] * d[1] * w[2], w[0] * w[1] * d[2]], 1)


def stencil_of(group: ParticleGroup, dx: float) -> Stencil:
    """Return the stencil of a group's particles; dx: cell size [m]."""
    xi = group.xi[:, group.index()].astype(np.int64)
    block = np.repeat(group.block, group.count, axis=0)
    cell = xi >> group.bits
    inside = np.ldexp((xi - (cell << group.bits)).astype(np.float64), -group.bits)
    return Stencil(BLOCK_EDGE * block + 1 + cell.T, inside.T, dx)


class Dense:
    """Nodes of the domain and its walls."""

    def __init__(self, plan: Plan):
        self.cells, self.dx = plan.cells, plan.dx
        self.walls, self.splines = plan.walls.liquids, plan.splines
        self.walls_of_phases = [_walls_of(plan, phase) for phase in plan.phases]
        self.shape = tuple(n + 3 for n in plan.cells)
        # [m^3] Volume of the domain that belongs to each node; a wall halves it.
        part = [np.where((i == 0) | (i == n), 0.5, 1.0) for i, n in zip(self.nodes, self.cells,
                                                                        strict=True)]  # fmt: skip
        self.space = plan.dx**3 * part[0][:, None, None] * part[1][:, None] * part[2]

    @property
    def nodes(self) -> list[np.ndarray]:
        """Node numbers along each axis."""
        return [np.arange(-1, n + 2) for n in self.cells]

    def points(self) -> np.ndarray:
        """Return the positions of all nodes, shape (n, 3) [m]."""
        return np.stack(np.meshgrid(*self.nodes, indexing="ij"), -1).reshape(-1, 3) * self.dx

    def nodes_of_blocks(self, block: np.ndarray) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
        """Return which of the 64 nodes of blocks (n, 3) are in the arrays, and their indices."""
        node = np.stack(np.unravel_index(np.arange(BLOCK_EDGE**3), (BLOCK_EDGE,) * 3), -1)
        index = BLOCK_EDGE * block[:, None] + node  # the arrays begin at node -1, as block 0 does
        inside: np.ndarray = np.all((index >= 0) & (index < self.shape), axis=2)
        return inside, tuple(index[inside].T)

    # ---- particles to nodes ----------------------------------------------------------------------

    def sum(self, out: np.ndarray, stencil: Stencil, values: np.ndarray, slopes=None) -> None:
        """Add sum w (values + slopes (x_i - x_p)) to a field.

        Args:
            out (in/out): Field, shape (..., k).
            stencil: Stencil of the particles.
            values: Values of the particles, shape (n, k).
            slopes: Gradients of the values, shape (n, k, 3), or None.
        """
        for index, w, r, _ in stencil:
            term = values if slopes is None else values + np.einsum("nkb,nb->nk", slopes, r)
            np.add.at(out, index, w[:, None] * term)

    def sum_forces(self, out: np.ndarray, stencil: Stencil, tau: np.ndarray) -> None:
        """Subtract sum tau grad w from a field.

        The gradient is 4 w (x_i - x_p) / dx^2 (Hu 2018), or that of the B-splines.

        Args:
            out (in/out): Field, shape (..., 3).
            stencil: Stencil of the particles.
            tau: Volume times stress times time, shape (n, 3, 3).
        """
        for index, w, r, spline_gradient in stencil:
            gradient = spline_gradient if self.splines else 4.0 / self.dx**2 * w[:, None] * r
            np.add.at(out, index, -np.einsum("nab,nb->na", tau, gradient))

    # ---- nodes to particles ----------------------------------------------------------------------

    def gather(self, field: np.ndarray, stencil: Stencil) -> np.ndarray:
        """Return the interpolated field sum w field, shape (n, k)."""
        return np.sum([w[:, None] * field[index] for index, w, _, _ in stencil], 0)

    def gather_slopes(self, field: np.ndarray, stencil: Stencil, moments=None) -> np.ndarray:
        """Return the gradient of a field at the particles, shape (n, k, 3).

        Args:
            field: Values at the nodes, shape (..., k).
            stencil: Stencil of the particles.
            moments: Whether to use moments as APIC does, even if strains use B-spline gradients.
        """
        total = np.zeros((len(stencil.base), field.shape[-1], 3))
        for index, w, r, spline_gradient in stencil:
            gradient = (
                spline_gradient
                if self.splines and not moments
                else 4.0 / self.dx**2 * w[:, None] * r
            )
            total = total + np.einsum("nk,nb->nkb", field[index], gradient)
        return total

    # ---- walls -----------------------------------------------------------------------------------

    def open(self, wall: int) -> None:
        """Remove a wall that has vanished."""
        rows = [self.walls, *self.walls_of_phases]
        self.walls, *self.walls_of_phases = (
            tuple(("open", 0.0) if k == wall else old for k, old in enumerate(row)) for row in rows
        )

    def yields(self, phase: int) -> bool:
        """Return whether a phase has walls that let it go (yielding_walls.py)."""
        return any(kind == "yielding" for kind, _ in self.walls_of_phases[phase])

    def wall_planes(self, phase: int | None = None):
        """Yield axis, kind, friction and three planes of each wall; open walls are left out.

        The planes are the indices of the wall's nodes, of the nodes inside and of the nodes beyond.

        Args:
            phase: Phase whose walls are meant; those of liquids if None.
        """
        walls = self.walls if phase is None else self.walls_of_phases[phase]
        for axis in range(3):
            last = self.cells[axis] + 1
            for side, planes in enumerate(((1, 2, 0), (last, last - 1, last + 1))):
                kind, friction = walls[2 * axis + side]
                if kind != "open":
                    yield axis, kind, friction, *planes

    @staticmethod
    def mirror_sign(kind: str, axis: int) -> np.ndarray:
        """Return the factors by which a mirror multiplies the components of a vector."""
        sign = -np.ones(3) if kind == "stick" else np.ones(3)
        sign[axis] = -1.0
        return sign

    def fold(self, vectors, numbers, kind=None, recorder=None, phase=None) -> None:
        """Add the sums beyond mirroring walls to the mirror image of their node.

        Args:
            vectors (in/out): Vector field or None.
            numbers (in/out): Scalar field or None.
            kind: Kind of the mirror in place of the wall's.
            recorder: `WallRecorder` of the momentum, or None.
            phase: See `wall_planes`.
        """
        for axis, wall, _, plane, inside, beyond in self.wall_planes(phase):
            if wall in PUSHING:
                continue
            if recorder is not None:
                momentum_beyond = np.moveaxis(vectors, axis, 0)[beyond]
                recorder.record_fold(axis, plane, momentum_beyond, self.mirror_sign(wall, axis))
                if numbers is not None:
                    recorder.record_mass(axis, plane, np.moveaxis(numbers, axis, 0)[beyond])
            for field, sign in ((vectors, self.mirror_sign(kind or wall, axis)), (numbers, 1.0)):
                if field is not None:
                    along = np.moveaxis(field, axis, 0)
                    along[inside] += along[beyond] * sign
                    along[beyond] = 0.0
        for axis, wall, _, plane, _, beyond in self.wall_planes(phase):
            if wall == "separate" and recorder is not None and numbers is not None:
                recorder.record_mass(axis, plane, np.moveaxis(numbers, axis, 0)[beyond])

    def constrain(self, v: np.ndarray, phase: int | None = None, recorder=None, hold=None) -> None:
        """Apply the velocity constraints of the walls.

        Args:
            v (in/out): Velocities, shape (..., 3) [m/s].
            phase: See `wall_planes`.
            recorder: `WallRecorder`, or None.
            hold: `ColliderHold` of the phase, or None.
        """
        for axis, kind, friction, wall, _, beyond in self.wall_planes(phase):
            along = np.moveaxis(v, axis, 0)
            before = along[[wall, beyond]]
            inward = 1.0 if wall == 1 else -1.0
            if kind == "stick":
                along[wall] = 0.0
            elif kind == "slip":
                along[wall, ..., axis] = 0.0
            else:
                for plane in (wall, beyond):
                    _push_back(along[plane], axis, inward, friction)
            if recorder is not None:
                recorder.record_constraint(axis, wall, wall, along[wall] - before[0])
                recorder.record_constraint(axis, wall, beyond, along[beyond] - before[1])
            if hold is not None:
                hold.give_back(v, axis, wall, before[0])
                if kind in PUSHING:
                    hold.give_back(v, axis, beyond, before[1])

    def mirror(self, v: np.ndarray, phase: int | None = None, recorder=None) -> None:
        """Set the velocities beyond the walls as seen by the particles next to them.

        Args:
            v (in/out): Velocities, shape (..., 3) [m/s].
            phase: See `wall_planes`.
            recorder: `WallRecorder`, or None.
        """
        for axis, kind, _, wall, inside, beyond in self.wall_planes(phase):
            along = np.moveaxis(v, axis, 0)
            if kind not in PUSHING:
                along[beyond] = along[inside] * self.mirror_sign(kind, axis)
            else:
                inward = 1.0 if wall == 1 else -1.0
                lower = -inward * along[inside][..., axis]
                upper = np.maximum(inward * along[beyond][..., axis], lower)
                new = along[beyond].copy()
                new[..., axis] = inward * upper
                change, image = new - along[beyond], along[inside] * self.mirror_sign(kind, axis)
                empty = np.zeros(new.shape[:-1], bool)
                if kind == "yielding":  # as where all mass was folded back
                    empty = (along[beyond] == 0.0).all(-1)
                along[beyond] = np.where(empty[..., None], image, new)
                if recorder is not None:
                    recorder.record_mirror(axis, wall, np.where(empty[..., None], 0.0, change))
        for axis, kind, _, wall, inside, beyond in self.wall_planes(phase):
            along = np.moveaxis(v, axis, 0)
            if recorder is not None and kind == "yielding":
                recorder.record_folded(axis, wall, along[beyond] - along[inside])
            elif recorder is not None and kind not in PUSHING:
                recorder.record_mirror(axis, wall, along[beyond] - along[inside])

    def complete_wall_mass(self, mass: np.ndarray) -> np.ndarray:
        """Return the masses completed by the images of mirroring walls.

        Nodes on such walls hold the mass of one side only; nodes beyond take the mass inside.
        """
        mass = mass.copy()
        for axis, kind, _, wall, _, _ in self.wall_planes():
            if kind != "separate":
                np.moveaxis(mass, axis, 0)[wall] *= 2.0
        return self.symmetrize(mass)

    def symmetrize(self, field: np.ndarray) -> np.ndarray:
        """Return a scalar field with its mirror image beyond mirroring walls."""
        field = field.copy()
        for axis, kind, _, _, inside, beyond in self.wall_planes():
            if kind != "separate":
                along = np.moveaxis(field, axis, 0)
                along[beyond] = along[inside]
        return field


def _walls_of(plan: Plan, phase: PhasePlan) -> tuple[tuple[str, float], ...]:
    """Return the walls of a phase, without those that push its surfaces by contact."""
    if phase.is_liquid:
        return plan.walls.liquids
    pushing = "separate" if plan.separates_stress else "yielding"
    kind = "open" if phase.meets_walls_by_contact else pushing
    return tuple(
        (kind if wall == "separate" else wall, friction) for wall, friction in plan.walls.solids
    )


def _push_back(u: np.ndarray, axis: int, inward: float, friction: float) -> None:
    """Apply a wall that only pushes, with Coulomb friction, to the velocities of its plane."""
    push = np.maximum(-inward * u[..., axis], 0.0)
    hit = push > 0
    u[..., axis] = np.where(hit, 0.0, u[..., axis])
    size = np.linalg.norm(u, axis=-1)
    factor = np.maximum(size - friction * push, 0.0) / np.where(size > 0, size, 1.0)
    u *= np.where(hit, factor, 1.0)[..., None]


class NodalSums:
    """Sums of the particles at the nodes, by phase.

    Attributes:
        mass: Masses, shape (phases, ..., 1) [kg].
        momentum: Momenta, shape (phases, ..., 3) [kg m/s].
        forces: Impulses of the stress that is summed separately, shape (phases, ..., 3) [kg m/s].
        counted: Volumes of the particles whose stress is summed so, shape (phases, ..., 1) [m3].
        volume, offset: See `Contact.apply`, shapes (phases, ..., 1) and (phases, ..., 3).
        shear: Normal velocity gradients times mass, shape (phases, ..., 3) [kg m/s].
        velocity_before: Velocities before gravity and stress, shape (phases, ..., 3) [m/s].
        dt: Length of the step [s].
    """

    velocity_before: np.ndarray

    def __init__(self, phases: int, shape: tuple[int, ...], dt: float):
        """Begin with zeros.

        Args:
            phases: Number of phases.
            shape: Shape of the grid of nodes.
            dt: Length of the step [s].
        """
        self.dt = dt
        self.mass, self.volume, self.counted = (np.zeros((phases, *shape, 1)) for _ in range(3))
        self.momentum, self.forces, self.offset, self.shear = (
            np.zeros((phases, *shape, 3)) for _ in range(4)
        )


class CarriedFields:
    """Values that particles exchange through the grid and take back."""

    def __init__(self, plan: Plan, dense: Dense):
        """Create the fields of a plan, without values."""
        self.dense, self.requests, self.phases = dense, FieldRequests(plan), len(plan.phases)
        self.sums: dict[str, np.ndarray] = {}

    def clear(self) -> None:
        """Begin the sums of a step."""
        shape = self.phases, *self.dense.shape, 4
        self.sums = {name: np.zeros(shape) for name in self.requests.carried}

    def sum(self, group: ParticleGroup, stencil: Stencil, volumes: np.ndarray) -> None:
        """Add the values of a group, weighted by the volumes (n,) [m3] of its particles."""
        for name, channel in self.requests.carried_by(group.plan):
            values = group.f[channel : channel + 3, group.index()].T.astype(np.float64)
            rows = volumes[:, None] * np.column_stack([values, np.ones(len(values))])
            self.dense.sum(self.sums[name][group.plan.phase], stencil, rows)

    def average(self) -> None:
        """Replace sums by the mean over the phases of each set."""
        for name, carried in self.requests.carried.items():
            sums = self.sums[name]
            for number in np.unique(carried.set_of[carried.set_of >= 0]):
                total = sums[carried.set_of == number].sum(0)
                some = total[..., 3:] > 0
                mean = np.where(some, total / np.where(some, total[..., 3:], 1.0), 0.0)
                sums[carried.set_of == number] = mean

    def gather(self, group: ParticleGroup, stencil: Stencil) -> None:
        """Set the values of a group to the mean around its particles."""
        for name, channel in self.requests.carried_by(group.plan):
            mean = self.dense.gather(self.sums[name][group.plan.phase], stencil)
            group.f[channel : channel + 3, group.index()] = mean[:, :3].T


def mean_velocities(v: np.ndarray, mass: np.ndarray, groups: np.ndarray) -> np.ndarray:
    """Return velocities averaged over phases that move with one velocity.

    Args:
        v (in/out): Velocities, shape (phases, ..., 3) [m/s].
        mass: Nodal masses, shape (phases, ...) [kg].
        groups: Phases of one number move as one; -1: each by itself, shape (phases,).
    """
    for group in np.unique(groups[groups >= 0]):
        m = mass[groups == group][..., None]
        some, total = m.sum(0) > 0, m.sum(0)
        v[groups == group] = np.where(
            some, (m * v[groups == group]).sum(0) / np.where(some, total, 1.0), 0.0
        )
    return v
