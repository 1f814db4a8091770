"""Nodal fields: one kind of sum at the nodes, of four numbers each.

All fields pass through a step in the same way: particles contribute by a kind of their own
(`particle_contribution`), threads and ranks add to the sums in any order
(kernels/reproducible_sums.py), and the grid update converts these to numbers. The file of a field
says what a particle contributes, and by `accumulator_range` how large a sum may become: the quanta
follow from it.

The first field of every kind is `mirror`: how walls act on it.
"""

from vgmpi.kernels.simd.static_dispatch import static_dispatch

# walls ignore it; reflect it as a vector; as an offset; as momentum, and separate walls of solids
# reflect what presses on them
MIRROR_NONE, MIRROR_VECTOR, MIRROR_MOMENT, MIRROR_IMPULSE = 0.0, 1.0, 2.0, 3.0


@static_dispatch
def particle_contribution(kind, law, count, offset, cap, f, extra, peak, records, dt):
    """Compute the records (kernels/particle_records.py) of some particles.

    A record is a value at the particle 0-3 and its slope per cell along x 4-7, y 8-11, z 12-15.

    Args:
        kind: Contribution kind.
        law: Material parameters of the group.
        count: Number of particles.
        offset: Index of the first particle.
        cap: Stride of channels.
        f: Particle channels, flat, shape (channels * cap,).
        extra: Scratch, shape (5 BATCH,).
        peak: Stress maximum (in/out), see particle_records.Scratch, as a pointer.
        records: Records (out).
        dt: Time step [s].
    """


@static_dispatch
def accumulate(kind, count, records, weights, base, patch):
    """Add records to a patch, by weights or along the gradients of the B-splines.

    Args:
        kind: Contribution kind.
        count: Number of records.
        records, weights, base: See stencil_sums.scatter.
        patch: Patch (in/out), shape (2048,).
    """
