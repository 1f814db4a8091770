"""Dense arrays over all nodes of the domain: weights, sums and gathers of particles, and its walls.

Arrays cover the nodes -1 .. cells + 1 along each axis, one beyond each wall. Quadratic B-splines:
a particle touches the 27 nodes from its base node on.
"""

import numpy as np

from ...planning.plan import Plan


class Stencil:
    """The nodes, weights and offsets of n particles.

    base: (n, 3) base nodes; inside: (n, 3) where in its cell each lies, 0 .. 1.
    """

    def __init__(self, base: np.ndarray, inside: np.ndarray, dx: float):
        self.base, self.dx = base, dx
        f = inside
        self.w = np.stack([0.5 * (1.0 - f) ** 2, 0.75 - (f - 0.5) ** 2, 0.5 * f**2])  # (3, n, 3)
        self.d = np.stack([f - 1.0, 1.0 - 2.0 * f, f]) / dx  # their slopes [1/m]
        self.r = np.stack([k - 0.5 - f for k in range(3)]) * dx  # node minus particle [m]

    def __iter__(self):
        """27 times: index into dense arrays, weight (n,), node minus particle (n, 3) [m], slope of
        the weight (n, 3) [1/m]."""
        for i, j, k in np.ndindex(3, 3, 3):
            index = tuple((self.base + (i, j, k) + 1).T)
            w = [self.w[c, :, a] for a, c in enumerate((i, j, k))]
            d = [self.d[c, :, a] for a, c in enumerate((i, j, k))]
            r = np.stack([self.r[c, :, a] for a, c in enumerate((i, j, k))], 1)
            slope = np.stack([d[0] * w[1] * w[2], w[0] * d[1] * w[2], w[0] * w[1] * d[2]], 1)
            yield index, w[0] * w[1] * w[2], r, slope


