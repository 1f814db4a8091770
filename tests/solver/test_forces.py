"""Forces on single colliders and walls: together they are what the bodies' momentum says, and each
is what is known of water at rest; work is what force and torque do."""

import numpy as np
import pytest

import vgmpi
from vgmpi.io import checkpoint
from vgmpi.runtime.config.schema import SceneError
from vgmpi.scene.probes import WALL_NAMES

HEAD = """
[domain]
size = [0.2, 0.16, 0.2]
cell = 0.02
gravity = [0.5, -0.3, -9.8]
boundary = { default = WALLS }
[time]
end = 0.01
frames = 2
[accuracy]
pressure = "explicit"
precision = "double"
transfer = "TRANSFER"
[material.water]
kind = "fluid"
tait_coefficient = 2e4
viscosity = 0.5
[material.toy]
kind = "elastic"
density = 700
youngs_modulus = 2e5
[material.sand]
kind = "sand"
youngs_modulus = 2e5
porosity = 0.45
"""
POOL = """
[[object]]
name = "pool"
material = "water"
shape = { box = [[0, 0, 0], [0.12, 0.16, 0.1]] }
velocity = [0.5, -0.7, -0.3]
"""
HEAP = POOL.replace("pool", "heap").replace('"water"', '"sand"')
CUBE = """
[[object]]
name = "cube"
material = "toy"
shape = { box = [[0.06, 0.02, 0], [0.14, 0.1, 0.08]] }
velocity = [-1, 0.5, -1]
angular_velocity = [2, 0, 4]
"""
POST = """
[[object]]
name = "post"
role = "scenery"
collider = true
shape = { sphere = { center = [0.13, 0.08, 0.04], radius = 0.035 } }
"""
PADDLE = """
[[object]]
name = "paddle"
role = "scenery"
collider = true
friction = 0.4
shape = { box = [[0.02, 0.03, 0.04], [0.06, 0.12, 0.1]] }
motion = { velocity = [1, 0.2, -0.5], angular_velocity = "90 rpm", axis = [1, 1, 0] }
"""
PLATE = PADDLE.replace(
    "[[0.02, 0.03, 0.04], [0.06, 0.12, 0.1]]", "[[-0.05, -0.05, -0.05], [0.038, 0.21, 0.2]]"
)
PUSHED_POOL, PUSHED_HEAP = (body.replace("[[0, 0, 0]", "[[0.04, 0, 0]") for body in (POOL, HEAP))


def scene(tmp_path, bodies, walls="slip", transfer="apic-corrected", end=0.01, cfl=0.4):
    """A scene with all of its probes, a row at every step."""
    text = HEAD.replace("WALLS", walls if "{" in walls else f'"{walls}"')
    text = text.replace("TRANSFER", transfer) + bodies
    for name in ("post", "paddle"):
        if f'"{name}"' in bodies:
            text += f'[[probe]]\nname = "{name}"\nsampling_interval = "1 us"\ncollider = "{name}"\n'
    for name in ("all", *WALL_NAMES):
        text += f'[[probe]]\nname = "{name}"\nsampling_interval = "1 us"\nwall = "{name}"\n'
    return vgmpi.load(tmp_path / "scene.toml", (f"time.end={end}", f"time.cfl={cfl}"), text)


def rows(run, name, key, axes="xyz"):
    """Of all rows but the first: (n, 3)."""
    return np.array([[row[f"{key}_{a}"] for a in axes] for row in run.probes[name][1:]])


def parts(run):
    """The names of all single probes."""
    return [name for name in run.probes if name != "all"]


def off(run):
    """How far the single forces miss the balance of momentum, over what the bodies' momentum,
    taken without signs, is [1]."""
    one = sum(rows(run, name, "force") for name in parts(run))
    time = np.array([row["time"] for row in run.probes["all"]])
    dt = np.diff(time)[:, None]
    there = run.arrays("velocity", "vol0")
    momentum = 1000 * (there["vol0"][:, None] * np.abs(there["velocity"])).sum()
    return np.abs((one - rows(run, "all", "force")) * dt).max() / momentum


