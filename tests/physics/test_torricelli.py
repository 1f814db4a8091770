"""A tank that empties through a slit in its floor: Torricelli's law and the coefficient of an edge.

Exact: water leaves as if it fell from the surface, v = sqrt(2 g h) (Torricelli), and the jet of a
slit with a sharp edge in a wide wall contracts to Cc = pi / (pi + 2) = .611 of it (Kirchhoff 1869);
where the jet is r times as wide as the tank, 1 / Cc = 1 + 2 / pi (1 / r - r) arctan r (von Mises
1917), and the tank's water moves, too: Q = Cd A sqrt(2 g h), Cd = Cc / sqrt(1 - r^2), .62 and .64
here. What has a sharp edge has .6 to .7, a tube .8. In the plane: four cells deep, and the wall in
the middle of the slit is its plane of symmetry. The floor is a rigid plate three cells thick, less
than half of the slit: what has passed its upper edge does not come near it again.
"""

from typing import NamedTuple

import numpy as np
import pytest

from tests.support import draining_tank
from tests.support.draining_tank import DX
from tests.support.simulate import advance, begin, by_id
from tests.support.validation_record import held

G, DEEP, FLOOR = 9.8, 4, 20
SLIT = "box = [[{half}, -0.1, {under}], [{beyond}, 1, {floor}]]"


class Tank(NamedTuple):
    """Cells, from the plane of symmetry; [s]."""

    half: int  # of the slit
    wide: int
    head: int
    begins: float
    end: float


class Found(NamedTuple):
    """What came out of a tank."""

    times: np.ndarray  # [s]
    level: np.ndarray  # [m]
    counted: np.ndarray  # [m2] that went, by the ledger
    remaining: np.ndarray  # [m2] that did not yet
    speed: float  # of the jet where it is thinnest, over Torricelli's


def drained(folder, tank: Tank) -> Found:
    text = draining_tank.text(
        SLIT, "double", tank.end, FLOOR, tank.head, wide=tank.wide, deep=DEEP, half=tank.half,
        beyond=tank.wide + 10,
    )  # fmt: skip
    simulation, _ = begin(folder, text)
    rows, fast = [], []
    for time in np.arange(tank.begins, tank.end + 1e-9, 0.01):
        advance(simulation, time)
        x, v, vol0, J = by_id(simulation, "x", "v", "vol0", "J")
        volume, low = vol0 * J / (DEEP * DX), FLOOR * DX - x[:, 2]
        level = volume[low < 0].sum() / (tank.wide * DX)
        ((_, _, _, went),) = simulation.features["inlets_outlets"].flow.totals()
        out = simulation.features["inlets_outlets"].flow.mass(0, went) / 1000 / (DEEP * DX)
        rows.append((time, level, out, vol0.sum() / (DEEP * DX)))
        thin = (low > tank.half * DX) & (low < 1.5 * tank.half * DX)
        fast.append((-v[thin, 2] / np.sqrt(2 * G * (level + low[thin]))).mean())
    times, level, out, remaining = np.array(rows).T
    return Found(times, level, out, remaining, float(np.mean(fast)))


def coefficient(tank: Tank, found: Found) -> float:
    """Cd by the level's fall: d sqrt(h) / dt = -Cd (A / area) sqrt(g / 2)."""
    slope = np.polyfit(found.times, np.sqrt(found.level), 1)[0]
    return float(-slope * tank.wide / tank.half / np.sqrt(G / 2))


def exact(tank: Tank) -> float:
    """Cd of von Mises: the r for which the slit's part of the floor is r / Cc."""
    low, high = 1e-6, 1.0
    for _ in range(60):
        r = (low + high) / 2
        turns = 1 + 2 / np.pi * (1 / r - r) * np.arctan(r)
        low, high = (r, high) if r * turns < tank.half / tank.wide else (low, r)
    return float(1 / turns / np.sqrt(1 - r * r))


CASES = {
    "16 cells": Tank(8, 24, 36, 0.14, 0.26),
    "16 cells, wide tank": Tank(8, 40, 64, 0.24, 0.44),
    "8 cells": Tank(4, 20, 32, 0.2, 0.36),
}


@pytest.fixture(scope="module")
def emptied(request, tmp_path_factory):
    return request.param, drained(tmp_path_factory.mktemp("tank"), CASES[request.param])


def tanks():
    """The tanks; the two that take longest are slow."""
    short, *others = CASES
    rows = [short, *(pytest.param(name, marks=pytest.mark.slow) for name in others)]
    return pytest.mark.parametrize("emptied", rows, indirect=True)


def about(tank: Tank, found: Found) -> str:
    first, last = found.level[[0, -1]] / DX
    return f"tank of 2 x {tank.wide} cells, head {first:.0f} to {last:.0f} cells"


@tanks()
def test_what_goes_is_counted(emptied):
    name, found = emptied
    whole = CASES[name].wide * CASES[name].head * DX**2
    assert np.abs(found.counted + found.remaining - whole).max() < 1e-9 * whole


@tanks()
def test_speed_of_the_jet(emptied):
    name, found = emptied
    held(
        f"Speed of a jet, slit of {name}", found.speed, 1.0, 0.05, unit="sqrt(2 g h)",
        source="Torricelli", note=about(CASES[name], found) + "; mean where it is thinnest",
    )  # fmt: skip


@tanks()
def test_discharge_coefficient(emptied):
    name, found = emptied
    value = coefficient(CASES[name], found)
    held(
        f"Discharge coefficient, slit of {name}", value, exact(CASES[name]), 0.04,
        source="Kirchhoff 1869, von Mises 1917; published: .6 to .7",
        note=about(CASES[name], found),
        curves={"level": (found.times, found.level)}, axes=("time [s]", "level above the slit [m]"),
    )  # fmt: skip
    assert 0.6 < value < 0.7
