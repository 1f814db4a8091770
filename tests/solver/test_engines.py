"""Every engine on the same small scenes: every law, contact, couplings, FLIP, splines, colors.

engines/numpy_reference is the method of docs/explanation on one dense grid; the others are held
to it in double precision. Particles are moved off their lattice at random, so that no sum cancels
by symmetry and no contact hangs on a rounding error.
"""

import numpy as np
import pytest

from tests.support.engine_pair import of_scene, worst
from tests.support.simulate import inlets_of
from tests.support.small_scenes import LAWS
from vgmpi.commands import cli
from vgmpi.solver.run_options import ENGINES

STEPS, SORT_AT = 8, 3  # particles of liquids are shifted before the seventh
HEAD = """
[domain]
size = [0.2, 0.16, 0.16]
cell = 0.02
gravity = [0.5, -0.3, -9.8]
boundary = { BOUNDARY }
[time]
end = 1
[accuracy]
pressure = "explicit"
precision = "double"
ACCURACY
"""
DENSITY = 'volume_correction = "density"'
WALLS = {
    "mixed": 'default = "slip", bottom = "stick", west = { kind = "separate", friction = 0.2 }',
    "open": 'default = "slip", bottom = "stick", east = "open"',
    "separate": 'default = { kind = "separate", friction = 0.3 }',
    "vanishing": 'default = { kind = "separate", friction = 0.3 }, bottom = "stick", '
    'east = { kind = "slip", removal_time = "0.5 ms" },'
    ' north = { kind = "separate", removal_time = "0.8 ms" }',
}


def material(name, keys):
    return f"[material.{name}]\n{keys}\n"


def body(name, of, shape, more=""):
    return f'[[object]]\nname = "{name}"\nmaterial = "{of}"\nshape = {{ {shape} }}\n{more}\n'


def coupling(kind, one, other, keys=""):
    return f'[[coupling]]\nkind = "{kind}"\nbetween = ["{one}", "{other}"]\n{keys}\n'


