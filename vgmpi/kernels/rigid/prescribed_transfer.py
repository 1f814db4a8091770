"""Bodies with prescribed motion: their nodal velocities and the advection of their particles."""

import numpy as np

from vgmpi.kernels.particle_records import AFFINE
from vgmpi.kernels.simd import material_dispatch  # noqa: F401  (makes the tensors' functions callable)
from vgmpi.kernels.simd.cooperative import strided_range, sync_threads
from vgmpi.kernels.step_records import GRADIENT2, SPEED, STRAY
from vgmpi.kernels.transfer.g2p import OUT_OF_DOMAIN, keep_lowest_id
from vgmpi.materials.tensor_math.tensor import update_deformation_gradient
from vgmpi.runtime.jit import device_function, kernel


@device_function
def set_prescribed_velocity(block, nodes, phase, motions, dx):
    """Set the velocities of bodies with prescribed motion at the nodes of a block.

    Args:
        block: Context of the block.
        nodes: Nodal velocities (in/out), shape (256 node blocks,) [m/s].
        phase: Phase of each node block.
        motions: Prescribed motion of the phases in this step (prescribed_motion.py).
        dx: Cell size [m].
    """
    sync_threads()
    for nb in range(block.n0, block.n1 if len(motions.driven) > 0 else block.n0):
        p = phase[nb]
        if not motions.driven[p]:
            continue
        for node in strided_range(64):
            x = (block.low_x + node // 16) * dx - motions.about[p, 0]
            y = (block.low_y + node // 4 % 4) * dx - motions.about[p, 1]
            z = (block.low_z + node % 4) * dx - motions.about[p, 2]
            for c in range(3):
                turn = motions.turn[p, c]
                index = 256 * nb + 4 * node + c
                nodes[index] = turn[0] * x + turn[1] * y + turn[2] * z + motions.shift[p, c]
    sync_threads()


@kernel
def advect_prescribed(
    rows, segments, block, particles, phase, motions, turned, dx, dt, motion, report
):
    """Advect the particles of a body with prescribed motion and rotate their tensors.

    All other state stays that of the reference configuration and rotates with these tensors.

    Args:
        rows: Segments to process, shape (n,).
        segments: Segment table of the group.
        block: Block coordinates, shape (segments, 3).
        particles: Particle arrays of the group (in/out).
        phase: Phase of the group.
        motions: Prescribed motion of the phases in this step (prescribed_motion.py).
        turned: First channels of F - I, of the law and of a law without one, -1 if absent, shape
            (2,).
        dx, dt: Cell size [m] and unrounded time step [s].
        motion: Constants of the step (kernels/transfer/g2p.py).
        report: Running maxima (in/out), as in kernels/transfer/g2p.py, without a rate.
    """
    xi, f = particles.xi, particles.f
    turn, about = motions.turn[phase], motions.about[phase]
    dither = (motion.dither_x, motion.dither_y, motion.dither_z)
    max_distance, max_step = 0.0, 0.0
    for s in rows:
        for n in strided_range(segments.count[s]):
            p = segments.start[s] + n
            x = _lever_arm(0, p, xi, block[s], motion.units_per_cell, dx, about)
            y = _lever_arm(1, p, xi, block[s], motion.units_per_cell, dx, about)
            z = _lever_arm(2, p, xi, block[s], motion.units_per_cell, dx, about)
            inside = True
            for a in range(3):
                v = turn[a, 0] * x + turn[a, 1] * y + turn[a, 2] * z
                v += motions.shift[phase, a]
                f[a, p] = v
                displacement = v * dt / dx
                xi[a, p] += int(np.floor(displacement * motion.units_per_cell + dither[a]))
                position = float(xi[a, p]) / motion.units_per_cell
                inside &= segments.limit[s, a, 0] < position < segments.limit[s, a, 1]
                max_distance, max_step = (
                    max(max_distance, abs(position)),
                    max(max_step, abs(displacement)),
                )
            if not inside:
                keep_lowest_id(report, particles.ids[p], OUT_OF_DOMAIN)
            for a in range(3):
                for b in range(3):
                    f[AFFINE + 3 * a + b, p] = turn[a, b]
            _turn(f, p, turn, turned, dt)
    squared = 0.0
    for a in range(3):
        for b in range(3):
            squared += turn[a, b] * turn[a, b]
    record_prescribed_bounds(report, max_distance, max_step / dt, squared)


@device_function
def _lever_arm(a, p, xi, block, cell_units, dx, about):
    """Return the distance [m] along axis a of a particle from the center of rotation."""
    cell = float(xi[a, p]) / cell_units + 4 * block[a] + 1.5
    return cell * dx - about[a]


@device_function
def record_prescribed_bounds(report, distance, speed, squared):
    """Record the quantities that bound the next step.

    Args:
        report: Running maxima (in/out), see kernels/transfer/g2p.py.
        distance: Largest distance from the block center [cells].
        speed: Largest speed along an axis [cells/s].
        squared: Largest squared norm of the velocity gradient [1/s2].
    """
    report[STRAY] = max(report[STRAY], distance)
    report[SPEED] = max(report[SPEED], speed)
    report[GRADIENT2] = max(report[GRADIENT2], squared)


@device_function
def _turn(f, p, turn, turned, dt):
    """Rotate the deformation gradients of a particle, see `advect_prescribed`."""
    L = (
        turn[0, 0], turn[0, 1], turn[0, 2], turn[1, 0], turn[1, 1], turn[1, 2], turn[2, 0],
        turn[2, 1], turn[2, 2],
    )  # fmt: skip
    for k in range(2):
        q = turned[k]
        if q >= 0:
            h = (
                float(f[q, p]), float(f[q + 1, p]), float(f[q + 2, p]), float(f[q + 3, p]),
                float(f[q + 4, p]), float(f[q + 5, p]), float(f[q + 6, p]), float(f[q + 7, p]),
                float(f[q + 8, p]),
            )  # fmt: skip
            h = update_deformation_gradient(h, L, dt)
            for c in range(9):
                f[q + c, p] = h[c]