PUSHES = '{ kind = "separate", friction = 0.3 }'
CASES = {
    "water, slip": (POOL, "slip", "apic-corrected"),
    "water, stick": (POOL, "stick", "apic-corrected"),
    "water, separate": (POOL, PUSHES, "apic-corrected"),
    "water, stick, apic": (POOL, "stick", "apic"),
    "water, stick, aflip": (POOL, "stick", "aflip"),
    "water, separate, flip": (POOL, PUSHES, "flip"),
    "water, colliders": (POOL + POST + PADDLE, "slip", "apic-corrected"),
    "cube, separate": (CUBE + POST + PADDLE, PUSHES, "apic-corrected"),
    "cube, stick": (CUBE + POST, "stick", "apic-corrected"),
    "cube and water": (POOL + CUBE + PADDLE, PUSHES, "apic-corrected"),
    "sand": (HEAP + POST + PADDLE, "stick", "apic-corrected"),
    "water, pushed along walls": (PUSHED_POOL + PLATE, PUSHES, "apic-corrected"),
    "sand, pushed without slip": (PUSHED_HEAP + PLATE, "stick", "apic-corrected"),
}


@pytest.mark.xfail(strict=True, reason="grains at a separate wall miss the balance by 5e-6")
def test_grains_at_a_wall_that_lets_go_are_the_balance(tmp_path):
    run = vgmpi.run(scene(tmp_path, HEAP, PUSHES, "apic-corrected"))
    print(f"off by {off(run):.1e} of the impulses")
    assert off(run) < 1e-12


@pytest.mark.parametrize("case", CASES)
def test_all_together_are_the_balance(tmp_path, case):
    bodies, walls, transfer = CASES[case]
    run = vgmpi.run(scene(tmp_path, bodies, walls, transfer))
    assert len(run.probes["all"]) > 10
    assert np.abs(rows(run, "all", "force")).max() > 1.0  # something is pushed
    assert off(run) < 1e-12, off(run)
    for name in set(parts(run)) & {"post", "paddle"}:
        assert np.abs(rows(run, name, "force")).max() > 0.1, name


@pytest.mark.parametrize(
    "case", ["cube and water", "water, stick, aflip", "water, pushed along walls"]
)
def test_engines_agree(tmp_path, case):
    """On every wall and collider by itself: force, torque, work."""
    bodies, walls, transfer = CASES[case]
    asked = scene(tmp_path, bodies, walls, transfer, 0.004)
    fast, slow = (vgmpi.run(asked, engine=engine) for engine in ("cpu", "numpy"))
    for name in parts(fast):
        for key in ("impulse", "angular_impulse"):
            got, want = rows(fast, name, key), rows(slow, name, key)
            assert np.abs(got - want).max() < 1e-9 * max(1e-2, np.abs(want).max()), (name, key)
    for name in set(parts(fast)) & {"paddle"}:
        assert fast.probes[name][-1]["cumulative_work"] == pytest.approx(
            slow.probes[name][-1]["cumulative_work"], rel=1e-9
        )


STIRRER = CUBE[: CUBE.index("velocity")] + (
    'motion = { velocity = [-1, 0.5, -1], angular_velocity = "120 rpm", axis = [1, 0, 3] }\n'
)


CASTLE = (
    HEAP.replace("heap", "castle")
    .replace("[0.12, 0.16, 0.1]", "[0.08, 0.08, 0.14]")
    .replace("velocity = [0.5, -0.7, -0.3]", 'release_time = "1 s"')
)
DRIVEN = {  # bodies, walls, who is free
    "stirred water": (POOL + STIRRER + POST, '"stick"', "pool"),
    "water by sand": (POOL + POST + STIRRER + CASTLE, PUSHES, "pool"),
    "a toy on sand": (CUBE + CASTLE, PUSHES, "cube"),  # sand that is held is no master
}


