"""Genesis as a solver of the board: its explicit MPM (APIC) on the processor.

Walls are the solver's own boundary, three cells inside of the bounds that it is given: they slip
and part. Sand stands on a plane with friction, since the boundary has none. A clamped body is
mirrored: fixed particles stop the nodes that they touch, but particles with a higher number still
add to them, so that the clamp must come last.
"""

import math
from typing import Any

import genesis as gs
import numpy as np
import torch

from .board_cases import CASES, ELASTIC_DENSITY, SAND_DENSITY
from .board_state import Edges
from .jet_and_block import BLOCK_DENSITY

STEP_PER_CELL = 0.02  # [s/m] that the solver suggests
FLOOR_FRICTION, FLOOR_SOFTNESS = 100.0, 0.002
# [deg] an angle of triaxial compression with the strength of SAND_ANGLE in plane strain
TRIAXIAL_ANGLE = 26.3
BLOCK_MODULUS = 1e5  # [Pa]


class Solver:
    """A case. Options: cell [m], step_per_cell [s/m], particle_size [cells], sampler, E [Pa]."""

    def __init__(self, case_name: str, options: dict[str, Any]):
        torch.set_num_threads(int(options.get("threads", 1)))
        gs.init(backend=gs.cpu, precision="32", logging_level="warning", seed=0)
        self.case, self.cell = CASES[case_name], float(options["cell"])
        self.size = float(options.get("particle_size", 0.5)) * self.cell
        step = float(options.get("step_per_cell", STEP_PER_CELL)) * self.cell
        self.substeps = max(1, math.ceil(self.case.interval / step - 1e-9))
        self.versions = {"genesis": gs.__version__, "torch": torch.__version__}
        self._build(options)
        self.volume = np.full(len(self.state()[0]), self.size**3)

    def _build(self, options: dict[str, Any]) -> None:
        """Make the scene."""
        case, family = self.case, self.case.family
        self.shift = np.zeros(3) if case.tank else np.full(3, 4 * self.cell)
        tank = np.array(case.tank or np.array(case.body) + 8 * self.cell)
        lower, upper = np.full(3, -3 * self.cell), tank + 3 * self.cell
        if family == "sand":  # the boundary lies below the plane
            lower[2] -= 2 * self.cell
        gravity = (0.0, 0.0, -case.gravity)
        scene = gs.Scene(
            sim_options=gs.options.SimOptions(
                dt=case.interval, substeps=self.substeps, gravity=gravity
            ),
            mpm_options=gs.options.MPMOptions(
                lower_bound=tuple(lower), upper_bound=tuple(upper), grid_density=1 / self.cell,
                particle_size=self.size,
            ),
            show_viewer=False,
        )  # fmt: skip
        shared = {"sampler": options.get("sampler", "regular")}
        modulus = float(options.get("E", 1e6))
        if case.viscosity:  # its shear modulus acts for one step
            step = case.interval / self.substeps
            material = gs.materials.MPM.Liquid(
                rho=1000.0, viscous=True, lam=case.bulk_modulus, mu=case.viscosity / step, **shared
            )
        elif family == "fluid":
            material = gs.materials.MPM.Liquid(E=modulus, rho=1000.0, **shared)
        elif family == "sand":
            angle = float(options.get("angle", TRIAXIAL_ANGLE))
            material = gs.materials.MPM.Sand(
                E=modulus, rho=SAND_DENSITY, friction_angle=angle, **shared
            )
            floor = gs.materials.Rigid(
                needs_coup=True, coup_friction=FLOOR_FRICTION, coup_softness=FLOOR_SOFTNESS
            )
            scene.add_entity(morph=gs.morphs.Plane(), material=floor)
        else:
            material = gs.materials.MPM.Elastic(
                E=case.modulus, nu=0.0, rho=ELASTIC_DENSITY, model="corotation", **shared
            )
        self.bodies = [self._add_box(scene, *box, material) for box in case.boxes()]
        if case.block:  # as in its example flush_cubes
            material = gs.materials.MPM.Elastic(
                E=BLOCK_MODULUS, nu=0.0, rho=BLOCK_DENSITY, model="corotation", **shared
            )
            self.bodies.append(self._add_box(scene, *case.block, material))
        self.scene = scene
        scene.build()

    def _add_box(self, scene: Any, edges: Edges, corner: Edges, material: Any) -> Any:
        """Add a box and return its entity."""
        center = tuple(np.array(edges) / 2 + corner + self.shift)
        return scene.add_entity(morph=gs.morphs.Box(pos=center, size=edges), material=material)

    def restart(self) -> None:
        """Begin the run again."""
        self.scene.reset()
        self.intervals = 0
        if self.case.velocity:
            v, _ = self.case.velocity(self.state()[0])
            self.bodies[0].set_particles_vel(torch.tensor(v.astype(np.float32)))
        if self.case.clamp:
            # particles that touch no nodes beyond the clamp's end
            fixed = self.state()[0][:, 0] < self.case.clamp - 0.5 * self.cell
            self.bodies[0].set_free(torch.tensor(~fixed))

    def advance(self, t: float) -> int:
        """Simulate up to a time [s] and return the number of steps."""
        count = round(t / self.case.interval) - self.intervals
        for _ in range(count):
            self.scene.step()
        self.intervals += count
        return count * self.substeps

    def state(self) -> tuple[np.ndarray, np.ndarray]:
        """Return positions from the tank's corner and velocities, (n, 3) each [m], [m/s]."""
        x, v = (
            np.concatenate([values.cpu().numpy().reshape(-1, 3) for values in rows])
            for rows in (
                [body.get_particles_pos() for body in self.bodies],
                [body.get_particles_vel() for body in self.bodies],
            )
        )
        x = x - self.shift.astype(x.dtype)
        if self.case.clamp:
            x[:, 0], v[:, 0] = self.case.body[0] - x[:, 0], -v[:, 0]
        return x, v
