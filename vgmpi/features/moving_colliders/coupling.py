"""Colliders that are evaluated in every step: those that move, and thin walls."""

import numpy as np

from vgmpi.features.active_feature import ActiveFeature, StartContext
from vgmpi.kernels.colliders.moving_colliders import MovingColliders
from vgmpi.kernels.step_records import StepMaxima, StepSpan
from vgmpi.parallel.block_ownership import BlockDirectory
from vgmpi.parallel.exchange_topology import ExchangeTopology


class ColliderMotion(ActiveFeature):
    """Moving colliders of a run; all ranks hold the same."""

    is_fixed = False

    def __init__(self, context: StartContext):
        """Take the colliders."""
        self.dx = context.plan.dx
        self.colliders: MovingColliders = context.movers

    def saved(self) -> dict:
        """Return the time at which the blocks near colliders were searched."""
        return {"sorted_time": self.colliders.since}

    def place_saved(self, attrs: dict, time: float) -> None:
        """Place the colliders where they were at the last sort.

        Args:
            attrs: Attributes of the checkpoint.
            time: Time of the checkpoint [s].
        """
        if self.colliders.free is not None:
            self.colliders.free.restore_search(attrs["bodies"]["bodies"])
        self.colliders.place(attrs.get("sorted_time", time))

    def place(self, time: float) -> None:
        """Place the colliders where they are at a time [s]."""
        self.colliders.place(time)

    def set_topology(self, tables: ExchangeTopology, census: BlockDirectory) -> None:
        """Take the blocks near colliders.

        Args:
            tables: Topology of this rank.
            census: Segments of this rank and nearby ones.
        """
        self.colliders.take(tables.coordinates[tables.solid >= 0])

    def limit_rate(self, time: float, rate: float) -> float:
        """Return 1 / dt [1/s], at least `rate`, of a step in which no collider moves too far."""
        return self.colliders.limit_rate(time, rate)

    def begin_step(self, span: StepSpan) -> None:
        """Place the colliders and compute their motion at the nodes."""
        self.colliders.begin_step(span)

    def push_particles(self, span: StepSpan) -> float:
        """Return the largest speed [m/s] of a point of a collider."""
        return self.dx * self.colliders.travels(span.start, span.end) / span.dt

    def collider_poses(self, time: float) -> np.ndarray | None:
        """Return the poses of the colliders, shape (m, 4, 4), start -> `time` [m]."""
        return self.colliders.poses(time)

    def needs_sort(self, span: StepSpan, maxima: StepMaxima) -> bool:
        """Return whether the blocks near colliders have to be searched again."""
        return self.colliders.left_safe_range(span.end)
