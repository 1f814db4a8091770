"""Newton as a solver of the board: its implicit MPM on the processor, where Warp has one thread.

Numbers are those of its own examples: water as in mpm_water_dam_break, a viscous liquid as in
mpm_viscous, sand as in mpm_granular, bodies as in mpm_beam_twist.

A rigid block is coupled both ways as in mpm_twoway_coupling. That example moves its bodies by
MuJoCo; a single body that touches nothing solid needs no contact, so that Newton's own XPBD solver
moves it here.
"""

from typing import Any

import newton
import numpy as np
import warp as wp
from newton.examples.mpm.example_mpm_twoway_coupling import (
    compute_body_forces,
    subtract_body_force,
)
from newton.solvers import SolverImplicitMPM

from .board_cases import CASES, ELASTIC_DENSITY, SAND_ANGLE, SAND_DENSITY
from .board_state import Edges
from .jet_and_block import BLOCK_DENSITY

# options of the solver by family: iterations, tolerance, warmstart_mode, collider_basis
EXAMPLES = {
    "fluid": (50, 1e-3, "particles", "pic"),
    "viscous": (250, 1e-6, "auto", "S2"),
    "sand": (250, 1e-4, "auto", "S2"),
    "elastic": (250, 1e-6, "particles", "S2"),
}
PROJECTION = 0.25  # [cells] distance from a wall at which particles are moved away from it
FLOOR_FRICTION = 10.0
wp.config.quiet = True


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


@wp.kernel
def move_into_tank(
    x: wp.array(dtype=wp.vec3), v: wp.array(dtype=wp.vec3), low: wp.vec3, high: wp.vec3
):
    """Move particles that passed a wall back and stop them, as its example of a dam break does.

    Args:
        x: Positions [m] (in/out).
        v: Velocities [m/s] (in/out).
        low, high: Corners of the box in which particles may be [m].
    """
    i = wp.tid()
    position, velocity = x[i], v[i]
    for k in range(3):
        if position[k] < low[k]:
            position[k] = low[k]
            velocity[k] = wp.max(velocity[k], 0.0)
        elif position[k] > high[k]:
            position[k] = high[k]
            velocity[k] = wp.min(velocity[k], 0.0)
    x[i] = position
    v[i] = velocity