WATER = material("water", 'kind = "fluid"\ntait_coefficient = 2e4\nviscosity = 0.5')
OIL = material("oil", 'kind = "fluid"\ntait_coefficient = 1e4\ndensity = 800')
SAND = material("sand", 'kind = "sand"\nyoungs_modulus = 2e5\nporosity = 0.45')
TOY = material("toy", 'kind = "elastic"\ndensity = 700\nyoungs_modulus = 2e5')
POOL = body("pool", "water", "box = [[0, 0, 0], [0.2, 0.16, 0.06]]", "velocity = [0.5, -0.4, -0.3]")
CUBE = body(
    "cube", "toy", "box = [[0.03, 0.05, 0.055], [0.1, 0.11, 0.1]]",
    "velocity = [-1, 0.5, -1]\nangular_velocity = [2, 0, 4]",
)  # fmt: skip
OTHER = body(
    "other", "toy", "box = [[0.095, 0.03, 0.05], [0.16, 0.1, 0.11]]", "velocity = [-2, 0, 0]"
)
POST = (
    '[[object]]\nname = "post"\nrole = "scenery"\ncollider = true\nposition = [0.13, 0.08, 0.04]\n'
    "shape = { sphere = { center = [0, 0, 0], radius = 0.04 } }\n"
)
TURNING = (
    'motion = { velocity = [0.3, 0, -0.2], angular_velocity = "90 rpm",'
    ' axis = [1, 1, 0], end_time = "0.1 s" }\n'
)
SWEEPING = (
    '[[object]]\nname = "paddle"\nrole = "scenery"\ncollider = true\nfriction = 0.4\n'
    "shape = { box = [[0, 0.03, 0.01], [0.03, 0.12, 0.1]] }\n"
    'rotation = { axis = "z", angle = "20 deg" }\n'
    'motion = { keyframes = [{ time = "20 ms", angle = "30 deg", translation = [0.02, 0, 0] }] }\n'
)
PUSHED_BED = body(
    "bed", "sand", "box = [[0.04, 0, 0], [0.16, 0.16, 0.04]]", "velocity = [0.3, -0.4, -1]"
)
PUSHED_POOL = PUSHED_BED.replace("sand", "water")
PLATE = (
    '[[object]]\nname = "plate"\nrole = "scenery"\ncollider = true\n'
    "shape = { box = [[-0.01, -0.05, -0.05], [0.036, 0.21, 0.1]] }\n"
    'rotation = { axis = "z", angle = "7 deg" }\n'
    'motion = { velocity = [2, 0.1, 0], end_time = "20 ms" }\n'
)
DRIVEN_PLATE = body(
    "plate", "toy", "box = [[0.01, 0, 0], [0.04, 0.16, 0.08]]",
    'motion = { velocity = [2, 0, 0], end_time = "5 ms" }',
)  # fmt: skip
SLABS = body(  # whose faces are wide enough to be sure of
    "lower", "toy", "box = [[0.02, 0.02, 0], [0.18, 0.14, 0.06]]", "velocity = [0, 0, -0.5]"
) + body(
    "upper", "toy", "box = [[0.01, 0.02, 0.06], [0.17, 0.14, 0.12]]", "velocity = [1, 0.5, -1]"
)
BED = body(
    "bed", "sand", "box = [[0.02, 0.02, 0], [0.14, 0.14, 0.07]]", "velocity = [0.1, -0.6, 0]"
)
TAP = (
    '[[inlet]]\nname = "tap"\nmaterial = "water"\ndirection = [1, 0, -0.5]\nspeed = 8\n'
    "disc = { center = [0.15, 0.13, 0.12], radius = 0.012 }\n"
)
HOLE = '[[outlet]]\nname = "hole"\nshape = { box = [[0, 0, 0.065], [0.0325, 0.16, 0.16]] }\n'
WET = body("wet", "water", "box = [[0, 0, 0], [0.11, 0.16, 0.09]]", "volume_fraction = 0.6")
OILY = body(
    "oily", "oil", "box = [[0.05, 0, 0.02], [0.2, 0.16, 0.1]]",
    "volume_fraction = 0.6\nvelocity = [-0.4, 0, -0.1]",
)  # fmt: skip
SLICK = body(
    "slick", "oil", "box = [[0.03, 0.02, 0.06], [0.18, 0.14, 0.11]]", "velocity = [0.4, 0, -1.5]"
)
MIX = coupling("mixing", "water", "oil", "diffusivity = 2e-4\nslip_relaxation_time = 3e-3")
FLOW = coupling("drag", "water", "sand", "hydraulic_conductivity = 2e-2")
COLORS = '[appearance]\ncolor_transfer = "step"\n'
ONE = 'phase = "one"\n'
AFLIP = 'transfer = "aflip"\nflip_decay_time = "5 ms"'
CELLS = 'dilatation = "cells"'
CORRECTED = 'transfer = "apic-corrected"'
RED, BLUE = 'color = "#ff2010"', 'color = "#1020ff"'


TUMBLING = (
    'motion = { velocity = [-1, 0.5, -1], angular_velocity = "300 rpm", axis = [1, 0, 2],'
    ' end_time = "2 ms" }\n'
)
DRIVEN = CUBE[: CUBE.index("velocity")] + TUMBLING
HELD = BED[: BED.index("velocity")] + 'release_time = "0.7 ms"\n'
LETTING_GO = HELD + 'release_order = "top-down"\nrelease_end_time = "2 ms"\n'
STIFF = material("stiff", 'kind = "elastic"\ndensity = 2100\nyoungs_modulus = 6e5')
REGIONS = (
    '[[object.region]]\nmaterial = "stiff"\nbox = [[0.06, 0, 0], [0.2, 0.2, 0.2]]\n'
    '[[object.region]]\nmaterial = "toy"\n'
    "sphere = { center = [0.09, 0.08, 0.08], radius = 0.015 }\n"
)
TIN = material("tin", 'kind = "metal"\nyoungs_modulus = 1e6\nyield_stress = 2e3')


def of_law(kind):
    """A ball of a law that meets the floor."""
    ball = "sphere = { center = [0.1, 0.08, 0.05], radius = 0.045 }"
    keys = f'kind = "{kind}"\n{LAWS[kind]}'
    return material("stuff", keys) + body("ball", "stuff", ball, "velocity = [0.5, 0.3, -2]")


