"""Particle quantities gathered besides the velocity, by kind.

The kinds are nothing, those of liquid_volume.py, and those of features, which combine by `Both`
(features/implicit_pressure/pressure_transfer.py is one).

Each kind implements one interface: it loads patches of nodes for a segment (`load_patches`),
gathers from them for a batch of particles (`gather_batch`), and says how the result enters the
particle: its velocity (`particle_velocity`), the velocity that advects it (`advection_velocity`),
its velocity gradient (`velocity_gradient`) and its wave speed (`wave_speed_squared`). The
first argument is the kind; the others have the same meaning in all.
"""

from typing import NamedTuple

from vgmpi.kernels.particle_records import BATCH, load_patch
from vgmpi.kernels.reaction_impulses import velocity_mirror_fraction
from vgmpi.kernels.simd.row_ops import max_ignore_nan
from vgmpi.kernels.simd.static_dispatch import Both, static_dispatch
from vgmpi.kernels.simd.vector16 import load, store
from vgmpi.kernels.wall_boundary import fill_ghost_velocity
from vgmpi.runtime.jit import device_function

CHANGE = 5 * BATCH  # offset of the velocity change in `extra`


class VelocityOnly(NamedTuple):
    """Kind that gathers the velocity alone."""

    unused: float


@static_dispatch
def load_patches(kind, blocks, box, mirror, real, ghosts, s):
    """Load the patches of a segment into the scratch memory of its thread.

    Args:
        blocks: The 27 node blocks around the segment.
        box: First and last nodes along x, y, z, shape (6,).
        mirror: Wall codes of the segment, shape (3, 2), see kernels/wall_boundary.py.
        real: Scratch numbers of the thread (out), see `patch_of`.
        ghosts: Ghost-node bookkeeping for reaction forces, or None.
        s: Row of the segment.
    """


@static_dispatch
def gather_batch(kind, count, weights, records, base, real, extra):
    """Gather the auxiliary quantities of a batch of particles.

    Args:
        count: Number of particles.
        weights: Records of weights.
        records: Scratch for one batch of records (out).
        base: Base rows of the particles, shape (count,).
        real: Scratch numbers of the thread, which hold the patches.
        extra: Gathered quantities (out), shape (8 BATCH,).
    """


@static_dispatch
def particle_velocity(kind, f, p, cap, extra, n, v):
    """Store the velocity of 16 particles.

    Args:
        f, p, cap: Particle channels, flat (in/out); first of the 16 particles; stride of channels.
        extra, n: Gathered quantities (`gather_batch`); number of the first particle in its batch.
        v: Velocity as gathered, three components [m/s].
    """


@static_dispatch
def max_velocity(kind, f, p, cap, displacement, scale):
    """Return the largest component of the stored velocity [cells per step].

    Args:
        f, p, cap: Particle channels, flat; first of the 16 particles; stride of channels.
        displacement: Largest component of the displacement in the step [cells].
        scale: Conversion factor [cells per step per m/s].
    """


@static_dispatch
def advection_velocity(kind, split, extra, n, v):
    """Return the velocity that advects 16 particles, three components [m/s].

    Args:
        split: Whether the stress impulses of the segment are kept separate from momentum.
        extra, n: Gathered quantities (`gather_batch`); number of the first particle in its batch.
        v: Velocity as gathered, three components [m/s].
    """


@static_dispatch
def displacement(kind, extra, n, moves):
    """Return the displacement of 16 particles in the step, three components [cells].

    Args:
        extra, n: Gathered quantities (`gather_batch`); number of the first particle in its batch.
        moves: Displacement by the advection velocity, three components [cells].
    """


@static_dispatch
def velocity_gradient(kind, split, f, p, cap, extra, n, L, fill, slope, numbers):
    """Return the velocity gradient that the constitutive law receives, nine components.

    A kind may also set state variables that the law does not: with an implicit pressure the volume
    ratio is that of the pressure at the nodes.

    Args:
        split: Whether the stress impulses of the segment are kept separate from momentum.
        f, p, cap: Particle channels, flat (in/out); first of the 16 particles; stride of channels.
        extra, n: Gathered quantities (`gather_batch`); number of the first particle in its batch.
        L: Velocity gradient as gathered, nine components [1/s].
        fill, slope: Fourth nodal number as gathered, and a quarter of its slope per cell.
        numbers: Constants of the group.
    """


@static_dispatch
def wave_speed_squared(kind, f, p, cap, wave2):
    """Return the squared wave speed of 16 particles [m2/s2].

    Args:
        f, p, cap: Particle channels, flat; first of the 16 particles; stride of channels.
        wave2: Squared wave speed by the law [m2/s2].
    """


@static_dispatch
def bounded_volume_rate(kind, trace):
    """Return the rate at which the volumes of 16 particles change, as it bounds the step [1/s].

    Args:
        trace: Trace of the velocity gradient [1/s].
    """


