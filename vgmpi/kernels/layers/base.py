"""What a layer is: one kind of sum at the nodes, of four numbers each, that goes through a step in
the same way as all others.

Particles contribute to it by a kind of their own (`contribute`), threads and ranks add to its sums
in any order (kernels/sums.py), the grid's update settles these to numbers. A layer's file says
what a particle contributes, and by `full` how large a sum may become: the quanta follow from it.

Every kind begins with `mirror`: what walls do to it.
"""

from ...lanes.kinds import by_kind

UNSEEN, VECTOR, OFFSET = 0.0, 1.0, 2.0  # walls leave it; reflect it as momentum; as an offset


@by_kind
def contribute(kind, law, count, at, cap, f, extra, peak, records, dt):
    """Records (records.py) of `count` particles from `at`: a value at the particle 0-3, its slope
    per cell along x 4-7, y 8-11, z 12-15.

    law: the group's; cap: numbers per channel; f: (channels * cap,); extra: (5 BATCH,)
    scratch; peak: see records.Scratch, by its place; dt [s].
    """


@by_kind
def add(kind, count, records, weights, base, patch):
    """Add records to a patch: rowsums.scatter, or along the slopes of the B-splines."""
