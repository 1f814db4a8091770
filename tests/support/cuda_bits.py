"""A card's engine, on a card or in the simulator, beside the processor's, bit by bit: a program of
its own, since numba must know from the start whether it simulates.

    python -m tests.support.cuda_bits single 2 fluid contact      precision, steps, scenes of
    test_engines
    python -m tests.support.cuda_bits single 2 fluid --break NAME --order 3
    python -m tests.support.cuda_bits single 20 fluid contact --card      on a card, not simulated

Prints a line per scene, `same` or `OTHER` and what differs; the processor does not contract
products and sums, and scenes have cells twice as wide as in test_engines. --order: of the threads
of a block; --break: something of the card's engine is broken first (BREAKS), to see that it is
found.
"""

import argparse
import os
import sys
import tempfile
import warnings
from pathlib import Path

os.environ["VGMPI_CONTRACTION"] = "off"
ON_CARD = "--card" in sys.argv
if not ON_CARD:
    import tests.support.cuda_simulator as cudasim

import numpy as np  # noqa: E402
from numba import cuda  # noqa: E402

from tests.solver import test_engines as engines  # noqa: E402
from tests.support.engine_pair import of_scene, worst  # noqa: E402
from vgmpi.kernels.simd import cooperative as lanes_team  # noqa: E402
from vgmpi.solver.engines.cuda import (  # noqa: E402
    device_group,
    device_sort,
    grid_kernels,
    scatter_kernels,
    thread_block,
)
from vgmpi.solver.engines.cuda.cuda_engine import Cuda  # noqa: E402
from vgmpi.solver.engines.cuda.grid_kernels import from_lane  # noqa: E402

SORT_AT = 1


def simulations(name: str, precision: str, which: tuple[str, ...]):
    """Simulations of the same particles, one per engine."""
    text, walls, accuracy = engines.SCENES[name]
    head = engines.HEAD.replace("BOUNDARY", engines.WALLS[walls]).replace("ACCURACY", accuracy)
    head = head.replace('"double"', f'"{precision}"').replace("cell = 0.02", "cell = 0.04")
    # what cells so wide have no room for
    text = text.replace("[0.15, 0.13, 0.12], radius = 0.012", "[0.13, 0.125, 0.09], radius = 0.028")
    text = text.replace("0.175, 0.16", "0.155, 0.16").replace("0.0325, 0.16", "0.028, 0.16")
    with tempfile.TemporaryDirectory() as folder:
        return of_scene(Path(folder), head + text, which)


def differences(one, other) -> list[str]:
    """What is not the same in two simulations, bit by bit."""
    found = [
        name for name in ("rate", "particle_maxima") if getattr(one, name) != getattr(other, name)
    ]
    if (
        "reactions" in one.features
        and one.features["reactions"].totals.tobytes()
        != other.features["reactions"].totals.tobytes()
    ):
        found.append("what rigid things gave")
    for a, b in zip(one.groups, other.groups, strict=True):
        at = a.index()
        if not (np.array_equal(at, b.index()) and np.array_equal(a.ids[at], b.ids[at])):
            return [f"{a.plan.name}: order"]
        if not np.array_equal(a.xi[:, at], b.xi[:, at]):
            found.append(f"{a.plan.name}: x")
        for channel in a.plan.channels:
            mine, theirs = a.get(channel.name, at), b.get(channel.name, at)
            if mine.tobytes() != theirs.tobytes():
                gap = np.abs(mine - theirs).max() / max(np.abs(mine).max(), 1e-300)
                found.append(f"{a.plan.name}: {channel.name} {gap:.0e}")
    return found


def compared(name: str, precision: str, steps: int) -> str:
    """A line about one scene."""
    which = ("cpu", "cuda", "numpy") if precision == "double" else ("cpu", "cuda")
    every = simulations(name, precision, which)
    for step in range(steps):
        dt = 0.5 * every[0].bound()
        for one in every:
            if step == SORT_AT:
                one.sort()
            one.advance(dt)
        found = differences(*every[:2])
        if found:
            return f"OTHER {name}, step {step}: {'; '.join(found)}"
    count = sum(len(g) for g in every[0].groups)
    far = f", {max(worst(*every[1:]).values()):.0e} from numpy" if len(every) > 2 else ""
    return f"same {name}, {steps} steps, {count} particles{far}"


# ---- broken on purpose --------------------------------------------------------------------------


def _own_node(here):
    return thread_block.rank() >> 2


def _never():
    pass


def _no_order(count, end, targets, ids, source):
    pass


def _reversed(self, part, first=0):
    found = USUAL(self, part)
    rows = {
        key: device_group.to_card(rows.copy_to_host()[::-1][first:])
        for key, rows in found.contributions.items()
    }
    return found._replace(contributions=rows)


def _shuffled(self, part):
    return _reversed(self, part, 1)


def _from_its_neighbour(row, push, least):
    mass = from_lane(row, cuda.threadIdx.x & 15)
    moved = row / mass + push
    return moved if (cuda.threadIdx.x & 3) < 3 else row


BREAKS = {
    "ownership": lambda: setattr(scatter_kernels, "_node", _own_node),  # two threads, one number
    "meeting": lambda: setattr(
        scatter_kernels, "meet", _never
    ),  # records are read before they are made
    "meeting at nodes": lambda: grid_kernels.NODES.stands_in.update(
        {lanes_team.sync_threads: _never}
    ),
    "order": lambda: setattr(device_sort, "order", _no_order),  # of a cell's particles
    "list": lambda: setattr(Cuda, "_laid_out", _shuffled),  # a segment is left out
    "lane": lambda: grid_kernels.NODES.stands_in.update(
        {grid_kernels.row_ops.velocity: _from_its_neighbour}
    ),
    # and what must not matter: sums take segments in any order
    "reversed": lambda: setattr(Cuda, "_laid_out", _reversed),
}


USUAL = Cuda._laid_out


def main(argv: list[str]) -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("precision", choices=("single", "double"))
    parser.add_argument("steps", type=int)
    parser.add_argument("scenes", nargs="+")
    parser.add_argument("--order", type=int)
    parser.add_argument("--card", action="store_true", help="on a card, not in the simulator")
    parser.add_argument("--halves", action="store_true", help="two half warps a block, as a card")
    parser.add_argument("--break", dest="broken", choices=BREAKS)
    given = parser.parse_args(argv)
    warnings.filterwarnings("ignore", category=RuntimeWarning)
    if not ON_CARD:
        cudasim.SEED[0] = given.order
    if given.halves:
        cudasim.TEAM[0], thread_block.HALVES[0] = 16, 2
    if given.broken:
        BREAKS[given.broken]()
    for name in given.scenes:
        print(compared(name, given.precision, given.steps), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
