"""Moving colliders as the grid sees them, step by step."""

from collections.abc import Callable
from typing import Any

import numpy as np

from vgmpi.kernels.step_records import StepSpan
from vgmpi.parallel.block_lattice import BLOCK_EDGE, BlockLattice
from vgmpi.scene.rigid_motion import Trajectories

from .sdf_sampling import SampledSdf, evaluate_colliders
from .static_colliders import SDF_BAND_CELLS, StaticColliders

SDF_SPACING_CELLS = 0.5  # [cells] spacing of the points at which a collider's distance is sampled
REBUILD_DISTANCE_CELLS = (
    1.0  # [cells] travel of a collider after which the blocks near it are searched again
)
MAX_COLLIDER_TRAVEL_CELLS = 0.3  # [cells] largest travel of a collider in a step
MAX_BISECTIONS = 20  # largest number of times that a step is shortened for this limit
_MAX_POINTS = 500_000  # points that are evaluated together


class MovingColliders:
    """Distance, normal and velocity of the nearest collider, for the node blocks near colliders.

    The blocks remain valid until a collider has moved REBUILD_DISTANCE_CELLS. All ranks hold the
    same; nothing is sent. Calling it with blocks (n, 3) returns their rows.

    Attributes:
        nodes: Outward normal and distance [m], shape (n, 64, 4).
        moves: Velocity of the surface, shape (n, 64, 3) [m/s].
        collider_number: Number of the nearest collider, shape (n, 64) if requested, else (0, 64).
        blocks: Blocks, shape (n, 3).
    """

    def __init__(
        self, colliders: list, lattice: BlockLattice, real: np.dtype, numbered: bool = False,
        free: Any = None,
    ):  # fmt: skip
        """Sample the colliders at rest.

        Args:
            colliders: Objects with distance(points) -> (m,) [m] and ends() -> corners, both at
                rest, and `course`, None for a collider at rest. `detail` is what a feature has
                found of its faces; its `extend_table` adds that to the sampled colliders.
            lattice: Lattice of the blocks.
            real: Floating-point type of nodal values.
            numbered: Store the number of the nearest collider.
            free: State of those that a feature moves, see `FeaturePlan.moved_bodies`, or None.
        """
        self.dx, self.real, self.colliders = lattice.dx, real, colliders
        self.numbered = numbered
        self.table: SampledSdf = _sample_colliders(colliders, lattice.dx)
        details = [getattr(collider, "detail", None) for collider in colliders]
        for kind in dict.fromkeys(type(detail) for detail in details if detail is not None):
            own = [detail if isinstance(detail, kind) else None for detail in details]
            self.table = kind.extend_table(self.table, own)
        self.moving = [m for m, collider in enumerate(colliders) if collider.course is not None]
        self.courses = Trajectories([colliders[m].course for m in self.moving])
        self.free = free
        is_free = np.array([collider.body is not None for collider in colliders])
        self.is_free = is_free if is_free.any() else np.zeros(0, bool)
        self.max_radius = np.array(
            [colliders[m].course.max_radius(*colliders[m].ends()) for m in self.moving]
        )
        self.since = 0.0  # [s] time at which the blocks were searched
        self.now = 0.0
        self.take(np.zeros((0, 3), np.int64))

    def __call__(self, block: np.ndarray) -> np.ndarray:
        """Return the number of each block (n, 3) among those near a collider, else -1."""
        is_near = np.zeros(len(block), bool)
        for m in range(len(self.colliders)):
            is_near[self._blocks_near(m, block)] = True
        return np.where(is_near, np.cumsum(is_near) - 1, -1)

    def _blocks_near(self, m: int, block: np.ndarray) -> np.ndarray:
        """Return the rows of the blocks (n, 3) that are near collider `m`."""
        collider, table = self.colliders[m], self.table
        limit = (
            0.5 * np.sqrt(3.0) * (BLOCK_EDGE - 1) + SDF_BAND_CELLS + REBUILD_DISTANCE_CELLS
        ) * self.dx
        x = (
            (BLOCK_EDGE * block - 1 + (BLOCK_EDGE - 1) / 2) * self.dx
            - table.about[m]
            - table.move[m]
        )
        r = table.rotation[m]
        # written out: all ranks must agree, and the rounding of a matrix product may differ
        own = x[:, :1] * r[0] + x[:, 1:2] * r[1] + x[:, 2:] * r[2] + table.about[m]
        low, high = collider.ends()
        out = np.maximum(np.maximum(low - own, own - high), 0.0)
        close = np.flatnonzero((out**2).sum(axis=1) < limit**2)
        return close[collider.distance(own[close]) < limit]

    def take(self, blocks: np.ndarray) -> None:
        """Set the blocks (n, 3) of this rank near colliders, in the order of their numbers."""
        self.blocks, self.since = np.ascontiguousarray(blocks), self.now
        if self.free is not None:
            self.free.note_search()
        rows_of = [self._blocks_near(m, self.blocks) for m in range(len(self.colliders))]
        rows = np.concatenate(rows_of)
        order = np.argsort(rows, kind="stable")
        collider = np.repeat(np.arange(len(rows_of)), [len(each) for each in rows_of])[order]
        self.nearby = np.searchsorted(rows[order], np.arange(len(blocks) + 1)), collider
        self.nodes = np.zeros((len(blocks), 64, 4), self.real)
        self.moves = np.zeros((len(blocks), 64, 3), self.real)
        self.collider_number = np.zeros((len(blocks) * self.numbered, 64), np.int64)
        self.table = self.table.with_blocks(len(blocks))

    def place(self, time: float) -> None:
        """Place the colliders where they are at a time [s]."""
        self.now, table = time, self.table
        table.rotation[self.moving], table.move[self.moving] = self.courses.poses(time)
        if self.free is not None:
            self.free.place(table)

    def begin_step(self, span: StepSpan) -> None:
        """Place the colliders at the beginning of a step and compute their motion at the nodes."""
        self.place(span.start)
        table = self.table
        rotation, move = self.courses.poses(span.end)
        table.rotation_end[self.moving], table.move_end[self.moving] = rotation, move
        evaluate_colliders(
            self.blocks, *self.nearby, table, self.is_free, span.dt, self.dx, self.nodes,
            self.moves, self.collider_number,
        )  # fmt: skip

    def poses(self, time: float) -> np.ndarray | None:
        """Return the poses of the moving colliders relative to the start, shape (m, 4, 4) [m].

        None if none moves.
        """
        if self.free is None and not self.moving:
            return None
        if self.free is None:
            return self.courses.matrices(time)
        rows = np.concatenate([self.moving, self.free.rows]).astype(int)
        both = np.concatenate([self.courses.matrices(time), self.free.matrices()])
        return both[np.argsort(rows)]

    def travels(self, t0: float, t1: float) -> float:
        """Return the largest travel [cells] of a point of a collider between two times [s]."""
        travel = self.courses.travels(t0, t1, self.max_radius).max(initial=0.0)
        if self.free is not None:
            travel = max(travel, (t1 - t0) * self.free.speeds().max())
        return float(travel) / self.dx

    def limit_rate(self, time: float, rate: float) -> float:
        """Return 1 / dt [1/s], at least `rate`, of a step in which no collider moves too far."""
        return limit_rate_by_motion(self.travels, time, rate)

    def left_safe_range(self, time: float) -> bool:
        """Return True if the blocks near the colliders have to be searched again."""
        travel = self.courses.travels(self.since, time, self.max_radius).max(initial=0.0)
        if self.free is not None:
            travel = max(travel, self.free.travel.max())
        return float(travel) / self.dx > REBUILD_DISTANCE_CELLS / 2


