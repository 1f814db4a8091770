"""What is told once: who drifts, and the numbers that bound a step."""

import re
from pathlib import Path

import numpy as np
import pytest

from tests.support.small_scenes import scene
from vgmpi.features.mixtures.plan import MixturesPlan
from vgmpi.features.mixtures.rules import WAVE_MARGIN
from vgmpi.kernels import kernel_arguments
from vgmpi.materials.couplings.interaction import CONTACT
from vgmpi.materials.couplings.mixing import Mixing
from vgmpi.materials.material import law_function
from vgmpi.planning.phases_and_groups import color_sets, connected_sets
from vgmpi.planning.plan import make_plan
from vgmpi.preprocess.scene_builder import build_scene
from vgmpi.scene.scene import MAX_CELLS_PER_STEP, miscible_materials

THEORY = (Path(__file__).parents[2] / "docs" / "explanation" / "time-step.md").read_text()


def rules_of(plan):
    """Rules of the phases of a plan that share space."""
    return plan.feature(MixturesPlan).rules


POURED = """
[accuracy]
pressure = "explicit"
precision = "double"
[domain]
size = [0.16, 0.16, 0.16]
cell = 0.02
[time]
end = 1
"""
NAMES = ("ale", "beer", "cola", "dew", "egg")


def poured(tmp_path, couplings, phase=str):
    """Five fluids; couplings: (two names, kind, diffusivity); phase: of a fluid by its name."""
    text = POURED
    for k, name in enumerate(NAMES):
        text += f'[material.{name}]\nkind = "fluid"\ntait_coefficient = 1e4\n'
        text += f'[[object]]\nname = "{name}"\nmaterial = "{name}"\nphase = "{phase(name)}"\n'
        text += f"shape = {{ box = [[0, 0, {0.02 * k}], [0.16, 0.16, {0.02 * k + 0.02}]] }}\n"
    for one, other, kind, diffusivity in couplings:
        text += f'[[coupling]]\nbetween = ["{one}", "{other}"]\nkind = "{kind}"\n'
        text += f"diffusivity = {diffusivity}\n" if kind.startswith("mixing") else ""
        text += "friction = 0\n" if kind == "contact" else ""
    return scene(tmp_path, text)


def plan(tmp_path, couplings):
    count = [8] * len(NAMES)
    return make_plan(poured(tmp_path, couplings), count, [1e-3] * len(NAMES), False)


def test_who_drifts_and_whose_drift_is_no_momentum(tmp_path):
    """The last fluid mixes with nobody; what is printed drifts, within the momentum."""
    found = plan(
        tmp_path, [("ale", "beer", "mixing", 1e-6), ("cola", "dew", "mixing-versagauss", 1e-6)]
    )
    assert [phase.name for phase in found.phases] == list(NAMES)
    assert rules_of(found).drifting.tolist() == [True, True, True, True, False]
    assert rules_of(found).conservative_drift.tolist() == [True, True, False, False, False]
    assert found.feature(MixturesPlan).drifts


@pytest.mark.parametrize(
    "couplings",
    [
        [],
        [("ale", "beer", "mixing", 0.0)],
        [("ale", "beer", "mixing-versagauss", 1e-6)],
        [("ale", "beer", "mixing", 0.0), ("cola", "dew", "mixing-versagauss", 1e-6)],
    ],
)
def test_nothing_is_kept_out_of_the_momentum(tmp_path, couplings):
    found = plan(tmp_path, couplings)
    if couplings:
        assert not found.feature(MixturesPlan).drifts
        drifting = {n for one, other, _, d in couplings if d for n in (one, other)}
        assert [n in drifting for n in NAMES] == rules_of(found).drifting.tolist()
        assert not np.any(rules_of(found).conservative_drift)


