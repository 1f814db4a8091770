"""What is told once: who drifts, and the numbers that bound a step."""

import re
from pathlib import Path

import numpy as np
import pytest

from tests.scenes import scene
from vgmpi.device import limits
from vgmpi.planning.plan import make_plan

THEORY = (Path(__file__).parents[2] / "docs" / "theory.md").read_text()

POURED = """
[domain]
size = [0.16, 0.16, 0.16]
cell = 0.02
[time]
end = 1
"""
NAMES = ("ale", "beer", "cola", "dew", "egg")


def plan(tmp_path, couplings):
    """Of five fluids with a velocity field each; couplings: (two names, kind, diffusion)."""
    text = POURED
    for k, name in enumerate(NAMES):
        text += f'[material.{name}]\nkind = "fluid"\nbulk_modulus = 1e4\n'
        text += f'[[object]]\nname = "{name}"\nmaterial = "{name}"\nphase = "{name}"\n'
        text += f"shape = {{ box = [[0, 0, {0.02 * k}], [0.16, 0.16, {0.02 * k + 0.02}]] }}\n"
    for one, other, kind, diffusion in couplings:
        text += f'[[coupling]]\nbetween = ["{one}", "{other}"]\nkind = "{kind}"\n'
        text += f"diffusion = {diffusion}\n"
    count = [8] * len(NAMES)
    return make_plan(scene(tmp_path, text), count, [1e-3] * len(NAMES), False)


def test_who_drifts_and_whose_drift_is_no_momentum(tmp_path):
    """The last fluid mixes with nobody; what is printed drifts, within the momentum."""
    found = plan(tmp_path, [("ale", "beer", "mixing", 1e-6), ("cola", "dew", "mixing-paper", 1e-6)])
    assert [phase.name for phase in found.phases] == list(NAMES)
    assert found.rules.drifting.tolist() == [True, True, True, True, False]
    assert found.rules.drifting_apart.tolist() == [True, True, False, False, False]
    assert found.drifts


@pytest.mark.parametrize(
    "couplings",
    [
        [],
        [("ale", "beer", "mixing", 0.0)],
        [("ale", "beer", "mixing-paper", 1e-6)],
        [("ale", "beer", "mixing", 0.0), ("cola", "dew", "mixing-paper", 1e-6)],
    ],
)
def test_nothing_is_kept_out_of_the_momentum(tmp_path, couplings):
    found = plan(tmp_path, couplings)
    assert not found.drifts
    if couplings:
        drifting = {n for one, other, _, d in couplings if d for n in (one, other)}
        assert [n in drifting for n in NAMES] == found.rules.drifting.tolist()
        assert not np.any(found.rules.drifting_apart)


@pytest.mark.parametrize(
    "said, numbers",
    [
        (r"\|v\| / \((\S+) dx\)", (limits.FARTHEST,)),
        (r"\|tr C\| / (\S+) ", (limits.STRETCH,)),
        (r"when J leaves (\S+) \.\. (\S+),", (limits.LEAST_J, limits.MOST_J)),
        (r"A node lighter than (\S+) of a\s+full cell stays at rest", (limits.ROUNDING,)),
        (r"one lighter than (\S+) takes no part in contact", (limits.TOUCHING,)),
    ],
)
def test_the_theory_tells_the_same_limits(said, numbers):
    (found,) = re.findall(said, THEORY)
    found = found if isinstance(found, tuple) else (found,)
    assert tuple(map(float, found)) == numbers