@pytest.mark.parametrize("case", DRIVEN)
def test_bodies_that_are_driven(tmp_path, case):
    """What they, walls and colliders give is all that a free one got, by both engines."""
    bodies, walls, free = DRIVEN[case]
    text = HEAD.replace("WALLS", walls).replace("TRANSFER", "apic-corrected") + bodies
    driven = [name for name in ("cube", "castle") if f'"{name}"' in bodies and name != free]
    for name in [*driven, *["post"] * ("post" in bodies)]:
        text += f'[[probe]]\nname = "{name}"\nsampling_interval = "1 us"\ncollider = "{name}"\n'
    for name in WALL_NAMES:
        text += f'[[probe]]\nname = "{name}"\nsampling_interval = "1 us"\nwall = "{name}"\n'
    asked = vgmpi.load(
        tmp_path / "scene.toml", ("time.end=0.004",),
        text + f'[[probe]]\nname = "free"\nsampling_interval = "1 us"\nobject = "{free}"\n',
    )  # fmt: skip
    fast, slow = (vgmpi.run(asked, engine=engine) for engine in ("cpu", "numpy"))
    single = [name for name in fast.probes if name != "free"]
    dt = np.diff([row["time"] for row in fast.probes["free"]])[:, None]
    got = rows(fast, "free", "force") * dt
    given = -sum(rows(fast, name, "force") for name in single) * dt
    scale = np.abs(rows(fast, "free", "momentum")).max()
    assert np.abs(got - given).max() < 1e-12 * scale
    for name in driven:
        assert np.abs(rows(fast, name, "impulse")).max() > 1e-3 * scale, name
    for name in single:
        for key in ("impulse", "angular_impulse"):
            one, other = rows(fast, name, key), rows(slow, name, key)
            assert np.abs(one - other).max() < 1e-9 * max(1e-2, np.abs(other).max()), (name, key)
    works = [run.probes[driven[0]][-1]["cumulative_work"] for run in (fast, slow)]
    assert works[0] == pytest.approx(works[1], rel=1e-9)
    assert (works[0] > 0) == (driven[0] == "cube")  # what is held does none


# 9 x 4 cells of water, 10.5 deep, at rest
TANK = """
[domain]
size = [0.18, 0.08, 0.36]
cell = 0.02
[time]
end = 0.02
frames = 2
[accuracy]
pressure = "explicit"
precision = "double"
[material.water]
kind = "fluid"
tait_coefficient = 2e5
[[object]]
name = "water"
material = "water"
initial_pressure = "hydrostatic"
shape = { box = [[0, 0, 0], [0.18, 0.08, 0.21]] }
"""


def test_water_at_rest_in_a_tank(tmp_path):
    """The floor bears the weight; each side rho g h^2 / 2 of its width, at a third of the depth."""
    text = TANK + "".join(
        f'[[probe]]\nname = "{name}"\nsampling_rate = 100\nwall = "{name}"\n' for name in WALL_NAMES
    )
    run = vgmpi.run(vgmpi.load(tmp_path / "scene.toml", text=text))
    last = {name: run.probes[name][-1] for name in WALL_NAMES}
    weight = 1000 * 9.8 * 0.21 * 0.18 * 0.08
    assert last["bottom"]["force_z"] == pytest.approx(-weight, rel=2e-3)
    assert max(abs(last["bottom"][f"torque_{a}"]) for a in "xyz") < 1e-3 * weight * 0.18
    assert last["top"]["force_z"] == 0.0
    below = 0.21 / 3 - 0.36 / 2  # from the middle of a side to where its force acts
    for name, axis, sign, width in (
        ("west", "x", -1, 0.08), ("east", "x", 1, 0.08), ("south", "y", -1, 0.18),
        ("north", "y", 1, 0.18),
    ):  # fmt: skip
        push = sign * 1000 * 9.8 * 0.21**2 / 2 * width
        other = "y" if axis == "x" else "x"
        turn = below * push * (1 if axis == "x" else -1)
        assert last[name][f"force_{axis}"] == pytest.approx(push, rel=0.02), name
        assert last[name][f"torque_{other}"] == pytest.approx(turn, rel=0.02), name
        assert abs(last[name][f"force_{other}"]) < 1e-3 * abs(push)


def test_work_is_what_force_and_torque_do(tmp_path):
    """Of one that moves without turning its velocity times the impulse that it gives; of one that
    turns its spin times that impulse's moment, but for the chord that a step takes of the arc."""
    slides = PADDLE.replace(', angular_velocity = "90 rpm", axis = [1, 1, 0]', "")
    turns = PADDLE.replace("velocity = [1, 0.2, -0.5], ", "").replace("[1, 1, 0]", "[0, 1, 0]")
    for paddle, key, speed, within in (
        (slides, "impulse", [1, 0.2, -0.5], 1e-9),
        (turns, "angular_impulse", [0, 3 * np.pi, 0], 0.003),
    ):
        run = vgmpi.run(scene(tmp_path, POOL + paddle, cfl=0.1))
        last = run.probes["paddle"][-1]
        by = -sum(last[f"{key}_{a}"] * w for a, w in zip("xyz", speed))
        assert abs(by) > 1e-3
        assert last["cumulative_work"] == pytest.approx(by, rel=within)
        total = sum(row["work"] for row in run.probes["paddle"][1:])
        assert total == pytest.approx(last["cumulative_work"], rel=1e-9)


