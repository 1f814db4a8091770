"""Walls without a kind: slip for liquids, separate for the rest; what plan and failure say."""

import numpy as np
import pytest

from tests.support.engine_pair import of_scene, worst
from tests.support.simulate import advance, begin, by_id
from tests.support.small_scenes import scene
from vgmpi.commands.cli import main
from vgmpi.kernels.step_records import StepReport
from vgmpi.kernels.transfer.g2p import OUT_OF_DOMAIN
from vgmpi.planning.cost.plan_report import format_plan
from vgmpi.preprocess.scene_builder import build_scene
from vgmpi.solver.failure_message import failure_message, is_way_out
from vgmpi.solver.initial_particles import known_of, plan_for
from vgmpi.solver.run import Runner

SCENE = """
[domain]
size = [0.2, 0.12, 0.22]
cell = 0.02
BOUNDARY
[time]
end = 0.1
[accuracy]
pressure = "explicit"
precision = "double"
[material.jelly]
kind = "elastic"
youngs_modulus = 2e4
[material.grains]
kind = "sand"
[material.water]
kind = "fluid"
max_speed = 2
"""
CUBE = """
[[object]]
name = "cube"
material = "MATERIAL"
velocity = [0.4, 0.1, SPEED]
shape = { box = [[0.12, 0.04, LOW], [0.2, 0.12, HIGH]] }
"""
POOL = """
[[object]]
name = "pool"
material = "water"
shape = { box = [[0, 0, 0], [0.1, 0.12, 0.06]] }
"""


def body(material, speed=0.0, low=0.0):
    """A cube of a material on the bottom or the top, in a corner of the domain."""
    words = {"MATERIAL": material, "SPEED": speed, "LOW": low, "HIGH": round(low + 0.08, 9)}
    text = CUBE
    for name, value in words.items():
        text = text.replace(name, str(value))
    return text


def text_of(things, boundary=""):
    """A scene as text."""
    return SCENE.replace("BOUNDARY", boundary and f"boundary = {boundary}") + things


def plan_of(folder, text):
    loaded = scene(folder, text)
    return loaded, plan_for(loaded, known_of(loaded, build_scene(loaded)))


def test_the_kind_is_that_of_the_material(tmp_path):
    """A kind that the scene names holds for all."""
    _, plan = plan_of(tmp_path, text_of(body("grains") + POOL, '{ bottom = "slip" }'))
    kinds = [[kind for kind, _ in walls] for walls in (plan.walls.liquids, plan.walls.solids)]
    assert kinds == [["slip"] * 6, ["separate"] * 4 + ["slip", "separate"]]


def test_sand_in_water_meets_walls_as_the_water_does(tmp_path):
    """The fractions of both add up at a wall only if both are completed there."""
    text = text_of(body("grains") + POOL)
    _, alone = plan_of(tmp_path, text)
    seeps = '[[coupling]]\nkind = "drag"\nbetween = ["water", "grains"]\n'
    _, both = plan_of(tmp_path, f"{text}{seeps}hydraulic_conductivity = 1e-2\n")
    for plan, held in ((alone, ["water"]), (both, ["grains", "water"])):
        materials = {group.material for group in plan.groups if plan.phases[group.phase].is_liquid}
        assert sorted(materials) == held


def test_liquids_keep_their_bits(tmp_path):
    """Liquids alone move as in a box of slip walls."""
    ends = []
    for name, boundary in (("none", ""), ("slip", '"slip"')):
        (tmp_path / name).mkdir()
        simulation, _ = begin(tmp_path / name, text_of(POOL, boundary))
        advance(simulation, 0.05)
        ends.append(by_id(simulation, "x", "v"))
    assert all(np.array_equal(a, b) for a, b in zip(*ends, strict=True))


@pytest.mark.parametrize("transfer", ["apic", "apic-corrected"])
@pytest.mark.parametrize("material", ["jelly", "grains"])
@pytest.mark.parametrize("low, speed", [(0.0, -0.8), (0.14, 0.8)], ids=["bottom", "top"])
def test_engines_agree_on_walls_that_let_go(tmp_path, low, speed, material, transfer):
    """A cube in a corner of three walls, the upper one three nodes beyond a block, jumps off."""
    text = text_of(body(material, speed, low)).replace(
        'precision = "double"', f'precision = "double"\ntransfer = "{transfer}"'
    )
    slow, fast = of_scene(tmp_path, text, ("numpy", "cpu"))
    for step in range(40):
        dt = 0.5 * slow.bound()
        for one in (slow, fast):
            if step == 20:
                one.sort()
            one.advance(dt)
    found = worst(fast, slow)
    assert max(found.values()) < 1e-12, found


def test_check_and_plan_name_slip_walls_that_hold(tmp_path, capsys):
    loaded, plan = plan_of(tmp_path, text_of(body("jelly"), '"slip"'))
    line = "bottom is slip: it also holds back bodies that pull away from it; separate lets them go"
    assert line in format_plan(loaded, plan, 1)
    assert main([str(tmp_path / "scene.toml"), "--check"]) == 0
    assert f"wall {line}" in capsys.readouterr().out
    loaded, plan = plan_of(tmp_path, text_of(body("jelly")))
    assert main([str(tmp_path / "scene.toml"), "--check"]) == 0
    assert "holds back" not in capsys.readouterr().out
    report = format_plan(loaded, plan, 1)
    assert "also holds back" not in report
    assert "  walls       separate, separate" in report


def test_a_failure_names_the_wall(tmp_path, caplog):
    simulation, _ = begin(tmp_path, text_of(body("jelly")))
    (group,) = simulation.groups
    index = group.index()
    lowest = index[np.argmin(group.positions_at(index)[:, 2])]
    report = StepReport(1.0, 0.0, (0.0, 0.0, 0.0), [(int(group.ids[lowest]), OUT_OF_DOMAIN)], [])
    message = failure_message(simulation, report)
    assert message.endswith("it left the domain: it sank through the bottom wall")
    assert is_way_out(message) and not is_way_out("object 0: its volume ratio J left 0.1 .. 5")
    runner = Runner.__new__(Runner)
    runner.files = None
    assert runner._blew_up(message.format("egg")) == 3
    (record,) = caplog.records
    assert record.getMessage().startswith("stopped: object egg, particle ")
