"""Cases of the board: what is simulated, when it is looked at, and how its error is measured.

All solvers fill the same box at rest in the same tank, and the same code measures what they return.
This module needs numpy alone, since it also runs in the environments of other solvers.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

GRAVITY = 9.8  # [m/s2]
# front of a collapsing column, t sqrt(2 g / L) and front / L: Koshizuka and Oka 1996, by MPS
MPS_FRONT = np.array(
    [[0.591, 1.205], [0.958, 1.512], [1.381, 1.931], [1.858, 2.48], [2.278, 3.004], [2.604, 3.481],
     [2.752, 3.7]]
)  # fmt: skip
SAND_ANGLE = 31.0  # [deg] slope at rest of quartz sand, Lube et al. 2005
SAND_RUN_OUT = 1.2  # [-] of the column's length, Lube et al. 2005 between walls
SAND_DENSITY = 1590.0  # [kg/m3] in bulk
BAR_MODULUS, BAR_DENSITY, BAR_SPEED = 1e5, 1000.0, 1e-2  # [Pa], [kg/m3], [m/s]
LEVEL_START = 3.0  # [s] from which on the level is averaged
SLICES = 16  # of the tank, in which the level is measured


class BoardState(NamedTuple):
    """State of all particles.

    Attributes:
        t: Time [s].
        x: Positions from the tank's corner, shape (n, 3) [m].
        v: Velocities, shape (n, 3) [m/s].
    """

    t: float
    x: np.ndarray
    v: np.ndarray


class Measure(Protocol):
    """Record of a run, from which its error follows."""

    def record(self, now: BoardState) -> None:
        """Record a state."""

    def result(self) -> dict[str, float]:
        """Return the quantities of the run; `error`, if there is one, is compared."""


@dataclass(frozen=True)
class BoardCase:
    """One case.

    Attributes:
        title: What its error is, for tables.
        body: Edges of the box that is filled, from the tank's corner (0, 0, 0) on [m].
        tank: Edges of the tank [m], None without walls.
        end: Simulated time [s].
        interval: Time between two records [s].
        measure: Makes the measure of a run: volumes of the particles (n,) [m3], their first
            positions (n, 3) [m], cell [m].
        resolution: Error below which the reference cannot tell two runs apart.
        family: fluid, sand or elastic.
    """

    title: str
    body: tuple[float, float, float]
    tank: tuple[float, float, float] | None
    end: float
    interval: float
    measure: Callable[[np.ndarray, np.ndarray, float], Measure]
    resolution: float = 0.0
    family: str = "fluid"


class FrontMeasure:
    """Front of a collapsing column against the published curve [column widths, rms].

    The front is where water is as deep as a twenty-fourth of the column's width, between bins of a
    twelfth: neither depends on the cell, and neither lies on a layer of particles.
    """

    WIDTH, DEPTH, LENGTH = 0.146, 0.073, 0.584

    def __init__(self, volume: np.ndarray, x: np.ndarray, cell: float):
        self.volume = volume
        self.rows: list[tuple[float, float]] = []

    def record(self, now: BoardState) -> None:
        """Record the front."""
        bin_width, threshold = self.WIDTH / 12, self.WIDTH / 24
        index = np.clip((now.x[:, 0] / bin_width).astype(int), 0, 98)
        depth = np.bincount(index, self.volume, 100) / (bin_width * self.DEPTH)
        middle = int(self.WIDTH / 2 / bin_width)  # water may part from a wall
        dry = middle + int(np.argmax(depth[middle:] < threshold))
        front = self.LENGTH
        if dry < round(self.LENGTH / bin_width):
            step = max(depth[dry - 1] - depth[dry], 1e-12)
            front = (dry - 0.5 + (depth[dry - 1] - threshold) / step) * bin_width
        self.rows.append((now.t, front))

    def result(self) -> dict[str, float]:
        """Return the root mean square over the published times."""
        t, front = np.array(self.rows).T
        t = t / np.sqrt(self.WIDTH / (2 * GRAVITY))
        curve = MPS_FRONT[MPS_FRONT[:, 0] <= t[-1] + 1e-9]
        difference = np.interp(curve[:, 0], t, front / self.WIDTH) - curve[:, 1]
        return {"error": float(np.sqrt(np.mean(difference**2)))}


class LevelMeasure:
    """Level of water that sways in a closed tank against the level of its volume.

    The level is the mean over slices of twice the median height, over the time from LEVEL_START on:
    neither sway nor spray nor a surface drawn out over a cell changes it.
    """

    TANK, COLUMN = (0.32, 0.08, 0.32), (0.16, 0.2)
    LEVEL = COLUMN[0] * COLUMN[1] / TANK[0]

    def __init__(self, volume: np.ndarray, x: np.ndarray, cell: float):
        self.volume = volume
        self.rows: list[tuple[float, float, float]] = []

    def record(self, now: BoardState) -> None:
        """Record the level and the density of the lower half over its density at rest."""
        z = now.x[:, 2]
        slices = np.clip((now.x[:, 0] / self.TANK[0] * SLICES).astype(int), 0, SLICES - 1)
        heights = [
            2 * float(np.median(z[slices == k])) if (slices == k).any() else 0.0
            for k in range(SLICES)
        ]
        half_volume = self.TANK[0] * self.TANK[1] * self.LEVEL / 2
        lower = float(self.volume[z < self.LEVEL / 2].sum()) / half_volume
        self.rows.append((now.t, float(np.mean(heights)) / self.LEVEL, lower))

    def result(self) -> dict[str, float]:
        """Return the level over the right one, the density of the lower half, and the error."""
        t, level, lower = np.array(self.rows).T
        late = t >= LEVEL_START - 1e-3
        value = float(level[late].mean())
        return {"error": abs(value - 1), "level": value, "lower_half": float(lower[late].mean())}


class SandMeasure:
    """Run-out and height of a column of sand between walls, over its length."""

    LENGTH, WIDTH = 0.16, 0.08

    def __init__(self, volume: np.ndarray, x: np.ndarray, cell: float):
        self.volume, self.cell = volume, cell
        self.depth = np.zeros(1)

    def record(self, now: BoardState) -> None:
        """Record the depth of sand by cells along the floor."""
        index = np.clip((now.x[:, 0] / self.cell).astype(int), 0, 400)
        self.depth = np.bincount(index, self.volume, 402) / (self.cell * self.WIDTH)

    def result(self) -> dict[str, float]:
        """Return run-out and height at the wall, and the error of the run-out."""
        depth, threshold = self.depth, self.LENGTH / 40
        end = int(np.argmax(depth < threshold))
        share = (depth[end - 1] - threshold) / (depth[end - 1] - depth[end])
        run_out = float((end - 0.5 + share) * self.cell / self.LENGTH - 1)
        inner = max(1, round(self.LENGTH / self.cell / 10))
        height = float(depth[:inner].mean() / self.LENGTH)
        return {"error": abs(run_out / SAND_RUN_OUT - 1), "run_out": run_out, "height": height}


class BarMeasure:
    """Frequency of a free bar's first longitudinal mode, and energy lost in a period."""

    LENGTH = 1.0
    FREQUENCY = float(np.sqrt(BAR_MODULUS / BAR_DENSITY)) / (2 * LENGTH)  # [Hz]

    def __init__(self, volume: np.ndarray, x: np.ndarray, cell: float):
        self.mode = np.cos(np.pi * (x[:, 0] - x[:, 0].min()) / self.LENGTH)
        self.rows: list[tuple[float, float]] = []

    def record(self, now: BoardState) -> None:
        """Record the amplitude of the mode's velocity."""
        self.rows.append((now.t, float((now.v[:, 0] * self.mode).sum() / (self.mode**2).sum())))

    def result(self) -> dict[str, float]:
        """Return the frequency over the right one, its error, and the energy lost in a period."""
        t, a = np.array(self.rows).T
        index = np.flatnonzero(np.sign(a[1:]) != np.sign(a[:-1]))
        zero = t[index] + (t[index + 1] - t[index]) * a[index] / (a[index] - a[index + 1])
        if len(zero) < 4:
            raise ValueError("the bar vibrates for less than two periods")
        period = 2 * (zero[-1] - zero[0]) / (len(zero) - 1)
        bounds = np.searchsorted(t, zero)
        peaks = [np.abs(a[i:j]).max() for i, j in zip(bounds[:-1], bounds[1:])]
        rate = np.polyfit(0.5 * (zero[1:] + zero[:-1]), np.log(peaks), 1)[0]
        frequency = float(1 / period / self.FREQUENCY)
        loss = float(1 - np.exp(2 * rate * period))
        return {"error": abs(frequency - 1), "frequency": frequency, "energy_loss": loss}


