"""A rigid block in Newton's water, coupled both ways as in its example mpm_twoway_coupling.

The example moves its bodies by MuJoCo. A single body that touches nothing solid needs no contact,
so that Newton's own XPBD solver moves it here.
"""

from typing import Any

import newton
import numpy as np
import warp as wp
from newton.examples.mpm.example_mpm_twoway_coupling import (
    compute_body_forces,
    subtract_body_force,
)

from .board_state import Edges


class FloatingBlock:
    """A rigid block between smooth walls, and the forces that the water exerts on it.

    Attributes:
        model: Block and walls, the colliders of the water.
    """

    def __init__(self, builder: Any, box: tuple[Edges, Edges], density: float):
        """Add the block to a builder that has the walls.

        Args:
            builder: Builder of the model, with gravity.
            box: Edges and lower corner of the block [m].
            density: Density of the block [kg/m3].
        """
        half, corner = np.array(box[0]) / 2, np.array(box[1])
        body = builder.add_body(xform=wp.transform(wp.vec3(*(corner + half)), wp.quat_identity()))
        cfg = newton.ModelBuilder.ShapeConfig(density=density, mu=0.0)
        builder.add_shape_box(body=body, hx=half[0], hy=half[1], hz=half[2], cfg=cfg)
        self.model = builder.finalize()
        self.solver = newton.solvers.SolverXPBD(self.model)
        self.pipeline = newton.CollisionPipeline(self.model)
        self.contacts = self.pipeline.contacts()

    def restart(self, mpm: Any, water: list[Any], projection: float) -> None:
        """Begin the run again.

        Args:
            mpm: Solver of the water.
            water: Its states.
            projection: Distance from a surface at which particles are moved away from it [m].
        """
        mpm.setup_collider(model=self.model, collider_projection_threshold=[projection] * 2)
        self.states = [self.model.state(), self.model.state()]
        first = self.states[0]
        for state in water:
            state.body_q, state.body_qd = wp.clone(first.body_q), wp.clone(first.body_qd)
            state.body_f = wp.zeros_like(first.body_f)
        self.force = wp.zeros_like(first.body_f)
        self.impulses: Any = None
        self.body_of_collider = mpm.collider_body_index

    def advance(self, water: list[Any], dt: float) -> None:
        """Move the block by a step under the last impulses, and give its pose to the water.

        Args:
            water: States of the water.
            dt: Time step [s].
        """
        now, following = self.states
        now.clear_forces()
        if self.impulses is not None:
            impulses, positions, colliders = self.impulses
            wp.launch(
                compute_body_forces, dim=colliders.shape[0],
                inputs=[dt, colliders, impulses, positions, self.body_of_collider, now.body_q,
                        self.model.body_com, now.body_f],
            )  # fmt: skip
        self.force.assign(now.body_f)
        self.pipeline.collide(now, self.contacts)
        self.solver.step(now, following, None, self.contacts, dt)
        self.states.reverse()
        for state in water:
            wp.launch(
                subtract_body_force, dim=1,
                inputs=[dt, following.body_q, following.body_qd, self.force,
                        self.model.body_inv_inertia, self.model.body_inv_mass,
                        state.body_q, state.body_qd],
            )  # fmt: skip

    def collect_impulses(self, mpm: Any, water: Any) -> None:
        """Keep the impulses of a step of the water for the next one of the block."""
        self.impulses = [wp.clone(values) for values in mpm.collect_collider_impulses(water)]

    def center(self) -> tuple[np.ndarray, np.ndarray]:
        """Return position and velocity of the center, (1, 3) each [m], [m/s]."""
        now = self.states[0]
        return now.body_q.numpy()[:1, :3], now.body_qd.numpy()[:1, :3]
