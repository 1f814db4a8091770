"""Streams that fall out of an inlet stay whole: they thin as continuity asks, and their particles
do not gather in discs that part from each other.

A liquid that left at u and has the speed v has the radius R sqrt(u / v) (continuity). Particles
that leave in planes stay in planes, whose distances grow as v: after half a metre they are 2.5
cells apart, nothing acts between them, and the discs keep their radius.
"""

import numpy as np
import pytest

from tests.support.simulate import advance, begin, by_id, inlets_of
from tests.support.validation_record import held

DX, U, G, TOP, RADIUS = 0.01, 0.6, 9.81, 0.56, 0.02
MATERIALS = {
    "honey": 'preset = "honey"\nkind = "fluid"\nmax_speed = "3.5 m/s"',
    "water": 'preset = "water"\nkind = "fluid"\nmax_speed = "3.5 m/s"',
    "sand": 'preset = "dry sand"\nkind = "sand"\nyoungs_modulus = "50 kPa"',
}
SCENE = f"""
[accuracy]
pressure = "explicit"
[domain]
size = [0.12, 0.12, 0.6]
cell = {DX}
gravity = [0, 0, {-G}]
boundary = "open"
[time]
end = 0.4
[material.poured]
MATERIAL
[[inlet]]
name = "spout"
material = "poured"
disc = {{ center = [0.06, 0.06, {TOP}], radius = {RADIUS} }}
speed = {U}
"""


def largest_gap(heights):
    """Largest distance between heights (n,) that follow each other, in mean distances."""
    gaps = np.diff(np.sort(heights))
    return gaps.max() / gaps.mean()


@pytest.mark.parametrize("material", MATERIALS)
def test_a_stream_stays_whole(tmp_path, material):
    simulation, _ = begin(tmp_path, SCENE.replace("MATERIAL", MATERIALS[material]))
    advance(simulation, 0.36)
    x, v = by_id(simulation, "x", "v")
    fall = TOP - x[:, 2]
    here = (fall > 0.4) & (fall < 0.5)
    assert here.sum() > 180
    held(
        f"Largest gap in a stream of {material}", largest_gap(fall[here]), 1.0, 4.0, kind="below",
        unit="mean spacings of particles along it", source="evenly spaced: 1",
        note="after a fall of 40 to 50 cells, 4 cells across at the mouth",
    )  # fmt: skip
    if material == "sand":
        return
    (inlet,) = inlets_of(simulation.plan)
    away = x[here, :2] - x[here, :2].mean(axis=0)
    radius = np.sqrt(2 * (away**2).sum(axis=1).mean())
    mouth = np.sqrt(len(inlet.mouth) / np.pi) * inlet.spacing
    expected = mouth * np.sqrt(U / -v[here, 2].mean())
    held(
        f"Radius of a stream of {material}", radius * 1e3, expected * 1e3, 0.05, unit="mm",
        source="continuity: R sqrt(u / v)", note="after a fall of 40 to 50 cells",
    )  # fmt: skip
