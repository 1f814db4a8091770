"""Colours through the grid with every step, as the paper has it: PIC's transfer of three numbers.

    c_i = sum_p w_ip V_p c_p / sum_p w_ip V_p,     c_p <- sum_i w_ip c_i

V_p is the volume as it is now. Nodes sum over their patches as they do for momentum (p2g.py,
grid.py), with the same halo, so that the bits depend on neither ranks nor threads. Walls mirror no
colour: nodes beyond them are nodes like others, as in splatting/colour.py, which this equals.
"""

import numpy as np

from ..device.jit import inline, kernel
from ..device.memory import aligned, grown
from ..device.select import select
from ..domain.topology import Topology
from ..lanes.lanes import load, place, store
from ..lanes.nodes import fourth_of
from ..lanes.rows import load_records, spread, store_records
from .g2p import rest, values
from .patches import clear, gather, pull, push
from .records import BATCH, PATCH, parts, present, reach, weigh
from .rowsums import scatter


class Layer:
    """Patches and nodes of one coefficient of colour: red, green, blue times volume, and volume.

    slot: (patches,) where each patch is kept; patches: (slots, 2048); grid: (node blocks, 256).
    """

    def __init__(self, real: np.dtype):
        self.slot = np.zeros(0, np.int64)
        self.patches, self.grid = aligned((0, PATCH), real), aligned((0, 256), real)

    def adopt(self, topology: Topology, kept: np.ndarray) -> None:
        """Make room for the patches that are kept: (patches,) bool."""
        self.slot = np.where(kept, np.cumsum(kept) - 1, -1)
        self.patches = grown(self.patches, int(kept.sum()))
        self.grid = grown(self.grid, len(topology.phase))
        # boxes of ghost patches that do not arrive stay zero
        self.patches[self.slot[kept & ~topology.own]] = 0


@kernel
def collect(
    law, segments, border, sent, start, count, slots, into, xi, f, channel, patches, grid, scratch,
    base,
):  # fmt: skip
    """Volume times colour and volume of each segment into its patch, and that to the grid.

    channel: of f where the three numbers begin; grid: (node blocks, 256); the others as of p2g.p2g.
    """
    cap = f.shape[1]
    flat, flat_xi = f.reshape(f.size), xi.reshape(xi.size)
    weights, records, patch, volumes = parts(scratch)
    box = base[BATCH + 16 :]
    for s in segments:
        kept = slots[s]
        reach(count[s], start[s], cap, flat_xi, flat, box)
        if sent[s] and not border:
            push(patches[kept], grid, into[s], box)
            continue
        if kept >= 0:
            patch[:] = 0
        else:
            clear(patch, box)
        for first in range(0, count[s], BATCH):
            n = min(BATCH, count[s] - first)
            at = start[s] + first
            weigh(n, at, cap, flat_xi, flat, base, weights)
            present(law, n, at, cap, flat, volumes)
            _shades(n, flat, at + channel * cap, cap, volumes, records)
            scatter(n, records, weights, base, patch)
        if kept >= 0:
            for c in range(PATCH):
                patches[kept, c] = patch[c]
        if not border:
            push(patch, grid, into[s], box)


@inline
def _shades(count, f, at, cap, volumes, records):
    """Records of volume times colour 0-2 and volume 3."""
    zero = spread(f, 0.0)
    for n in range(0, count, 16):
        p, volume = at + n, load(volumes, n)
        red, green, blue = load(f, p), load(f, p + cap), load(f, p + 2 * cap)
        store_records(
            records,
            16 * n,
            (
                volume * red, volume * green, volume * blue, volume, zero, zero, zero, zero,
                zero, zero, zero, zero, zero, zero, zero, zero,
            ),
        )  # fmt: skip


@kernel
def blend(
    blocks, first, phase, set_of, summed, pull_first, pull_patch, pull_code, slots, patches, grid
):
    """The mean colour at the nodes of some blocks, over all phases of a set, in place of sums.

    set_of: (phases,) those of one number exchange colours, -1: none; the others as of grid.update.
    """
    patch_of, code_of, slot_of = place(pull_patch), place(pull_code), place(slots)
    sources, nodes = place(patches), place(grid)
    for b in blocks:
        for nb in range(first[b], first[b + 1]):
            if set_of[phase[nb]] >= 0 and not summed[nb]:
                q0, q1 = pull_first[nb], pull_first[nb + 1]
                pull(nodes, nb, q0, q1, patch_of, code_of, slot_of, sources)
        for nb in range(first[b], first[b + 1]):
            group = set_of[phase[nb]]
            met = False
            for other in range(first[b], nb):
                met = met or set_of[phase[other]] == group
            if group >= 0 and not met:
                for c in range(0, 256, 16):
                    total = load(nodes, 256 * nb + c)
                    for other in range(nb + 1, first[b + 1]):
                        if set_of[phase[other]] == group:
                            total = total + load(nodes, 256 * other + c)
                    volume = fourth_of(total)
                    mean = select(volume > 0.0, total / volume, 0.0)
                    for other in range(nb, first[b + 1]):
                        if set_of[phase[other]] == group:
                            store(nodes, 256 * other + c, mean)


@kernel
def take(segments, start, count, table, xi, f, channel, grid, scratch, base):
    """Colours from the grid to the particles, where they are before they move."""
    cap = f.shape[1]
    flat, flat_xi = f.reshape(f.size), xi.reshape(xi.size)
    weights, records, patch, _ = parts(scratch)
    patch[PATCH:] = 0
    box = base[BATCH + 16 :]
    for s in segments:
        reach(count[s], start[s], cap, flat_xi, flat, box)
        gather(patch, grid, table[s], box)
        for first in range(0, count[s], BATCH):
            n = min(BATCH, count[s] - first)
            at = start[s] + first
            weigh(n, at, cap, flat_xi, flat, base, weights)
            values(n, records, weights, base, patch)
            rest(n, records)
            for m in range(0, n, 16):
                red, green, blue = load_records(records, 16 * m)[:3]
                p = channel * cap + at + m
                store(flat, p, red)
                store(flat, p + cap, green)
                store(flat, p + 2 * cap, blue)