class Solver:
    """A case.

    Options: cell [m], dt [s], per_axis (particles), iterations, tolerance, collider_basis.
    """

    def __init__(self, case_name: str, options: dict[str, Any]):
        wp.set_device("cpu")
        self.case, self.cell = CASES[case_name], float(options["cell"])
        self.family, self.dt = self.case.family, float(options["dt"])
        per_axis = int(options.get("per_axis", 2 if self.family == "elastic" else 3))
        self.versions = {"newton": newton.__version__, "warp": wp.__version__}
        builder = newton.ModelBuilder()
        SolverImplicitMPM.register_custom_attributes(builder)
        particles = [self._add_particles(builder, per_axis, *box) for box in self.case.boxes()]
        tank = newton.ModelBuilder() if self.case.block else builder
        if self.case.tank:
            self._add_walls(tank, np.array(self.case.tank))
        self.block = None
        if self.case.block:
            self.block = FloatingBlock(tank, self.case.block, BLOCK_DENSITY)
            self.block.model.set_gravity((0.0, 0.0, -self.case.gravity))
        self.model = builder.finalize()
        self._set_material()
        if self.case.clamp:  # particles without mass hold the nodes of their cells
            fixed = np.flatnonzero(self.model.particle_q.numpy()[:, 0] < self.case.clamp)
            self.model.particle_mass[wp.array(fixed, dtype=int)].fill_(0.0)
        self.config = self._solver_config(options)
        self.volume = np.concatenate([np.full(n, volume) for n, volume in particles])
        if self.block:
            self.volume = np.append(self.volume, 0.0)  # the row of its center

    def _add_particles(
        self, builder: Any, per_axis: int, edges: Edges, corner: Edges
    ) -> tuple[int, float]:
        """Fill a box and return the number of its particles and the volume of each [m3]."""
        count = np.round(per_axis * np.array(edges) / self.cell).astype(int)
        spacing = np.array(edges) / count
        density = {"sand": SAND_DENSITY, "elastic": ELASTIC_DENSITY}.get(self.family, 1000.0)
        radius = 0.5 * float(spacing.max())
        builder.add_particle_grid(
            pos=wp.vec3(*(0.5 * spacing + corner)), rot=wp.quat_identity(), vel=wp.vec3(0.0),
            dim_x=int(count[0]), dim_y=int(count[1]), dim_z=int(count[2]),
            cell_x=float(spacing[0]), cell_y=float(spacing[1]), cell_z=float(spacing[2]),
            mass=float(np.prod(spacing) * density), radius_mean=radius,
            jitter=0.0 if self.family == "elastic" else 2 * radius,
            flags=newton.ParticleFlags.ACTIVE,
        )  # fmt: skip
        return int(count.prod()), float(np.prod(spacing))

    def _add_walls(self, builder: Any, tank: np.ndarray) -> None:
        """Add the tank: an open box of water as in its example, or boxes around sand."""
        thickness = max(4 * self.cell, 0.15 * float(tank.max()))
        smooth = newton.ModelBuilder.ShapeConfig(density=0.0, mu=0.0)
        if self.family == "fluid":
            points, triangles = hollow_box(tank, thickness)
            mesh = newton.Mesh(points, triangles, compute_inertia=False, is_solid=False)
            builder.add_shape_mesh(body=-1, mesh=mesh, cfg=smooth)
            builder.add_ground_plane(height=-thickness, cfg=smooth)
            if self.case.closed:
                half = tank / 2 + thickness * np.array([1.0, 1.0, 0.0])
                center = wp.vec3(tank[0] / 2, tank[1] / 2, 1.5 * tank[2])
                pose = wp.transform(center, wp.quat_identity())
                builder.add_shape_box(
                    body=-1, cfg=smooth, xform=pose, hx=half[0], hy=half[1], hz=half[2]
                )
            return
        rough = newton.ModelBuilder.ShapeConfig(density=0.0, mu=FLOOR_FRICTION)
        builder.add_ground_plane(cfg=rough)
        x, y, z = tank
        walls = (
            ((thickness / 2, y, z), (-thickness / 2, y / 2, z / 2)),
            ((x, thickness / 2, z), (x / 2, -thickness / 2, z / 2)),
            ((x, thickness / 2, z), (x / 2, y + thickness / 2, z / 2)),
        )
        for half, center in walls:
            pose = wp.transform(wp.vec3(*center), wp.quat_identity())
            builder.add_shape_box(
                body=-1, cfg=smooth, xform=pose, hx=half[0], hy=half[1], hz=half[2]
            )

    def _set_material(self) -> None:
        """Set gravity and the numbers of the law."""
        mpm = self.model.mpm
        self.model.set_gravity((0.0, 0.0, -self.case.gravity))
        if self.family == "fluid":
            numbers = {"friction": 0.0, "tensile_yield_ratio": 1.0}
            numbers["viscosity"] = self.case.viscosity
        elif self.family == "sand":
            friction = float(np.tan(np.radians(SAND_ANGLE)))
            numbers = {"friction": friction, "young_modulus": 1e15, "yield_pressure": 1e12}
        else:
            numbers = {
                "young_modulus": self.case.modulus, "poisson_ratio": 0.0, "damping": 0.0,
                "tensile_yield_ratio": 1.0,
            }  # fmt: skip
        for name, value in numbers.items():
            getattr(mpm, name).fill_(value)

    def _solver_config(self, options: dict[str, Any]) -> Any:
        """Return the solver's own configuration."""
        config = SolverImplicitMPM.Config()
        example = "viscous" if self.case.viscosity else self.family
        iterations, tolerance, warm_start, collider_basis = EXAMPLES[example]
        config.voxel_size = self.cell
        config.max_iterations = int(options.get("iterations", iterations))
        config.tolerance = float(options.get("tolerance", tolerance))
        config.warmstart_mode = warm_start
        config.collider_basis = str(options.get("collider_basis", collider_basis))
        config.velocity_basis, config.transfer_scheme = "Q1", "apic"
        config.integration_scheme, config.critical_fraction = "pic", 0.0
        elastic = self.family == "elastic"
        config.strain_basis = "P1d" if elastic else "P0"
        config.solver = "cr" if elastic else "auto"
        config.carry_residual_strain = "unconverged" if elastic else "none"
        return config

    def restart(self) -> None:
        """Begin the run again."""
        self.solver = SolverImplicitMPM(self.model, config=self.config)
        self.states = [self.model.state(), self.model.state()]
        self.steps = 0
        first = self.states[0]
        if self.family == "fluid":
            if self.block:
                self.block.restart(self.solver, self.states, PROJECTION * self.cell)
            else:
                self.solver.setup_collider(collider_projection_threshold=[PROJECTION * self.cell])
            first.mpm.particle_Jp.fill_(1.0)
            self.solver.project_outside(first, first, self.dt)
        if self.case.velocity:
            v, gradient = self.case.velocity(first.particle_q.numpy())
            first.particle_qd.assign(v.astype(np.float32))
            first.mpm.particle_qd_grad.assign(gradient.astype(np.float32))

    def advance(self, t: float) -> int:
        """Simulate up to a time [s] and return the number of steps."""
        count = round(t / self.dt) - self.steps
        for _ in range(count):
            now, following = self.states
            if self.block:
                self.block.advance(self.states, self.dt)
            self.solver.step(now, following, None, None, self.dt)
            if self.block:
                self.block.collect_impulses(self.solver, following)
            if self.family != "elastic":
                self.solver.project_outside(following, following, self.dt)
            if self.family == "fluid":
                self._move_into_tank(following)
            self.states.reverse()
        self.steps += count
        return count

    def _move_into_tank(self, state: Any) -> None:
        """Put particles that passed a wall of the tank back."""
        x, y, z = map(float, self.case.tank or (0, 0, 0))
        margin = PROJECTION * self.cell
        top = z + margin if self.case.closed else 10.0
        low, high = wp.vec3(-margin, -margin, -margin), wp.vec3(x + margin, y + margin, top)
        arrays = [state.particle_q, state.particle_qd, low, high]
        wp.launch(move_into_tank, dim=state.particle_count, inputs=arrays)

    def state(self) -> tuple[np.ndarray, np.ndarray]:
        """Return positions from the tank's corner and velocities, (n, 3) each [m], [m/s]."""
        x, v = self.states[0].particle_q.numpy().copy(), self.states[0].particle_qd.numpy().copy()
        if self.block:  # its center is the last row
            center, velocity = self.block.center()
            x, v = np.concatenate([x, center]), np.concatenate([v, velocity])
        return x, v


def hollow_box(size: np.ndarray, thickness: float) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices and triangles of an open box around [0, size], its faces turned inwards."""
    x, y, z = map(float, size)
    inner = [(0.0, 0.0), (x, 0.0), (x, y), (0.0, y)]
    t = thickness
    outer = [(-t, -t), (x + t, -t), (x + t, y + t), (-t, y + t)]
    points = [(*corner, 0.0) for corner in inner] + [(*corner, z) for corner in inner]
    points += [(*corner, -t) for corner in outer] + [(*corner, z) for corner in outer]
    quads = [(0, 1, 2, 3), (8, 11, 10, 9)]  # floor and underside
    for i in range(4):
        j = (i + 1) % 4
        quads += [
            (j, i, 4 + i, 4 + j),
            (8 + i, 8 + j, 12 + j, 12 + i),
            (4 + i, 12 + i, 12 + j, 4 + j),
        ]
    triangles = [triangle for a, b, c, d in quads for triangle in (a, b, c, a, c, d)]
    return np.array(points, np.float32), np.array(triangles, np.int32)
