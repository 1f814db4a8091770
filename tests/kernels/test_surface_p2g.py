"""Fields next to free bodies from the particles that reach the nodes next to them alone."""

import numpy as np
import pytest

from tests.support.feature_scenes import FREE_BODIES
from tests.support.simulate import begin
from vgmpi.kernels.kernel_arguments import Particles, Segments
from vgmpi.kernels.particle_records import scratch
from vgmpi.kernels.transfer import surface_p2g
from vgmpi.solver.engines import plan_tables, surface_fields

OIL = """
[material.oil]
kind = "fluid"
density = 800
tait_coefficient = "20 kPa"
[[object]]
name = "oil"
material = "oil"
shape = { box = [[0, 0, "8 cm"], ["20 cm", "16 cm", "9 cm"]] }
"""


def state(folder, text, steps):
    """(state as bytes, particles that contribute, all particles of their segments) of a run."""
    folder.mkdir()
    simulation, _ = begin(folder, text)
    for _ in range(steps):
        simulation.advance(simulation.bound())
    bits, count = b"", [0, 0]
    for group, part in zip(simulation.engine.groups, simulation.engine.parts, strict=True):
        for a, n in zip(group.start, group.count, strict=True):
            bits += group.xi[:, a : a + n].tobytes() + group.f[:, a : a + n].tobytes()
        if part.surface is not None:
            first, end = part.surface.stencils.interval.T
            used = np.repeat(
                part.surface.stencils.target != 0, np.diff(part.surface.stencils.batch)
            )
            count[0] += np.maximum(end - first, 0)[used].sum()
            count[1] += group.count[part.surface.chosen].sum()
    bodies = simulation.features["rigid_bodies"].bodies
    return bits + b"".join(v.tobytes() for v in (bodies.x, bodies.q, bodies.momentum)), *count


@pytest.mark.parametrize("case", ["single", "double", "two phases"])
def test_it_changes_no_bits(tmp_path, monkeypatch, case):
    text = FREE_BODIES.replace("single", case) if case == "double" else FREE_BODIES
    text = text + OIL if case == "two phases" else text
    found, used, near = state(tmp_path / "a", text, 60)
    assert 0 < used < 0.6 * near
    for module in (surface_fields, plan_tables):
        monkeypatch.setattr(module, "is_summed_at_surfaces", lambda plan: False)
    every, *none = state(tmp_path / "b", text, 60)
    assert none == [0, 0]
    assert found == every


def test_flags_spread_to_the_base_nodes_that_reach_them():
    """Against a search of all 27 nodes of each base node."""
    random = np.random.default_rng(0)
    around = np.where(random.random(27) < 0.8, np.arange(27), -1)
    flags = np.zeros(27, np.uint64)
    for _ in range(12):
        flags[random.integers(27)] |= np.uint64(1) << np.uint64(random.integers(64))
    is_flagged = np.zeros((12, 12, 12), bool)  # nodes of 3^3 blocks; the patch begins at node 3
    for block in range(27):
        bits = (flags[block] >> np.arange(64, dtype=np.uint64)) & np.uint64(1)
        i, j, k = 4 * (block // 9), 4 * (block // 3 % 3), 4 * (block % 3)
        is_flagged[i : i + 4, j : j + 4, k : k + 4] = bits.reshape(4, 4, 4).astype(bool) & (
            around[block] >= 0
        )
    stencil = np.zeros(8, np.uint64)
    target = surface_p2g._spread_flags(around, flags, stencil)
    for i, j, k in np.ndindex(6, 6, 6):
        bit = bool((stencil[i] >> np.uint64(8 * j + k)) & np.uint64(1))
        assert bit == is_flagged[i + 3 : i + 6, j + 3 : j + 6, k + 3 : k + 6].any()
    assert target == sum(1 << b for b in range(27) if around[b] >= 0 and flags[b])


def test_memory_behind_a_full_group_is_not_read():
    """Particles that fill their arrays: the last one alone is next to a surface, and the memory
    behind the positions would make the node range leave its patch."""
    count, bits = 16, 29
    memory = np.full(3 * count + 64, 2**31 - 1, np.int32)
    xi = memory[: 3 * count].reshape(3, count)
    xi[:] = -2 << bits  # base node 1 of the patch
    xi[:, -1] = 3 << (bits - 1)  # base node 4, whose nodes 4 to 6 reach the block behind
    f, ids = np.zeros((14, count), np.float32), np.arange(count)
    rows = np.zeros((1, 27), np.int64)
    mirror, limit = np.zeros((1, 3, 2), np.int32), np.zeros((1, 3, 2))
    segments = Segments(
        np.zeros(1, np.int64), np.array([count]), rows, rows, np.zeros(1, bool), limit, mirror
    )
    neighbors = np.full((1, 27), -1)
    neighbors[0, 26] = 0
    stencils = surface_p2g.SurfaceStencils(
        np.zeros(1, np.int64), neighbors, np.array([0, 1]), np.zeros((1, 2), np.int64),
        np.zeros((1, 6), np.int64), np.zeros(1, np.int64),
    )  # fmt: skip
    surface_p2g.find_contributing_particles(
        np.zeros(1, np.int64), segments, Particles(xi, f, ids), np.ones(1, np.uint64), stencils,
        scratch(np.dtype(np.float32), 0),
    )  # fmt: skip
    assert stencils.interval.tolist() == [[count - 1, count]]
    assert stencils.box.min() >= 0 and stencils.box.max() == 7
