"""The NumPy and the CPU engine on the same small scenes of free rigid bodies, joints, slip, pinned
parts and thin walls: particles, bodies and reactions agree to 1e-12 over tens of steps."""

import numpy as np
import pytest

from tests.solver.test_engines import (
    DENSITY,
    HEAD,
    OTHER,
    POST,
    SAND,
    TOY,
    WALLS,
    WATER,
    body,
    material,
)
from tests.support.engine_pair import of_scene, worst

STEPS, SORT_AT = 24, 12
QUANTA = 1e-3  # reactions are sums of whole quanta: they agree to 1e-9
WOOD = material("wood", 'kind = "elastic"\npreset = "cork"\nfriction = 0.3')
POOL = body("pool", "water", "box = [[0, 0, 0], [0.2, 0.16, 0.05]]", "velocity = [0.5, -0.4, -0.3]")
BALL = body(
    "ball", "wood", "sphere = { center = [0.09, 0.08, 0.085], radius = 0.045 }",
    "rigid = true\nvelocity = [0.3, 0, -2]\nangular_velocity = [0, 9, 3]",
)  # fmt: skip
CRATE = body(
    "crate", "wood", "box = [[0.11, 0.04, 0.05], [0.18, 0.12, 0.12]]",
    "rigid = true\nrestitution = 0.5\nvelocity = [-2, 0.2, -0.5]\nangular_velocity = [0, 2, 1]",
)  # fmt: skip
AXLE = "endpoints = [[0.1, 0.06, 0.09], [0.1, 0.1, 0.09]]"
JOINTS = """
[[joint]]
kind = "hinge"
between = ["ball"]
at = [0.09, 0.08, 0.085]
axis = "y"
motor = { speed = "300 rpm", torque = 0.5 }
[[joint]]
kind = "hinge"
between = ["crate", "ball"]
at = [0.12, 0.08, 0.085]
axis = "y"
limits = ["-1 deg", "90 deg"]
[[joint]]
kind = "spring"
between = ["crate"]
at = [0.18, 0.08, 0.12]
to = [0.19, 0.08, 0.15]
stiffness = 500
damping = 2
"""
HONEY = material("honey", 'kind = "fluid"\nviscosity = 5\ntait_coefficient = 2e4')
RUBBER = material(
    "rubber", 'kind = "elastic"\ndensity = 1100\nyoungs_modulus = 1e5\nfriction = 0.3'
)
SYRUP = body("syrup", "honey", "box = [[0, 0, 0.035], [0.2, 0.16, 0.09]]", "velocity = [0.5, 0, 0]")
TRAY = (
    '[[object]]\nname = "tray"\nrole = "scenery"\ncollider = true\nslip_length = LENGTH\n'
    "shape = { box = [[-0.02, -0.02, -0.05], [0.22, 0.18, 0.035]] }\n"
)
CARRIED = (
    "motion = { velocity = [0.5, 0.2, 0.3], angular_velocity = 3, axis = [1, 1, 0],"
    " end_time = 0.05 }\n"
)
BEAM = body(
    "beam", "rubber", "box = [[0.02, 0.04, 0.05], [0.16, 0.12, 0.1]]",
    "pinned = { box = [[0.01, 0.03, 0.04], [0.055, 0.13, 0.11]] }\nvelocity = [0, 0, -1]",
)  # fmt: skip
WHIP = BEAM.replace("0.11]] }", "0.11]], motion = { velocity = [1, 0, 0.5], end_time = 0.05 } }")
RIM = (
    '[[object]]\nname = "rim"\nrole = "scenery"\ncollider = true\n'
    f"shape = {{ cylinder = {{ {AXLE}, radius = 0.035 }} }}\n"
    'motion = { axis = "y", angular_velocity = 20 }\n'
)
TYRE = body(
    "tyre", "rubber", f"cylinder = {{ {AXLE}, radius = 0.065 }}",
    'pinned = { sphere = { center = [0.1, 0.08, 0.09], radius = 0.035 }, to = "rim" }',
)  # fmt: skip
TREE = body(
    "tree", "rubber", "box = [[0.065, 0.055, 0.07], [0.115, 0.105, 0.15]]",
    "velocity = [0.3, 0, -2]\npinned = { box = [[0.06, 0.05, 0.06], [0.12, 0.11, 0.1]],"
    ' to = "ball" }',
)  # fmt: skip
CUP = (
    '[[object]]\nname = "cup"\nrole = "scenery"\ncollider = true\nthin = true\n'
    "shape = { difference = [{ box = [[0.032, 0.03, 0.045], [0.142, 0.13, 0.12]] },"
    " { box = [[0.042, 0.04, 0.063], [0.132, 0.12, 0.3]] }] }\n"
)
CARRIED_DOWN = (
    "motion = { velocity = [0, 0, -0.5], angular_velocity = 2, axis = 'y', end_time = 0.02 }\n"
)
PLATE = (
    '[[object]]\nname = "plate"\nrole = "scenery"\ncollider = true\nthin = true\n'
    "shape = { box = [[0.16, -0.02, -0.02], [0.168, 0.18, 0.09]] }\n"
)
JET = body(  # over the rim of the cup
    "jet", "water", "box = [[0.01, 0.05, 0.115], [0.09, 0.11, 0.155]]", "velocity = [0, 0, -1]"
)
HEAP = body(
    "heap", "sand", "box = [[0.05, 0.05, 0.065], [0.09, 0.11, 0.113]]", "velocity = [0.5, 0, 0.5]"
)


