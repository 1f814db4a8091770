"""Scaling on paper stands on the solver's own tables; a study of balance on its own rule."""

import numpy as np
import pytest

from tests.benchmarks import __main__ as bench
from tests.benchmarks import balance_study, scaling_model, sort_scaling
from tests.support import simulated_ranks
from tests.support.simulate import begin
from vgmpi.parallel.load_balance import BLOCK_COST, owners, partition, predicted_work

CUBE = """
[domain]
size = [0.8, 0.8, 0.8]
cell = 0.02
[time]
end = 1
[accuracy]
precision = "single"
pressure = "explicit"
[material.water]
kind = "fluid"
tait_coefficient = 1e5
[[object]]
name = "cube"
material = "water"
shape = { box = [[0.15, 0.15, 0.15], [0.47, 0.47, 0.47]] }
"""


@pytest.mark.parametrize("ranks", [2, 5])
def test_tables_are_those_of_a_run(tmp_path, ranks):
    """A cube of 4^3 full blocks: bytes, neighbours and shared node blocks of the worst rank."""

    def job(r):
        home = tmp_path / f"{r.rank}"
        home.mkdir()
        simulation, _ = begin(home, CUBE, r)
        tables, halo = simulation.exchange.tables, simulation.exchange.halo
        return len(tables.code), tables.receives_remote.sum(), halo.bytes_sent, len(halo.sends)

    found = np.array(simulated_ranks.run(ranks, job)).max(0)
    told = scaling_model.tables(ranks, 64 // ranks if 64 % ranks == 0 else 64 / ranks)
    assert found.tolist() == [told[k] for k in ("own", "shared", "bytes", "neighbours")]


def test_one_rank_sends_nothing():
    told = scaling_model.tables(1, 27)
    assert told["own"] == 27 and told["border"] == told["bytes"] == told["shared"] == 0


def test_constants_are_found_again():
    """Rows made from known constants give these constants back."""
    unit, kept, copied = 2e-8, 1e-6, 3e-10

    def row(particles, blocks, patches, size, ranks):
        p2g = unit * (particles + BLOCK_COST * blocks) + kept * patches
        return [p2g, 2 * copied * size, 0.0, 0.0, 0.0, particles, blocks, patches, size, ranks - 1]

    rows = {1: [row(1000, 9, 0, 0, 1)], 2: [row(1100, 8, 5, 4e5, 2), row(900, 7, 4, 3e5, 2)]}
    busy = rows[1] * 2
    rows[1] = [[t / 1.5 for t in rows[1][0][:5]] + rows[1][0][5:]]  # alone it is quicker
    c = scaling_model.fit_cost_constants(rows, busy, 25.0)
    assert c["alone"] == pytest.approx(unit / 1.5)
    assert [c["unit"], c["shared"], c["copied"]] == pytest.approx([unit, kept, copied])
    assert c["python"] == pytest.approx(25e-6)


def test_efficiency_falls_with_latency_and_rises_with_particles():
    c = {"unit": 2e-8, "shared": 1e-6, "copied": 3e-10, "python": 2e-5}
    few, many = (
        scaling_model.step(c, 1, n, 2e-6, 1e10) / scaling_model.step(c, 64, n, 2e-6, 1e10)
        for n in (10_000, 300_000)
    )
    assert 0.2 < few < many < 1.0
    slow = scaling_model.step(c, 64, 10_000, 1e-3, 1e10)
    assert slow > scaling_model.step(c, 64, 10_000, 2e-6, 1e10) + 5e-3


def test_cuts_follow_the_work():
    """Particles heap up at one end: cuts that never move end with half of all work on one rank."""
    keys = np.arange(200)
    follow = balance_study.Followed(8)
    for k in range(6):
        count = np.full(200, 100) + (keys < 40) * 80 * k
        follow.sorted(keys, predicted_work(count, 1.0), count, 50)
    assert follow.fixed[0] == follow.moving[0] < 1.03
    assert follow.fixed[-1] > 1.4 and max(follow.moving) < 1.05
    assert follow.taken >= 3 and follow.moved > 0


def test_balance_as_a_command(tmp_path, capsys):
    scene = tmp_path / "scene.toml"
    scene.write_text(CUBE)
    assert bench.main(["balance", str(scene), "--ranks", "3", "--time", "0.002"]) == 0
    out = capsys.readouterr().out
    assert "32,768 particles of 1 material(s) in 64 blocks" in out
    assert out.splitlines()[-1].split()[0] == "3"


def test_a_wrong_scene_is_one_line(tmp_path, capsys):
    scene = tmp_path / "scene.toml"
    scene.write_text(CUBE.replace("cell", "cel"))
    assert bench.main(["balance", str(scene)]) == 2
    assert "scene.toml:4" in capsys.readouterr().err


def test_census_as_a_command(capsys):
    """What the others tell the rank in the middle is what a whole cube holds around it."""
    assert bench.main(["census", "--ranks", "8", "--particles", "14000"]) == 0
    row = capsys.readouterr().out.splitlines()[-1].split()
    lattice, key, code = sort_scaling.cube(8, 14_000)
    owner = owners(key, partition(key, np.ones(len(key)), 8, None))
    block = lattice.block(code)
    gap = np.abs(block[:, None] - block[owner == owner[len(owner) // 2]]).max(2).min(1)
    assert row[:3] == ["8", str((gap == 0).sum()), str(((gap > 0) & (gap <= 2)).sum())]
    tables = sort_scaling.Sort(8, 14_000).once(looks=True)
    assert len(tables.code) == (gap == 0).sum()