def place_colliders(
    colliders: list, lattice: BlockLattice, real: np.dtype, numbered: bool, free: Any = None
) -> tuple[MovingColliders | None, MovingColliders | StaticColliders | None]:
    """Return the colliders that are evaluated every step, or None, and all colliders at the nodes.

    The former are those of scenes in which a collider moves or has a detail.

    Args:
        colliders: Colliders.
        lattice: Lattice of the blocks.
        real: Floating-point type of nodal values.
        numbered: Store the number of the nearest collider.
        free: See `MovingColliders`.
    """
    if any(_changes(collider) for collider in colliders):
        movers = MovingColliders(colliders, lattice, real, numbered, free)
        return movers, movers
    return None, StaticColliders(colliders, lattice, real, numbered) if colliders else None


def _changes(collider) -> bool:
    """Return whether a collider moves, or has a detail that is read in every step."""
    detail = getattr(collider, "detail", None)
    return any(each is not None for each in (collider.course, collider.body, detail))


def limit_rate_by_motion(
    travels: Callable[[float, float], float], time: float, rate: float
) -> float:
    """Return 1 / dt [1/s] of a step with a travel of at most MAX_COLLIDER_TRAVEL_CELLS.

    Args:
        travels: Function of two times [s] that returns the travel between them [cells].
        time: Beginning of the step [s].
        rate: Lower bound [1/s].
    """
    for _ in range(MAX_BISECTIONS):
        travel = travels(time, time + 1.0 / rate)
        if travel <= MAX_COLLIDER_TRAVEL_CELLS:
            break
        rate *= max(1.1, travel / MAX_COLLIDER_TRAVEL_CELLS)
    return rate


def _sample_colliders(colliders: list, dx: float) -> SampledSdf:
    """Sample the signed distances of colliders at rest, each on a lattice around it."""
    values, shapes, starts, spacing = [], [], [], SDF_SPACING_CELLS * dx
    for collider in colliders:
        low, high = collider.ends()
        start = low - (SDF_BAND_CELLS + 1) * dx
        shape = np.ceil((high - low + 2 * (SDF_BAND_CELLS + 1) * dx) / spacing).astype(np.int64) + 1
        values.append(_on_lattice(collider, start, shape, spacing))
        shapes.append(shape)
        starts.append(start)
    m = len(colliders)
    about = [c.course.about if c.course is not None else (0.0, 0.0, 0.0) for c in colliders]
    first = np.concatenate([[0], np.cumsum([len(v) for v in values])[:-1]]).astype(np.int64)
    turned = np.tile(np.eye(3), (m, 1, 1))
    return SampledSdf(
        np.concatenate(values), first, np.array(shapes), np.array(starts), spacing,
        np.array(about), turned, np.zeros((m, 3)), turned.copy(), np.zeros((m, 3)),
    )  # fmt: skip


def _on_lattice(collider, start: np.ndarray, shape: np.ndarray, spacing: float) -> np.ndarray:
    """Return the signed distances [m] of a collider at all points of a lattice."""
    out = np.empty(int(np.prod(shape)))
    for low in range(0, len(out), _MAX_POINTS):
        index = np.stack(
            np.unravel_index(np.arange(low, min(low + _MAX_POINTS, len(out))), shape), -1
        )
        out[low : low + _MAX_POINTS] = collider.distance(start + spacing * index)
    return out