def probe(collider):
    return f'[[probe]]\nname = "{collider}"\nsampling_rate = 100\ncollider = "{collider}"\n'


SCENES = {  # text, walls, what is below [accuracy]
    "ball in water": (WATER + WOOD + POOL + BALL, "mixed", ""),
    "ball in water, density correction": (WATER + WOOD + POOL + BALL, "separate", DENSITY),
    "bodies, cube and colliders": (
        WATER + WOOD + TOY + POOL + BALL + CRATE + OTHER + POST + probe("post"), "separate", "",
    ),
    "joints": (WATER + WOOD + POOL + BALL + CRATE + JOINTS, "mixed", ""),
    "no slip": (HONEY + SYRUP + TRAY.replace("LENGTH", "0") + probe("tray"), "mixed", ""),
    "slip on what moves": (
        HONEY + SYRUP + TRAY.replace("LENGTH", "0.004") + CARRIED + probe("tray"), "separate", "",
    ),
    "no slip on a ball": (
        HONEY + WOOD + SYRUP + TRAY.replace("LENGTH", "0") + BALL + "slip_length = 0\n", "mixed",
        "",
    ),
    "pinned beam": (WATER + RUBBER + POOL + BEAM + probe("beam"), "mixed", ""),
    "pinned to what moves": (RUBBER + WHIP + POST + probe("beam") + probe("post"), "separate", ""),
    "tyre on a rim": (WATER + RUBBER + POOL + RIM + TYRE + probe("rim"), "mixed", ""),
    "thin walls": (
        WATER + SAND + POOL + JET + HEAP + CUP + PLATE + probe("cup"), "mixed", DENSITY,
    ),
    "thin walls that move": (
        WATER + SAND + TOY + POOL + JET + HEAP + OTHER + CUP + CARRIED_DOWN + probe("cup"),
        "separate", "",
    ),
    "tree on a ball": (WATER + WOOD + RUBBER + POOL + BALL + TREE, "mixed", ""),
}  # fmt: skip


def simulations(folder, name):
    """(NumPy engine, CPU engine): simulations of the same particles."""
    text, walls, accuracy = SCENES[name]
    head = HEAD.replace("BOUNDARY", WALLS[walls]).replace("ACCURACY", accuracy)
    return of_scene(folder, head + text, ("numpy", "cpu"))


def apart(one, other):
    """Largest difference of bodies and reactions, relative to their largest values."""
    found = {}
    if "rigid_bodies" in one.features:
        for name in ("x", "q", "momentum", "spin"):
            a, b = (getattr(each.features["rigid_bodies"].bodies, name) for each in (one, other))
            found[f"bodies' {name}"] = np.abs(a - b).max() / np.abs(b).max()
    if "reactions" in one.features:
        a, b = (each.features["reactions"].totals for each in (one, other))
        scale = np.maximum(np.abs(b).max(0), 1e-30)
        found["reactions"] = QUANTA * (np.abs(a - b).max(0) / scale).max()
    return found


@pytest.mark.parametrize("name", SCENES)
def test_engines_agree_at_surfaces(tmp_path, name):
    slow, fast = simulations(tmp_path, name)
    for step in range(STEPS):
        dt = 0.5 * slow.bound()
        for one in (slow, fast):
            if step == SORT_AT:
                one.sort()
            one.advance(dt)
        found = worst(fast, slow) | apart(fast, slow)
        print(step, f"{max(found.values()):.1e}", max(found, key=lambda k: found[k]))
    assert max(found.values()) < 1e-12, {key: v for key, v in found.items() if v >= 1e-12}
