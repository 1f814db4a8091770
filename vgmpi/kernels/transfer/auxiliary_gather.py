"""Particle quantities gathered besides the velocity, by kind.

The kinds are: nothing; the volume flux and the drift where phases share space; the change of
velocity for FLIP; or all of these. Further kinds are those of liquid_volume.py, which combine with
any of the others, and of features (features/implicit_pressure/pressure_transfer.py).

Each kind implements one interface: it loads patches of nodes for a segment (`load_patches`),
gathers from them for a batch of particles (`gather_batch`), and says how the result enters the
particle: its velocity (`particle_velocity`), the velocity that advects it (`advection_velocity`),
its velocity gradient (`velocity_gradient`) and its wave speed (`mixture_wave_speed_squared`). The
first argument is the kind; the others have the same meaning in all.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.kernels.grid.mixture_coupling import MIN_POROSITY
from vgmpi.kernels.particle_records import BATCH, load_patch, patch_of, scatter_columns
from vgmpi.kernels.reaction_impulses import velocity_mirror_fraction
from vgmpi.kernels.simd.row_ops import broadcast, max_ignore_nan
from vgmpi.kernels.simd.static_dispatch import static_dispatch
from vgmpi.kernels.simd.vector16 import load, store
from vgmpi.kernels.stencil_sums import gather_affine, gather_value
from vgmpi.kernels.wall_boundary import fill_ghost_velocity
from vgmpi.runtime.jit import device_function

CHANGE = 5 * BATCH  # offset of the velocity change in `extra`
OVERFILL_RELAXATION_RATE = 10.0  # [1/s] relaxation rate of a fluid in pores that are overfilled


class VelocityOnly(NamedTuple):
    """Kind that gathers the velocity alone."""

    unused: float


class MixtureGather(NamedTuple):
    """Kind of phases that share space."""

    flux: np.ndarray  # (node blocks, 256) volume flux [m/s], and the fluids' volume fraction
    drift: np.ndarray  # (node blocks, 256) [m/s] drift, which advects but carries no momentum
    drifts: int  # 1 if any phase drifts


class FlipGather(NamedTuple):
    """Kind of FLIP and AFLIP."""

    change: np.ndarray  # (node blocks, 256) [m/s] change of velocity
    share: float  # [-] FLIP ratio: part of the unresolved velocity that particles retain
    patch: int  # number of its patch among the auxiliary ones


@static_dispatch
def load_patches(kind, blocks, box, mirror, real, ghosts, s):
    """Load the patches of a segment into the scratch memory of its thread.

    Called for segments that share space, and for all segments with FLIP.

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
def mixture_wave_speed_squared(kind, f, p, cap, numbers, wave2):
    """Return the squared wave speed of 16 particles [m2/s2].

    Args:
        f, p, cap: Particle channels, flat; first of the 16 particles; stride of channels.
        numbers: Constants of the group.
        wave2: Squared wave speed by the law [m2/s2].
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
def _store_velocity(f, p, cap, v):
    """Store the gathered velocity of 16 particles."""
    store(f, p, v[0])
    store(f, p + cap, v[1])
    store(f, p + 2 * cap, v[2])


@device_function
def _max_component(f, p, cap, scale):
    """Return the largest component of 16 stored velocities, times `scale`."""
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
    _store_velocity(f, p, cap, v)


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
@displacement.register(MixtureGather)
@displacement.register(FlipGather)
def _(kind, extra, n, moves):
    return moves


@mixture_wave_speed_squared.register(VelocityOnly)
def _(kind, f, p, cap, numbers, wave2):
    return wave2


# ---- phases that share space --------------------------------------------------------------------


@load_patches.register(MixtureGather)
def _(kind, blocks, box, mirror, real, ghosts, s):
    load_mirrored_patch(kind.flux, blocks, box, mirror, patch_of(real, 0), None, s)
    if kind.drifts:
        load_mirrored_patch(kind.drift, blocks, box, mirror, patch_of(real, 1), None, s)


@gather_batch.register(MixtureGather)
def _(kind, count, weights, records, base, real, extra):
    """Gather the flux divergence [cells/s], the fluids' volume fraction and the drift [m/s]."""
    gather_affine(count, records, weights, base, patch_of(real, 0))
    for n in range(count):
        m = 16 * n
        extra[n] = 4.0 * (records[m + 4] + records[m + 9] + records[m + 14])
        extra[BATCH + n] = records[m + 3]
    if kind.drifts:
        gather_value(count, records, weights, base, patch_of(real, 1))
        scatter_columns(count, records, extra, 2 * BATCH, BATCH)


@particle_velocity.register(MixtureGather)
def _(kind, f, p, cap, extra, n, v):
    _store_velocity(f, p, cap, v)


@max_velocity.register(MixtureGather)
def _(kind, f, p, cap, displacement, scale):
    return _max_component(f, p, cap, scale) if kind.drifts else displacement


@advection_velocity.register(MixtureGather)
def _(kind, split, extra, n, v):
    x, y, z = v
    if split and kind.drifts:
        x = x + load(extra, 2 * BATCH + n)
        y = y + load(extra, 3 * BATCH + n)
        z = z + load(extra, 4 * BATCH + n)
    return x, y, z