class HeightMeasure:
    """Height of the centre of mass at the end [m]; there is no error, the case measures time."""

    def __init__(self, volume: np.ndarray, x: np.ndarray, cell: float):
        self.height = 0.0

    def record(self, now: BoardState) -> None:
        """Record the height."""
        self.height = float(now.x[:, 2].mean())

    def result(self) -> dict[str, float]:
        """Return the height."""
        return {"height": self.height}


CASES = {
    "dam_break": BoardCase(
        "dam break: front, rms in column widths", (0.146, 0.073, 0.292), (0.584, 0.073, 0.365),
        0.36, 0.02, FrontMeasure, 0.05),
    "level": BoardCase(
        "water that sways for 5 s: level", (0.16, 0.08, 0.2), (0.32, 0.08, 0.32), 5.0, 0.1,
        LevelMeasure, 0.005),
    "sand": BoardCase(
        "column of sand: run-out", (0.16, 0.08, 0.16), (0.56, 0.08, 0.24), 0.6, 0.1, SandMeasure,
        0.1, "sand"),
    "bar": BoardCase(
        "free bar: frequency", (1.0, 0.2, 0.2), None, 2.0, 1 / 200, BarMeasure, 1e-3,
        "elastic"),
    "rest": BoardCase(
        "pool at rest", (0.4, 0.4, 0.08), (0.4, 0.4, 0.4), 0.1, 0.02, HeightMeasure),
    "splash": BoardCase(
        "column of water that splashes", (0.16, 0.4, 0.2), (0.4, 0.4, 0.4), 0.2, 0.02,
        HeightMeasure),
}  # fmt: skip


def bar_velocity(x: np.ndarray) -> np.ndarray:
    """Return the initial velocity along the bar at places x (n,) from its end [m], in m/s."""
    return BAR_SPEED * np.cos(np.pi * x / BarMeasure.LENGTH)