class Dense:
    """The nodes of a domain."""

    def __init__(self, plan: Plan):
        self.cells, self.dx = plan.cells, plan.dx
        self.walls, self.splines = plan.walls, plan.splines
        self.shape = tuple(n + 3 for n in plan.cells)
        # [m3] of the domain that belongs to each node: half a cell's on a wall
        part = [np.where((i == 0) | (i == n), 0.5, 1.0) for i, n in zip(self.nodes, self.cells,
                                                                        strict=True)]  # fmt: skip
        self.space = plan.dx**3 * part[0][:, None, None] * part[1][:, None] * part[2]

    @property
    def nodes(self) -> list[np.ndarray]:
        """Numbers of the nodes along each axis."""
        return [np.arange(-1, n + 2) for n in self.cells]

    def points(self) -> np.ndarray:
        """Positions of all nodes [m]: (n, 3)."""
        return np.stack(np.meshgrid(*self.nodes, indexing="ij"), -1).reshape(-1, 3) * self.dx

    # ---- particles to nodes ----------------------------------------------------------------------

    def sum(self, out: np.ndarray, stencil: Stencil, values: np.ndarray, slopes=None) -> None:
        """out += sum w (values + slopes (x_i - x_p)). values: (n, k); slopes: (n, k, 3) or None."""
        for index, w, r, _ in stencil:
            term = values if slopes is None else values + np.einsum("nkb,nb->nk", slopes, r)
            np.add.at(out, index, w[:, None] * term)

    def sum_forces(self, out: np.ndarray, stencil: Stencil, tau: np.ndarray) -> None:
        """out -= sum tau grad w, grad w = 4 w (x_i - x_p) / dx^2 (Hu 2018), or that of the
        B-splines. tau: (n, 3, 3), volume times stress times time."""
        for index, w, r, slope in stencil:
            along = slope if self.splines else 4.0 / self.dx**2 * w[:, None] * r
            np.add.at(out, index, -np.einsum("nab,nb->na", tau, along))

    # ---- nodes to particles ----------------------------------------------------------------------

    def gather(self, field: np.ndarray, stencil: Stencil) -> np.ndarray:
        """sum w field: (n, k)."""
        return np.sum([w[:, None] * field[index] for index, w, _, _ in stencil], 0)

    def gather_slopes(self, field: np.ndarray, stencil: Stencil, moments=None) -> np.ndarray:
        """The gradient of a field: (n, k, 3). moments: by moments, as APIC has it, whatever the
        strains are found by."""
        total = np.zeros((len(stencil.base), field.shape[-1], 3))
        for index, w, r, slope in stencil:
            by = slope if self.splines and not moments else 4.0 / self.dx**2 * w[:, None] * r
            total = total + np.einsum("nk,nb->nkb", field[index], by)
        return total

    # ---- walls -----------------------------------------------------------------------------------

    def ends(self):
        """(axis, kind, friction, places of the wall's nodes, of those inside, beyond) of walls, but
        for open ones, which do nothing."""
        for axis in range(3):
            last = self.cells[axis] + 1
            for side, places in enumerate(((1, 2, 0), (last, last - 1, last + 1))):
                kind, friction = self.walls[2 * axis + side]
                if kind != "open":
                    yield axis, kind, friction, *places

    @staticmethod
    def sign(kind: str, axis: int) -> np.ndarray:
        """What a mirror does to a vector."""
        sign = -np.ones(3) if kind == "stick" else np.ones(3)
        sign[axis] = -1.0
        return sign

    def fold(self, vectors, numbers, kind=None, tell=None) -> None:
        """Add what fell beyond the mirroring walls to the mirror image of its node. kind: of the
        mirror, in place of the wall's; tell: given.Teller of momentum, or None."""
        for axis, wall, _, plane, inside, beyond in self.ends():
            if wall == "separate":
                continue
            if tell is not None:
                beyond_it = np.moveaxis(vectors, axis, 0)[beyond]
                tell.folded(axis, plane, beyond_it, self.sign(wall, axis))
                if numbers is not None:
                    tell.weighed(axis, plane, np.moveaxis(numbers, axis, 0)[beyond])
            for field, by in ((vectors, self.sign(kind or wall, axis)), (numbers, 1.0)):
                if field is not None:
                    along = np.moveaxis(field, axis, 0)
                    along[inside] += along[beyond] * by
                    along[beyond] = 0.0
        for axis, wall, _, plane, _, beyond in self.ends():
            if wall == "separate" and tell is not None and numbers is not None:
                tell.weighed(axis, plane, np.moveaxis(numbers, axis, 0)[beyond])

    def constrain(self, v: np.ndarray, surface: bool = False, tell=None) -> None:
        """What the walls leave of velocities; surface: of a phase that meets walls which only push
        by contact; tell: given.Teller, or None."""
        for axis, kind, friction, wall, _, beyond in self.ends():
            along = np.moveaxis(v, axis, 0)
            before = along[[wall, beyond]]
            inward = 1.0 if wall == 1 else -1.0
            if kind == "stick":
                along[wall] = 0.0
            elif kind == "slip":
                along[wall, ..., axis] = 0.0
            elif not surface:
                for plane in (wall, beyond):
                    _push_back(along[plane], axis, inward, friction)
            if tell is not None:
                tell.stopped(axis, wall, wall, along[wall] - before[0])
                tell.stopped(axis, wall, beyond, along[beyond] - before[1])

    def mirror(self, v: np.ndarray, surface: bool = False, tell=None) -> None:
        """Velocities beyond the walls as the particles near them see them; surface: as of
        `constrain`; tell: given.Teller, or None."""
        for axis, kind, _, wall, inside, beyond in self.ends():
            along = np.moveaxis(v, axis, 0)
            if kind != "separate":
                along[beyond] = along[inside] * self.sign(kind, axis)
            elif not surface:
                inward = 1.0 if wall == 1 else -1.0
                least = -inward * along[inside][..., axis]
                most = np.maximum(inward * along[beyond][..., axis], least)
                change = np.zeros_like(along[beyond])
                change[..., axis] = inward * most - along[beyond][..., axis]
                along[beyond][..., axis] = inward * most
                if tell is not None:
                    tell.mirrored(axis, wall, change)
        for axis, kind, _, wall, inside, beyond in self.ends():
            if tell is not None and kind != "separate":
                along = np.moveaxis(v, axis, 0)
                tell.mirrored(axis, wall, along[beyond] - along[inside])

    def whole(self, mass: np.ndarray) -> np.ndarray:
        """Masses with the images of mirroring walls: on them, which hold one side's, and beyond."""
        mass = mass.copy()
        for axis, kind, _, wall, _, _ in self.ends():
            if kind != "separate":
                np.moveaxis(mass, axis, 0)[wall] *= 2.0
        return self.even(mass)

    def even(self, field: np.ndarray) -> np.ndarray:
        """Numbers with what mirroring walls show of them beyond."""
        field = field.copy()
        for axis, kind, _, _, inside, beyond in self.ends():
            if kind != "separate":
                along = np.moveaxis(field, axis, 0)
                along[beyond] = along[inside]
        return field


def _push_back(u: np.ndarray, axis: int, inward: float, friction: float) -> None:
    """A wall that only pushes, with Coulomb friction: on the velocities of its plane."""
    push = np.maximum(-inward * u[..., axis], 0.0)
    hit = push > 0
    u[..., axis] = np.where(hit, 0.0, u[..., axis])
    size = np.linalg.norm(u, axis=-1)
    keep = np.maximum(size - friction * push, 0.0) / np.where(size > 0, size, 1.0)
    u *= np.where(hit, keep, 1.0)[..., None]
