"""What ranks exchange lies in node blocks for which both store sums: packing and adding take rows
of memory by number, and would read and write behind an array that has fewer.
"""

import pytest

from tests.solver.test_engines import SCENES, text_of
from tests.support import simulated_ranks
from tests.support.simulate import begin


def exchanged_without_memory(simulation) -> list[str]:
    """Nodal fields of which a rank sends or receives blocks that it does not store."""
    layers, wrong = simulation.engine.layers, []
    for exchange in (simulation.exchange.halo, simulation.exchange.correction_halo):
        messages = [] if exchange is None else exchange.sends + exchange.receives
        for part in (part for message in messages for part in message.parts):
            layer = layers[part.layer]
            if part.blocks.max() >= min(len(layer.sums), len(layer.phase)):
                wrong.append(part.layer)
    return wrong


def check(folder, text: str, ranks: int, steps: int, interval: int) -> int:
    """Simulate on some ranks, sort now and then, and check all exchanges; return their parts."""

    def job(rank):
        own = folder / str(rank.rank)
        own.mkdir()
        simulation, _ = begin(own, text, ranks=rank)
        parts = 0
        for step in range(steps):
            simulation.advance(simulation.bound())
            if step % interval == 0:
                simulation.sort()
                assert exchanged_without_memory(simulation) == []
                parts += sum(len(message.parts) for message in simulation.exchange.halo.sends)
        return parts

    return sum(simulated_ranks.run(ranks, job))


@pytest.mark.parametrize("name", SCENES)
def test_ranks_exchange_what_they_store(name, tmp_path):
    assert check(tmp_path, text_of(name), 3, 4, 2) > 0


POOL_AND_BALL = """
[accuracy]
pressure = "explicit"
[domain]
size = [0.64, 0.16, 0.16]
cell = 0.01

[time]
end = 1
frames = 2

[material.water]
kind = "fluid"
max_speed = 2.0

[material.oak]
kind = "elastic"
density = 600
youngs_modulus = 1e6

[[object]]
name = "pool"
material = "water"
shape = { box = [[0, 0, 0], [0.64, 0.16, 0.06]] }

[[object]]
name = "ball"
material = "oak"
rigid = true
shape = { sphere = { center = [BALL, 0.08, 0.1], radius = 0.03 } }
"""


@pytest.mark.parametrize("cells", range(54, 61))
def test_a_body_beside_the_border_of_two_ranks(tmp_path, cells):
    """A rank may have water within a block of a body, and none in its reach."""
    assert check(tmp_path, POOL_AND_BALL.replace("BALL", str(cells / 100)), 2, 1, 1) > 0