# text, walls, what is below [accuracy]
SCENES = {kind: (of_law(kind), "mixed", "") for kind in LAWS} | {
    "contact": (WATER + TOY + POOL + CUBE, "mixed", ""),
    "one field for all": (
        WATER + TOY + SAND + ONE.join([POOL, CUBE, OTHER.replace("toy", "sand"), ""]), "mixed", "",
    ),
    "three in contact": (
        WATER + TOY + POOL + CUBE + OTHER + coupling("contact", "toy", "toy", "friction = 0.4"),
        "separate",
        "",
    ),
    "contact of faces": (TOY + SLABS, "separate", ""),
    "collider": (WATER + TOY + POOL + CUBE + POST, "mixed", ""),
    "colliders that move": (WATER + TOY + POOL + CUBE + POST + TURNING + SWEEPING, "mixed", ""),
    "pushed along walls": (SAND + PUSHED_BED + PLATE, "separate", ""),
    "pushed along a floor without slip": (WATER + PUSHED_POOL + PLATE, "mixed", ""),
    "pushed by a driven body": (SAND + TOY + PUSHED_BED + DRIVEN_PLATE, "separate", ""),
    "mixing": (WATER + OIL + WET + OILY + MIX, "mixed", ""),
    "mixing with slip": (
        WATER + OIL.replace("800", "50").replace("1e4", "1e3") + WET + OILY + MIX, "mixed", "",
    ),
    "mixing as printed": (
        WATER + OIL + WET + OILY
        + coupling("mixing-versagauss", "water", "oil", "diffusivity = 1e-5"),
        "mixed",
        "",
    ),
    "drag": (WATER + SAND + WET + BED + FLOW, "mixed", ""),
    "drag as printed": (
        WATER + SAND + WET + BED
        + coupling("drag-versagauss", "water", "sand", "hydraulic_conductivity = 2"),
        "mixed",
        "",
    ),
    "everything": (
        WATER + OIL + SAND + TOY + WET + OILY + BED + CUBE + POST + MIX + FLOW, "separate", "",
    ),
    "flip": (WATER + TOY + POOL + CUBE, "mixed", 'transfer = "flip"\nflip_decay_time = "3 ms"'),
    "flip by steps": (WATER + TOY + POOL + CUBE, "mixed", 'transfer = "flip"\nflip_ratio = 0.9'),
    "aflip": (WATER + OIL + WET + OILY + MIX, "mixed", AFLIP),
    "aflip and everything": (
        WATER + OIL + SAND + TOY + WET + OILY + BED + CUBE + POST + MIX + FLOW, "separate", AFLIP,
    ),
    "apic": (WATER + TOY + POOL + CUBE + POST, "mixed", 'transfer = "apic"'),
    "apic-corrected": (WATER + TOY + POOL + CUBE + POST, "separate", CORRECTED),
    "apic-corrected, as one fluid": (
        WATER + OIL + WET + OILY + coupling("mixing", "water", "oil", ""), "mixed", CORRECTED,
    ),
    "apic-corrected and everything": (
        WATER + OIL + SAND + TOY + WET + OILY + BED + CUBE + POST + MIX + FLOW, "mixed", CORRECTED,
    ),
    "pic with bspline": (
        WATER + TOY + POOL + CUBE, "mixed", 'transfer = "pic"\ngradient = "bspline"',
    ),
    "colors": (
        COLORS + WATER + OIL + MIX + WET + RED + "\n" + OILY + BLUE + "\n", "mixed", "",
    ),
    "density correction": (WATER + TOY + POOL + CUBE + POST, "mixed", DENSITY),
    "density correction, aflip": (WATER + TOY + POOL + CUBE, "separate", f"{AFLIP}\n{DENSITY}"),
    "density correction, bspline": (
        WATER + TOY + POOL + CUBE, "mixed", f'transfer = "pic"\ngradient = "bspline"\n{DENSITY}',
    ),
    "density correction, open": (
        WATER + TOY + POOL.replace("0.2, 0.16, 0.06", "0.175, 0.16, 0.06") + CUBE, "open", DENSITY,
    ),
    "open walls": (
        WATER + TOY + POOL.replace("0.2, 0.16, 0.06", "0.175, 0.16, 0.06") + CUBE, "open", "",
    ),
    "several densities": (WATER + OIL + TOY + POOL + SLICK + CUBE + POST, "mixed", ""),
    "dilatation by cells": (WATER + TOY + POOL + CUBE + POST, "mixed", CELLS),
    "dilatation by cells, density correction": (
        WATER + TOY + POOL + CUBE, "separate", f"{CELLS}\n{DENSITY}",
    ),
    "walls that vanish": (WATER + TOY + POOL + CUBE + OTHER, "vanishing", ""),
    "inlets and outlets": (WATER + TOY + POOL + CUBE + TAP + HOLE, "mixed", ""),
    "sticking, in contact": (
        WATER + TOY + POOL + CUBE + "slip_length = 0\n" + OTHER + "slip_length = 0.02\n",
        "mixed", "",
    ),
    "sticking, driven, in contact": (
        WATER + TOY + POOL + DRIVEN + "slip_length = 0\n" + POST, "separate", CORRECTED,
    ),
    "driven, in contact": (WATER + TOY + POOL + DRIVEN + OTHER + POST, "separate", ""),
    "let go": (WATER + SAND + TOY + POOL + HELD + DRIVEN, "mixed", ""),
    "let go in layers": (WATER + SAND + WET.replace("0.11", "0.2") + LETTING_GO + FLOW, "mixed",
                         AFLIP),
    "driven tin": (
        WATER + TIN + POOL + DRIVEN.replace("toy", "tin") + "track_deformation = true\n", "mixed",
        CORRECTED,
    ),
    "regions": (WATER + TOY + STIFF + POOL + CUBE + REGIONS, "mixed", ""),
    "deformation": (
        TIN
        + body("ball", "tin", "sphere = { center = [0.1, 0.08, 0.05], radius = 0.045 }",
               "velocity = [0.5, 0.3, -2]\ntrack_deformation = true"),
        "mixed",
        "",
    ),
}  # fmt: skip


