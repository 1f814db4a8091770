"""Volume of splashed liquids: level, crowding and energy of a broken dam, by volume correction.

A column collapses in a closed tank and sways for some seconds. Theory: whatever the motion, a
liquid of volume V at rest has the level V / A, and no part of it is denser than at the start. While
the liquid sways its center of mass stands higher by as much as its kinetic energy lifts it: the
level is corrected for that.
"""

import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tests.support.simulate import advance, begin, by_id, totals

TANK = 0.64, 0.16, 0.40  # [m] inner size
COLUMN = 0.2, 0.32  # [m] width and height; the depth is the tank's
SCENE = """
[domain]
size = [{size[0]}, {size[1]}, {size[2]}]
cell = {cell!r}
{gravity}
[time]
end = 1000
[accuracy]
pressure = "explicit"
precision = "single"
volume_correction = "{correction}"
[material.water]
kind = "fluid"
tait_coefficient = "60 kPa"
[[object]]
name = "column"
material = "water"
shape = {{ box = [[0, 0, 0], [{column[0]}, {size[1]}, {column[1]}]] }}
"""
SPANS = (3.0, 5.0), (5.0, 10.0), (16.0, 20.0), (48.0, 60.0)  # [s] means are taken over these
INTERVAL = 0.1  # [s] between two measurements
GRAVITY = 9.80665


class VolumeSample(NamedTuple):
    """Measures of a liquid at one time."""

    time: float  # [s]
    level: float  # [-] level over that at rest, less what the kinetic energy lifts
    lowest: float  # [-] density of the lowest layer of cells, over that at the start
    lower_half: float  # [-] density of the lower half of the liquid
    fullest: float  # [-] largest fullness of a node's cell
    surface: float  # [cells] mean height over which the fill of slabs falls from 0.9 to 0.1
    energy: float  # [J]


def nodal_fullness(x: np.ndarray, volume: np.ndarray, cells: tuple, dx: float) -> np.ndarray:
    """Return the fullness of all nodes: volume by quadratic B-splines, mirrored at the walls.

    Args:
        x: Positions, shape (n, 3) [m].
        volume: Rest volumes, shape (n,) [m3].
        cells: Cells of the domain.
        dx: Cell size [m].
    """
    shape = tuple(n + 3 for n in cells)  # one node beyond each wall
    base = np.floor(x / dx - 0.5).astype(int)
    inside = x / dx - base
    weights = [0.5 * (1.5 - inside) ** 2, 0.75 - (inside - 1.0) ** 2, 0.5 * (inside - 0.5) ** 2]
    out = np.zeros(shape)
    for i, j, k in np.ndindex(3, 3, 3):
        w = weights[i][:, 0] * weights[j][:, 1] * weights[k][:, 2]
        np.add.at(out, tuple((base + 1 + (i, j, k)).T), w * volume / dx**3)
    for axis, n in enumerate(cells):
        along = np.moveaxis(out, axis, 0)
        along[2] += along[0]
        along[n] += along[n + 2]
        along[[1, n + 1]] *= 2.0
    return out[1:-1, 1:-1, 1:-1]


def surface_thickness(x: np.ndarray, volume: np.ndarray, size: np.ndarray, dx: float) -> float:
    """Return the mean height over which the fill of slabs falls from 0.9 to 0.1 [cells].

    A slab is two cells long and as deep as the tank, so that a swaying surface counts little.

    Args:
        x: Positions, shape (n, 3) [m].
        volume: Rest volumes, shape (n,) [m3].
        size: Size of the tank, shape (3,) [m].
        dx: Cell size [m].
    """
    layer, count = 0.25 * dx, round(size[0] / (2 * dx))
    layers = int(np.ceil(x[:, 2].max() / layer)) + 4
    bins = [np.linspace(0.0, size[0], count + 1), layer * np.arange(layers + 1)]
    fill = np.histogram2d(x[:, 0], x[:, 2], bins, weights=volume)[0] / (2 * dx * size[1] * layer)
    heights, found = layer * (np.arange(layers) + 0.5), []
    for slab in fill:
        smooth = np.convolve(slab, np.full(4, 0.25), mode="same")
        full, some = heights[smooth > 0.9], heights[smooth > 0.1]
        if len(full):
            found.append((some.max() - full.max()) / dx)
    return float(np.mean(found))


def measure(simulation, volume: np.ndarray, density: float) -> VolumeSample:
    """Return the measures of the liquid as it stands.

    Args:
        simulation: The simulation.
        volume: Rest volumes by id, shape (n,) [m3].
        density: Density of the liquid [kg/m3].
    """
    plan = simulation.plan
    x, v = by_id(simulation, "x", "v")
    size = np.array(plan.cells) * plan.dx
    area = size[0] * size[1]
    level = volume.sum() / area
    kinetic = 0.5 * density * (volume * (v**2).sum(1)).sum()
    potential = 0.5 * density * volume.sum() * GRAVITY * level
    height = 2.0 * (volume * x[:, 2]).sum() / volume.sum() / level
    return VolumeSample(
        simulation.time,
        float(height - kinetic / potential),
        float(volume[x[:, 2] < plan.dx].sum() / (area * plan.dx)),
        float(volume[x[:, 2] < level / 2].sum() / (area * level / 2)),
        float(nodal_fullness(x, volume, plan.cells, plan.dx).max()),
        surface_thickness(x, volume, size, plan.dx),
        float(totals(simulation)["energy"]),
    )