def test_a_collider_at_rest_does_no_work(tmp_path):
    run = vgmpi.run(scene(tmp_path, POOL + POST))
    last = run.probes["post"][-1]
    assert last["cumulative_work"] == 0.0 and abs(last["impulse_x"]) > 1e-3
    # a sphere that hardly rubs is turned about its middle by little
    size = np.linalg.norm([last[f"impulse_{a}"] for a in "xyz"])
    assert np.linalg.norm([last[f"angular_impulse_{a}"] for a in "xyz"]) < 0.05 * 0.035 * size


def without(text):
    """A scene without its probes of single colliders and walls."""
    head, *probes = text.split("[[probe]]")
    return head + "".join("[[probe]]" + one for one in probes if 'wall = "all"' in one)


def test_nobody_asks_nothing_is_there(tmp_path):
    """No arrays, nothing in checkpoints, and the same particles as where somebody does."""
    asked = scene(tmp_path, POOL + PADDLE, end=0.004)
    plain = vgmpi.load(
        tmp_path / "plain.toml", ("time.end=0.004", "time.cfl=0.4"), without(asked.text)
    )
    runs = [vgmpi.run(one, tmp_path / str(k)) for k, one in enumerate((asked, plain))]
    kept = []
    for k in range(2):
        path = checkpoint.latest_valid(tmp_path / str(k) / "checkpoints")
        with checkpoint.open(path) as saved:
            kept.append(saved.attrs)
    assert "given" in kept[0] and "given" not in kept[1]
    assert [set(probe) for probe in kept[1]["scene"]["probe"]] == [
        {"name", "sampling_interval", "wall"}
    ]
    simulation = runs[1].simulation
    assert "reactions" not in simulation.features and simulation.engine.reactions is None
    assert all(part.ghosts is None for part in simulation.engine.parts)
    assert all(each.reactions is None for each in simulation.engine.memory.workspaces)
    one, other = (run.arrays("positions", "velocity", "C") for run in runs)
    assert all((one[name] == other[name]).all() for name in one)


@pytest.mark.parametrize(
    "asks, said",
    [
        (
            'collider = "cube"',
            "'cube' is no collider: scenery with collider = true is",
        ),
        ('collider = "past"', "there is no collider 'past' (did you mean 'post'?); known: post"),
        ('wall = "ceiling"', "wall"),
    ],
)
def test_what_cannot_be_asked(tmp_path, asks, said):
    text = CUBE + POST + f'[[probe]]\nname = "a"\nsampling_rate = 1\n{asks}\n'
    with pytest.raises(SceneError) as caught:
        scene(tmp_path, text)
    assert any("probe" in line and said in line for line in caught.value.lines)


def test_where_particles_go_the_balance_alone_is_refused(tmp_path):
    open_end = HEAD.replace("WALLS", '"slip", east = "open"').replace("TRANSFER", "apic") + POOL
    asks = '[[probe]]\nname = "a"\nsampling_rate = 1\nwall = '
    with pytest.raises(SceneError) as caught:
        vgmpi.load(tmp_path / "scene.toml", text=f'{open_end}{asks}"all"\n')
    assert any("wall" in line and "balance" in line for line in caught.value.lines)
    scene = vgmpi.load(tmp_path / "scene.toml", text=f'{open_end}{asks}"bottom"\n')
    assert scene.probe[0].measures_reaction
    held = open_end.replace(', east = "open"', "") + 'release_time = "1 s"\n'
    with pytest.raises(SceneError) as caught:
        vgmpi.load(
            tmp_path / "scene.toml", text=f'{held.replace("velocity = ", "# ")}{asks}"all"\n'
        )
    assert any(
        "wall: is not for scenes with bodies that are driven" in x for x in caught.value.lines
    )