def text_of(name):
    """A scene as text."""
    text, walls, accuracy = SCENES[name]
    return HEAD.replace("BOUNDARY", WALLS[walls]).replace("ACCURACY", accuracy) + text


def simulations(folder, name):
    """{engine: Simulation} of the same particles."""
    return dict(zip(ENGINES, of_scene(folder, text_of(name), tuple(ENGINES)), strict=True))


@pytest.mark.parametrize("name", SCENES)
def test_engines_agree(tmp_path, name):
    every = simulations(tmp_path, name)
    slow = every.pop("numpy")
    most = 0.0
    for step in range(STEPS):
        dt = 0.5 * slow.bound()
        for one in (slow, *every.values()):
            if step == SORT_AT:
                one.sort()
            one.advance(dt)
    for engine, one in every.items():
        found = worst(one, slow) | {"bound": abs(one.bound() / slow.bound() - 1.0)}
        most = max(most, *found.values())
        assert most < 1e-12, (engine, {key: v for key, v in found.items() if v >= 1e-12})
    touching = slow.engine.contact_count
    print(f"{name}: {most:.1e}, {touching} nodes in contact")
    if slow.plan.has_sources:
        came, went = np.array(slow.features["inlets_outlets"].flow.totals())[:, [0, 2]].T
        assert (
            went.max() > 0 and came.sum() > inlets_of(slow.plan)[0].first + 4 * 4
        )  # those at the start
        part = slow.features["inlets_outlets"].flow.part
        assert all(one.features["inlets_outlets"].flow.part == part for one in every.values())
    assert touching > 10 or not ("contact" in name or name in ("collider", "flip", "everything"))


def test_the_numpy_engine_wants_one_rank(tmp_path):
    """On several it says so at once, before anything is computed."""
    (tmp_path / "scene.toml").write_text(HEAD.replace("BOUNDARY", "").replace("ACCURACY", "")
                                         + SCENES["fluid"][0])  # fmt: skip
    with pytest.raises(SystemExit) as refused:
        cli.parse_arguments([str(tmp_path / "scene.toml"), "--engine", "numpi"])
    assert refused.value.code == 2
    assert cli.main([str(tmp_path / "scene.toml"), "--engine", "numpy", "--threads", "2"]) == 2