@pytest.mark.parametrize(
    "couplings, phase, sets",
    [
        ([], str, [0, 1, 2, 3, 4]),
        ([], lambda name: "one", [0, 0, 0, 0, 0]),
        ([("ale", "beer", "contact", 0)], str, [0, 1, 2, 3, 4]),
        ([("ale", "egg", "mixing", 0)], str, [0, 1, 2, 3, 0]),
        ([("ale", "egg", "mixing-versagauss", 0)], str, [0, 1, 2, 3, 0]),
        # by way of a third, and by a phase that two share
        ([("ale", "cola", "mixing", 0), ("egg", "cola", "mixing", 0)], str, [0, 1, 0, 2, 0]),
        (
            [("ale", "beer", "mixing", 0), ("egg", "dew", "mixing", 0)],
            {"ale": "p", "egg": "p"}.get,
            [0, 0, 1, 0, 0],
        ),
    ],
)
def test_who_exchanges_colors(tmp_path, couplings, phase, sets):
    """By one phase or by a coupling whose rule is mixing; the files say the same."""
    found = poured(tmp_path, couplings, lambda name: phase(name) or name)
    told = color_sets(found)
    assert [told.index(one) for one in told] == [sets.index(one) for one in sets]
    assert [thing["color_group"] for thing in build_scene(found).objects] == told


def test_a_coupling_mixes_by_its_rule_not_by_its_name():
    class Stir(Mixing):
        kind: str = "stir"

    class MixingBowl(Mixing):
        kind: str = "mixing-bowl"
        rule = CONTACT

    couplings = (Stir(between=["ale", "beer"]), MixingBowl(between=["cola", "dew"]))
    assert miscible_materials(couplings) == {"ale", "beer"}


def number(said):
    """Of 0.1 or 2^-21."""
    base, _, power = said.partition("^")
    return float(base) ** float(power or 1)


@pytest.mark.parametrize(
    "said, numbers",
    [
        (r"\|v\| / \((\S+) dx\)", (MAX_CELLS_PER_STEP,)),
        (r"\|tr C\| / (\S+) ", (kernel_arguments.MAX_VOLUME_STRAIN_PER_STEP,)),
        (r"when J leaves (\S+) \.\. (\S+),", (kernel_arguments.J_MIN, kernel_arguments.J_MAX)),
        (
            r"A node lighter than (\S+) of a\s+full cell stays at rest",
            (kernel_arguments.NODE_MASS_FLOOR,),
        ),
        (
            r"one lighter than (\S+) takes no part in contact",
            (kernel_arguments.CONTACT_MASS_FLOOR,),
        ),
    ],
)
def test_the_theory_tells_the_same_limits(said, numbers):
    (found,) = re.findall(said, THEORY)
    found = found if isinstance(found, tuple) else (found,)
    assert tuple(map(number, found)) == numbers


def test_sets_are_connected_whatever_the_order_of_the_pairs():
    """Also along a chain, whose pairs come last first."""
    chain = [(k, k + 1) for k in range(6)]
    for pairs in (chain, chain[::-1], [(5, 2), (2, 0), (1, 3), (3, 3)], [(k, k) for k in range(8)]):
        found = connected_sets(9, pairs)
        for a in range(9):
            assert (found[a] < 0) == all(a not in pair for pair in pairs)
        reached = np.eye(9, dtype=int)
        for a, b in pairs:
            reached[a, b] = reached[b, a] = 1
        reached = np.linalg.matrix_power(reached, 9) > 0
        named = found >= 0
        same = found[:, None] == found[None, :]
        assert np.array_equal(same[named][:, named], reached[named][:, named])