class DamBreak(NamedTuple):
    """Outcome of a broken dam."""

    samples: list[VolumeSample]  # every 0.1 s
    seconds: float  # [s] processor time


def dam_break(correction: str, cells: int, end: float) -> DamBreak:
    """Break a dam and measure its liquid.

    Args:
        correction: `accuracy.volume_correction`.
        cells: Cells along the tank.
        end: Time [s].
    """
    text = SCENE.format(
        size=TANK, column=COLUMN, cell=TANK[0] / cells, correction=correction, gravity=""
    )
    with tempfile.TemporaryDirectory() as folder:
        simulation, made = begin(Path(folder), text)
    samples, started = [measure(simulation, made.vol0, 1000.0)], time.process_time()
    for goal in np.arange(INTERVAL, end + INTERVAL / 2, INTERVAL):
        advance(simulation, float(goal))
        samples.append(measure(simulation, made.vol0, 1000.0))
    return DamBreak(samples, time.process_time() - started)


def splashing(cells: int, accuracy: str = ""):
    """Return the simulation of a broken dam after 1 s, as it splashes.

    Args:
        cells: Cells along the tank.
        accuracy: Further keys of [accuracy].
    """
    text = SCENE.format(
        size=TANK, column=COLUMN, cell=TANK[0] / cells, correction="shifting", gravity=""
    )
    text = text.replace("[material.water]", f"{accuracy}\n[material.water]")
    with tempfile.TemporaryDirectory() as folder:
        simulation, _ = begin(Path(folder), text)
    advance(simulation, 1.0)
    return simulation


def turns(simulations, intervals, rounds: int, steps: int) -> list[float]:
    """Return the ratios of the processor time of the second one's steps to the first one's.

    Args:
        simulations: Two simulations of liquids that are shifted.
        intervals: Steps between two shifts, 0: never; set before its turn.
        rounds: Number of pairs.
        steps: Steps of each turn.
    """
    ratios = []
    for _ in range(rounds):
        seconds = []
        for simulation, interval in zip(simulations, intervals, strict=True):
            simulation.features["shifting"].correction_interval = interval
            started = time.thread_time()
            for _ in range(steps):
                simulation.advance(0.9 * simulation.bound())
            seconds.append(time.thread_time() - started)
        ratios.append(seconds[1] / seconds[0])
    return ratios


def interval_of(simulation) -> int:
    """Return the number of steps between two shifts."""
    return simulation.features["shifting"].correction_interval


def dilatation_cost(cells: int, rounds: int, steps: int = 60) -> list[float]:
    """Return the ratios of a step's processor time with the dilatation by cells to that without."""
    both = [splashing(cells), splashing(cells, 'dilatation = "cells"')]
    return turns(both, [interval_of(one) for one in both], rounds, steps)


def step_cost(cells: int, rounds: int, steps: int = 60) -> list[float]:
    """Return the ratios of a step's processor time with shifting to that without, in turns.

    The liquid splashes; both make the same steps of the transfer correction.
    """
    one = splashing(cells)
    return turns([one, one], [0, interval_of(one)], rounds, steps)


def rows(correction: str, cells: int, samples: list[VolumeSample]) -> list[str]:
    """Return the rows of the table, one per span of time that the samples cover."""
    result = []
    for low, high in SPANS:
        span = [s for s in samples if low - 1e-6 <= s.time <= high + 1e-6]
        if span and samples[-1].time >= high - 1e-6:
            level, lowest, half = (
                np.mean([getattr(s, name) for s in span])
                for name in ("level", "lowest", "lower_half")
            )
            thick = np.mean([s.surface for s in span])
            fullest = np.mean([s.fullest for s in span])
            result.append(
                f"| {correction} | {cells} | {low:g} .. {high:g} s | {100 * (level - 1):+.1f} % |"
                f" {lowest:.3f} | {half:.3f} | {fullest:.2f} | {thick:.1f} |"
            )
    return result


def run(corrections: list[str], cells: int, end: float) -> None:
    """Print the table of the corrections.

    Args:
        corrections: Values of `accuracy.volume_correction`.
        cells: Cells along the tank.
        end: Time [s].
    """
    print("| correction | cells | time | level | lowest layer | lower half | fullest | surface |")
    print("|---|---|---|---|---|---|---|---|")
    for correction in corrections:
        outcome = dam_break(correction, cells, end)
        samples = outcome.samples
        print("\n".join(rows(correction, cells, samples)), flush=True)
        energies = [s.energy for s in samples]
        print(
            f"# {correction}: fullest ever {max(s.fullest for s in samples):.2f}, energy over that"
            f" at the start at most {max(energies) / energies[0] - 1:+.1%}, {outcome.seconds:.0f} s"
        )