@device_function
def load_mirrored_patch(grid, blocks, box, mirror, patch, ghosts, s):
    """Load one patch and set its ghost nodes from their mirror nodes.

    Args:
        grid: Nodal numbers, shape (node blocks, 256).
        blocks, box, mirror, ghosts, s: See `load_patches`.
        patch: Patch (out).
    """
    load_patch(patch, grid, blocks, box)
    mirror_fraction = velocity_mirror_fraction(ghosts)
    fill_ghost_velocity(patch, mirror, ghosts, mirror_fraction, s)


@device_function
def store_velocity(f, p, cap, v):
    """Store the velocity of 16 particles.

    Args:
        f, p, cap, v: See `particle_velocity`.
    """
    store(f, p, v[0])
    store(f, p + cap, v[1])
    store(f, p + 2 * cap, v[2])


@device_function
def max_velocity_component(f, p, cap, scale):
    """Return the largest component of 16 stored velocities, times `scale`.

    Args:
        f, p, cap, scale: See `max_velocity`.
    """
    x, y, z = load(f, p), load(f, p + cap), load(f, p + 2 * cap)
    return scale * max_ignore_nan(abs(x), max_ignore_nan(abs(y), abs(z)))


# ---- nothing ------------------------------------------------------------------------------------


@load_patches.register(VelocityOnly)
def _(kind, blocks, box, mirror, real, ghosts, s):
    pass


@gather_batch.register(VelocityOnly)
def _(kind, count, weights, records, base, real, extra):
    pass


@particle_velocity.register(VelocityOnly)
def _(kind, f, p, cap, extra, n, v):
    store_velocity(f, p, cap, v)


@max_velocity.register(VelocityOnly)
def _(kind, f, p, cap, displacement, scale):
    return displacement


@advection_velocity.register(VelocityOnly)
def _(kind, split, extra, n, v):
    return v


@velocity_gradient.register(VelocityOnly)
def _(kind, split, f, p, cap, extra, n, L, fill, slope, numbers):
    return L


@displacement.register(VelocityOnly)
def _(kind, extra, n, moves):
    return moves


@wave_speed_squared.register(VelocityOnly)
def _(kind, f, p, cap, wave2):
    return wave2


@bounded_volume_rate.register(VelocityOnly)
def _(kind, trace):
    return trace


class WavesOnGrid(NamedTuple):
    """Kind of solids whose waves a feature slows: only motion bounds the steps of particles."""

    wave_speed_squared: float  # [m2/s2] 0


for _dispatch in (
    load_patches, gather_batch, particle_velocity, max_velocity, advection_velocity,
    velocity_gradient, displacement, bounded_volume_rate,
):  # fmt: skip
    _dispatch.register(WavesOnGrid)(_dispatch.table[VelocityOnly])


@wave_speed_squared.register(WavesOnGrid)
def _(kind, f, p, cap, wave2):
    return kind.wave_speed_squared + 0.0 * wave2


# ---- two kinds ----------------------------------------------------------------------------------


@load_patches.register(Both)
def _(kind, blocks, box, mirror, real, ghosts, s):
    load_patches(kind.first, blocks, box, mirror, real, ghosts, s)
    load_patches(kind.second, blocks, box, mirror, real, ghosts, s)


@gather_batch.register(Both)
def _(kind, count, weights, records, base, real, extra):
    gather_batch(kind.first, count, weights, records, base, real, extra)
    gather_batch(kind.second, count, weights, records, base, real, extra)


@particle_velocity.register(Both)
def _(kind, f, p, cap, extra, n, v):
    """Store the velocity as the second kind does: at most one feature blends velocities."""
    particle_velocity(kind.second, f, p, cap, extra, n, v)


@max_velocity.register(Both)
def _(kind, f, p, cap, displacement, scale):
    return max_velocity(kind.second, f, p, cap, displacement, scale)


@advection_velocity.register(Both)
def _(kind, split, extra, n, v):
    v = advection_velocity(kind.first, split, extra, n, v)
    return advection_velocity(kind.second, split, extra, n, v)


@displacement.register(Both)
def _(kind, extra, n, moves):
    return displacement(kind.second, extra, n, displacement(kind.first, extra, n, moves))


@velocity_gradient.register(Both)
def _(kind, split, f, p, cap, extra, n, L, fill, slope, numbers):
    L = velocity_gradient(kind.first, split, f, p, cap, extra, n, L, fill, slope, numbers)
    return velocity_gradient(kind.second, split, f, p, cap, extra, n, L, fill, slope, numbers)


@wave_speed_squared.register(Both)
def _(kind, f, p, cap, wave2):
    return wave_speed_squared(
        kind.second, f, p, cap, wave_speed_squared(kind.first, f, p, cap, wave2)
    )


@bounded_volume_rate.register(Both)
def _(kind, trace):
    return bounded_volume_rate(kind.second, bounded_volume_rate(kind.first, trace))
