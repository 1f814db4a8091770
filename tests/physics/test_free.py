"""What contact must not do: hold bodies that part, or depend on how bodies are numbered.

Exact: bodies that are pulled apart move as if each were alone; names in another order give the same
positions, also where three and four bodies share nodes. Tolerance: 1e-12 dx in double precision,
for rounding. Among bodies of one family the larger gives the normals, of twins the one that lay
farther west, south or down at the start.
"""

import itertools

import numpy as np
import pytest

from tests.support.simulate import advance, begin, by_id
from tests.support.validation_record import held

DX = 0.02
HEAD = """
[accuracy]
precision = "double"
[domain]
size = [0.48, 0.32, 0.32]
cell = 0.02
gravity = [0, 0, GRAVITY]
[time]
end = 1
dt = 2e-4
[material.rubber]
kind = "elastic"
density = 1000
youngs_modulus = 2e5
[material.sand]
kind = "sand"
youngs_modulus = 2e5
[material.snow]
kind = "snow"
[material.water]
kind = "fluid"
tait_coefficient = 2e4
"""
BODY = """
[[object]]
name = "{name}"
material = "{material}"
phase = "{name}"
shape = {{ box = {box} }}
velocity = {velocity}
"""


def positions(folder, bodies, gravity, end):
    """Positions (n, 3) [m] per body, in the order given. bodies: (name, material, box, velocity,
    more keys)."""
    text = HEAD.replace("GRAVITY", str(gravity))
    for name, material, box, velocity, more in bodies:
        text += BODY.format(name=name, material=material, box=box, velocity=velocity) + more
    simulation, made = begin(folder, text)
    advance(simulation, end)
    (x,) = by_id(simulation, "x")
    return [x[made.object == k] for k in range(len(bodies))]


# along the faces that part
WAVE = "velocity_mode = { amplitude = [0, 0.02, 0.01], wave_vector = [0, 30, 10] }\n"
PARTING = [
    ("one", "rubber", "[[0.1, 0.04, 0.06], [0.2, 0.16, 0.14]]", "[-0.5, 0, 0]", WAVE),
    ("two", "rubber", "[[0.2, 0.06, 0.06], [0.3, 0.1, 0.14]]", "[0.5, -0.2, 0]", WAVE),
    ("three", "rubber", "[[0.2, 0.1, 0.06], [0.28, 0.14, 0.14]]", "[0.5, 0.2, 0]", ""),
]
WIDE = ("two", "rubber", "[[0.2, 0.04, 0.06], [0.3, 0.16, 0.14]]", "[0.5, -0.2, 0]", WAVE)


def disturbed(folder, bodies):
    """Largest distance [cells] of a particle from where it is when its body is alone."""
    together, worst = positions(folder, bodies, 0, 0.05), 0.0
    for k in range(len(bodies)):
        (alone,) = positions(folder, bodies[k : k + 1], 0, 0.05)
        worst = max(worst, np.abs(together[k] - alone).max() / DX)
    return worst


@pytest.mark.parametrize("count", [2, 3])
def test_pull_off(tmp_path, count):
    """They touch at the start, with friction .3; two swing a little while they part. Three are
    stiff: two of them share edges, see below."""
    bodies = PARTING[:2] if count == 2 else [(*body[:4], "") for body in PARTING]
    held(
        f"pull-off of {count} bodies",
        disturbed(tmp_path, bodies),
        0.0,
        1e-12,
        kind="absolute",
        unit="cells",
        source="separating bodies are free",
        note="1 m/s, 4 cells and more, double precision",
    )


def test_pull_off_askew(tmp_path):
    """Two faces whose edges coincide slide while they part: a node beyond both edges sees a normal
    that leans outwards, and takes the slide for an approach. A limit of normals that nodes find for
    themselves; small, since such nodes carry little mass."""
    held(
        "pull-off askew, along a common edge",
        disturbed(tmp_path, [PARTING[0], WIDE]),
        0.0,
        0.005,
        kind="absolute",
        unit="cells",
        source="separating bodies are free",
        note="parting at 1 m/s, sliding at 0.2 m/s",
    )


THREE = [
    ("rubber", "[[0.1, 0.1, 0.1], [0.2, 0.22, 0.2]]", "[0.6, 0.1, 0]"),
    ("rubber", "[[0.2, 0.1, 0.1], [0.3, 0.16, 0.2]]", "[-0.6, 0.3, 0.05]"),
    ("rubber", "[[0.2, 0.16, 0.1], [0.3, 0.22, 0.22]]", "[-0.7, -0.3, 0]"),
]
FOUR = [
    THREE[0],
    ("sand", *THREE[1][1:]),
    ("snow", *THREE[2][1:]),
    ("water", "[[0.08, 0.08, 0.0], [0.32, 0.24, 0.1]]", "[0, 0, 0.5]"),
]


TWINS = [
    ("rubber", "[[0.1, 0.1, 0.1], [0.2, 0.2, 0.2]]", "[0.6, 0.2, 0.1]"),
    ("rubber", "[[0.2, 0.14, 0.12], [0.3, 0.24, 0.22]]", "[-0.6, -0.1, 0]"),
    ("rubber", "[[0.12, 0.12, 0.2], [0.22, 0.22, 0.3]]", "[0.1, 0, -0.6]"),
]


@pytest.mark.parametrize(
    "bodies", [THREE, TWINS, FOUR], ids=["three solids", "twins", "four families"]
)
def test_renumbered(tmp_path, bodies):
    """They meet along an edge; every order of their names (of four: every third)."""
    orders = list(itertools.permutations("abcd"[: len(bodies)]))
    first, worst = None, 0.0
    for names in orders[:: 1 if len(bodies) == 3 else 3]:
        named = [(name, *body, "") for name, body in zip(names, bodies, strict=True)]
        found = np.concatenate(positions(tmp_path, named, -9.8, 0.06))
        first = found if first is None else first
        worst = max(worst, np.abs(found - first).max() / DX)
    held(
        f"{'3 twins' if bodies is TWINS else f'{len(bodies)} bodies'} renumbered",
        worst,
        0.0,
        1e-12,
        kind="absolute",
        unit="cells",
        source="results do not depend on numbering",
        note="head-on at 1.2 m/s, sharing nodes along an edge, double precision",
    )


def test_they_do_meet(tmp_path):
    """The same bodies, each alone, end elsewhere: the tests above test contact."""
    named = [(name, *body, "") for name, body in zip("abc", THREE, strict=True)]
    together = positions(tmp_path, named, -9.8, 0.06)
    for k in range(3):
        (alone,) = positions(tmp_path, named[k : k + 1], -9.8, 0.06)
        assert np.abs(together[k] - alone).max() > 0.2 * DX