@velocity_gradient.register(MixtureGather)
def _(kind, split, f, p, cap, extra, n, L, fill, slope, numbers):
    """Add the volume change of the mixture to the velocity gradient.

    A fluid's volume changes by the flux of all phases that share its space. In the presence of sand
    the volume fraction of the pores is stored at the particle; where more volume than space was
    gathered (fill > 1), the volume ratio relaxes.
    """
    porosity = np.int64(numbers.porosity)
    c0, c1, c2, c3, c4, c5, c6, c7, c8 = L
    added = 0.0 * c0
    if split:
        rate = load(extra, n) / numbers.dx
        if porosity >= 0:
            pore_fraction = np.minimum(np.maximum(load(extra, BATCH + n), MIN_POROSITY), 1.0)
            store(f, p + porosity * cap, pore_fraction)
            rate = rate / pore_fraction - numbers.relax * np.maximum(fill - 1.0, 0.0)
        added = (rate - (c0 + c4 + c8)) * (1.0 / 3.0)
    elif porosity >= 0:
        store(f, p + porosity * cap, broadcast(f, 1.0))
    return (c0 + added, c1, c2, c3, c4 + added, c5, c6, c7, c8 + added)


@mixture_wave_speed_squared.register(MixtureGather)
def _(kind, f, p, cap, numbers, wave2):
    porosity = np.int64(numbers.porosity)
    wave2 = wave2 * numbers.slips
    if porosity >= 0:
        pore_fraction = load(f, p + porosity * cap)
        wave2 = wave2 * (1.0 + (1.0 / pore_fraction - 1.0) * numbers.dense) + numbers.stiff
    return wave2


# ---- FLIP ---------------------------------------------------------------------------------------


@load_patches.register(FlipGather)
def _(kind, blocks, box, mirror, real, ghosts, s):
    load_mirrored_patch(kind.change, blocks, box, mirror, patch_of(real, kind.patch), ghosts, s)


@gather_batch.register(FlipGather)
def _(kind, count, weights, records, base, real, extra):
    """Gather the change of velocity [m/s], behind all other quantities."""
    gather_value(count, records, weights, base, patch_of(real, kind.patch))
    scatter_columns(count, records, extra, CHANGE, BATCH)


@particle_velocity.register(FlipGather)
def _(kind, f, p, cap, extra, n, v):
    """Blend the particle's velocity plus the grid's change with the grid velocity.

    References:
        Zhu and Bridson 2005 (FLIP); Fei 2021 (AFLIP, with the velocity gradient).
    """
    a, b, c = v
    a = a + kind.share * (load(f, p) + load(extra, CHANGE + n) - a)
    b = b + kind.share * (load(f, p + cap) + load(extra, CHANGE + BATCH + n) - b)
    c = c + kind.share * (load(f, p + 2 * cap) + load(extra, CHANGE + 2 * BATCH + n) - c)
    _store_velocity(f, p, cap, (a, b, c))


@max_velocity.register(FlipGather)
def _(kind, f, p, cap, displacement, scale):
    return _max_component(f, p, cap, scale)


@advection_velocity.register(FlipGather)
def _(kind, split, extra, n, v):
    return v


@velocity_gradient.register(FlipGather)
def _(kind, split, f, p, cap, extra, n, L, fill, slope, numbers):
    return L


@mixture_wave_speed_squared.register(FlipGather)
def _(kind, f, p, cap, numbers, wave2):
    return wave2


class MixtureFlipGather(NamedTuple):
    """Kind of phases that share space and use FLIP or AFLIP."""

    sharing: MixtureGather
    blend: FlipGather


@load_patches.register(MixtureFlipGather)
def _(kind, blocks, box, mirror, real, ghosts, s):
    load_patches(kind.sharing, blocks, box, mirror, real, ghosts, s)
    load_patches(kind.blend, blocks, box, mirror, real, ghosts, s)


@gather_batch.register(MixtureFlipGather)
def _(kind, count, weights, records, base, real, extra):
    gather_batch(kind.sharing, count, weights, records, base, real, extra)
    gather_batch(kind.blend, count, weights, records, base, real, extra)


@particle_velocity.register(MixtureFlipGather)
def _(kind, f, p, cap, extra, n, v):
    particle_velocity(kind.blend, f, p, cap, extra, n, v)


@max_velocity.register(MixtureFlipGather)
def _(kind, f, p, cap, displacement, scale):
    return max_velocity(kind.blend, f, p, cap, displacement, scale)


@advection_velocity.register(MixtureFlipGather)
def _(kind, split, extra, n, v):
    return advection_velocity(kind.sharing, split, extra, n, v)


displacement.register(MixtureFlipGather)(displacement.table[MixtureGather])


@velocity_gradient.register(MixtureFlipGather)
def _(kind, split, f, p, cap, extra, n, L, fill, slope, numbers):
    return velocity_gradient(kind.sharing, split, f, p, cap, extra, n, L, fill, slope, numbers)


@mixture_wave_speed_squared.register(MixtureFlipGather)
def _(kind, f, p, cap, numbers, wave2):
    return mixture_wave_speed_squared(kind.sharing, f, p, cap, numbers, wave2)