def slippery(tmp_path, one, other, slip_relaxation_time, kind="mixing"):
    """The plan of two fluids that mix, each of a density [kg/m3] and a bulk modulus [Pa]."""
    text = POURED
    for name, (density, modulus) in zip(NAMES, (one, other), strict=False):
        text += f'[material.{name}]\nkind = "fluid"\ndensity = {density}\n'
        text += f"tait_coefficient = {modulus}\n"
        text += f'[[object]]\nname = "{name}"\nmaterial = "{name}"\nvolume_fraction = 0.5\n'
        text += "shape = { box = [[0, 0, 0], [0.16, 0.16, 0.16]] }\n"
    text += f'[[coupling]]\nbetween = ["ale", "beer"]\nkind = "{kind}"\n'
    text += f"slip_relaxation_time = {slip_relaxation_time}\n"
    return make_plan(scene(tmp_path, text), [8] * 2, [1e-3] * 2, False)


def growth(a, one, other, slip_relaxation_time, k, dt):
    """Of a wave [1/m] of pressure in each step, where fluids of some density and modulus, one with
    the share a of the volume, share a space: of its pressure, of the velocity of the whole, and of
    what the slip adds to the flux of volume."""
    share = np.array([a, 1.0 - a])
    density, modulus = np.array([one, other]).T
    modulus, whole = share @ modulus, 1.0 / (share @ density)
    more, keep = share @ (1.0 / density) - whole, slip_relaxation_time / (slip_relaxation_time + dt)
    steps = np.array([[1.0, 0, 0], [k * dt * whole, 1.0, 0], [keep * k * dt * more, 0, keep]])
    flux = np.array([[1.0, -k * dt * modulus, -k * dt * modulus], [0, 1, 0], [0, 0, 1]])
    return np.abs(np.linalg.eigvals(flux @ steps)).max()


@pytest.mark.parametrize("slip_relaxation_time", [1e-6, 1e-5, 1e-4, 1e-2, 10.0])
@pytest.mark.parametrize("ratio", [3.0, 1e2, 1e4])
def test_the_shortest_waves_of_fluids_that_slip_are_stable(tmp_path, ratio, slip_relaxation_time):
    """Those of 2 radians in the way of a wave in a step, as of a fluid alone; a little shorter ones
    are not. Where none is much faster than a fluid's own, they take what the margin spares."""
    plan = slippery(tmp_path, (1e3, 1e6), (1e3 / ratio, 2e6 / ratio), slip_relaxation_time)
    own = [float(law_function(g.law, "wave_speed2")(g.law, g.reference)) for g in plan.groups]
    materials = [(g.density, g.density * c2) for g, c2 in zip(plan.groups, own, strict=True)]
    assert plan.groups[1].wave.factor == 1.0
    heeded = plan.groups[0].wave.factor > 1.0
    assert heeded or ratio == 3.0 or slip_relaxation_time == 1e-6
    spared = 1.0 if heeded else WAVE_MARGIN**0.5
    way = plan.time_step.cfl * plan.dx
    dt = way / np.sqrt(max(own[0] * plan.groups[0].wave.factor, own[1]))
    grown = [
        max(
            growth(a, *materials, slip_relaxation_time, k / way, dt)
            for a in np.linspace(0, 1, 1001)
        )
        for k in (1.999 / spared, 2.01)
    ]
    assert grown[0] < 1.0 + 1e-6 and (grown[1] > 1.01 or not heeded)


def test_no_step_is_shorter_without_a_slip_that_counts(tmp_path):
    """Fluids that move as one, as printed, of one modulus, or the stiffer the lighter."""
    heavy, light = (1e3, 1e6), (0.1, 1e2)
    for one, other, slip_relaxation_time, kind in (
        (heavy, light, 0.0, "mixing"),
        (heavy, light, 1.0, "mixing-versagauss"),
        ((1e3, 1e5), (10.0, 1e5), 1.0, "mixing"),
        ((10.0, 1e6), (1e3, 1e4), 1.0, "mixing"),
    ):
        plan = slippery(tmp_path, one, other, slip_relaxation_time, kind)
        assert [group.wave.factor for group in plan.groups] == [1.0, 1.0]
    assert slippery(tmp_path, heavy, light, 1.0).groups[0].wave.factor > 2500.0
