"""A run keeps nothing of its steps: what it allocates, it frees."""

import gc
import tracemalloc

import numpy as np
import pytest

import vgmpi
import vgmpi.solver.simulation
from tests.support.small_scenes import write

MEASURED = 600, 1200, 1800, 2400, 3000  # steps
BOUND = 16  # [bytes] per step
SCENE = """
[accuracy]
pressure = "explicit"
[domain]
size = ["12 cm", "8 cm", "8 cm"]
cell = "2 cm"
[time]
end = "100 s"
frames = 2
[output]
checkpoint_interval = 0
[material.water]
kind = "fluid"
density = 1000
[material.rubber]
kind = "elastic"
density = 1000
youngs_modulus = "20 kPa"
[[object]]
name = "pool"
material = "water"
shape = {{ box = [[0, 0, 0], ["12 cm", "8 cm", "2 cm"]] }}
[[object]]
name = "ball"
material = "rubber"
shape = {{ sphere = {{ center = ["3 cm", "4 cm", "4 cm"], radius = "1.5 cm" }} }}
{more}
"""
PROBES = """
[[probe]]
name = "ball"
object = "ball"
sampling_rate = 100_000
[[probe]]
name = "middle"
pressure = ["6 cm", "4 cm", "1 cm"]
sampling_rate = 100_000
"""

RIGID = """
[[object]]
name = "block"
material = "rubber"
rigid = true
shape = { box = [["7 cm", "3 cm", "4 cm"], ["9 cm", "5 cm", "6 cm"]] }
"""


class Enough(Exception):
    """The steps have been made."""


@pytest.mark.parametrize("more", ["", PROBES, RIGID], ids=["plain", "probes", "rigid"])
def test_memory_does_not_grow_with_steps(tmp_path, monkeypatch, more):
    """Rows of probes are in their tables, so that a run of millions of steps does not hold them.

    What is lost is lost in every interval; tables of blocks become larger in one and smaller in
    another.
    """
    sizes = []
    original = vgmpi.solver.simulation.Simulation.advance

    def advance(self, *arguments):
        if self.step in MEASURED:
            gc.collect()
            sizes.append(tracemalloc.get_traced_memory()[0])
        if len(sizes) == len(MEASURED):
            raise Enough
        return original(self, *arguments)

    monkeypatch.setattr(vgmpi.solver.simulation.Simulation, "advance", advance)
    scene = vgmpi.load(write(tmp_path, SCENE.format(more=more)))
    tracemalloc.start()
    try:
        with pytest.raises(Enough):
            vgmpi.run(scene, tmp_path / "out")
    finally:
        tracemalloc.stop()
    growth = np.diff(sizes) / np.diff(MEASURED)
    print(growth)
    assert growth.min() < BOUND
