"""Cases of the board: what is simulated, when it is looked at, and how its error is measured.

All solvers fill the same box at rest in the same tank, and the same code measures what they return.
This module needs numpy alone, since it also runs in the environments of other solvers.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .board_state import GRAVITY, BoardState, Edges, Measure
from .jet_and_block import (
    BLOCK_CORNER,
    BLOCK_EDGES,
    BLOCK_POOL,
    BLOCK_SIDES,
    BLOCK_TANK,
    JET_BODY,
    JET_CORNER,
    JET_TANK,
    BlockMeasure,
    JetMeasure,
    jet_velocity,
)

# front of a collapsing column, t sqrt(2 g / L) and front / L: Koshizuka and Oka 1996, by MPS
MPS_FRONT = np.array(
    [[0.591, 1.205], [0.958, 1.512], [1.381, 1.931], [1.858, 2.48], [2.278, 3.004], [2.604, 3.481],
     [2.752, 3.7]]
)  # fmt: skip
SAND_ANGLE = 31.0  # [deg] slope at rest of quartz sand, Lube et al. 2005
SAND_RUN_OUT = 1.2  # [-] of the column's length, Lube et al. 2005 between walls
SAND_DENSITY = 1590.0  # [kg/m3] in bulk
ELASTIC_DENSITY = 1000.0  # [kg/m3] of bar and beam
BAR_MODULUS, BAR_SPEED = 1e5, 1e-2  # [Pa], [m/s]
# [Pa], [m] of the part of the beam that hangs, of its height and of the part in its clamp
BEAM_MODULUS, BEAM_LENGTH, BEAM_HEIGHT, BEAM_CLAMP = 5e7, 1.0, 0.125, 0.125
SHEAR_FACTOR = 5 / 6  # [-] Timoshenko's, of a rectangle whose Poisson ratio is zero
# [m/s], [m], [Pa s], [Pa] of the liquid with vortices: speed, edge, viscosity, bulk modulus
VORTEX_SPEED, VORTEX_EDGE, VORTEX_VISCOSITY, VORTEX_BULK_MODULUS = 0.01, 0.1, 1.0, 1400.0
LEVEL_START = 3.0  # [s] from which on the level is averaged
SLICES = 16  # of the tank, in which the level is measured


@dataclass(frozen=True)
class BoardCase:
    """One case.

    Attributes:
        title: What its error is, for tables.
        body: Edges of the box that is filled [m].
        tank: Edges of the tank [m], None without walls.
        end: Simulated time [s].
        interval: Time between two records [s].
        measure: Makes the measure of a run: volumes of the particles (n,) [m3], their first
            positions (n, 3) [m], cell [m].
        resolution: Error below which the reference cannot tell two runs apart.
        family: fluid, sand or elastic.
        gravity: Acceleration downwards [m/s2].
        modulus: Young's modulus of an elastic body [Pa]; its Poisson ratio is zero.
        clamp: Length at the body's lower end in x that is held [m].
        viscosity: Of a fluid [Pa s].
        bulk_modulus: Of a fluid [Pa]; 0 leaves it to the solver.
        closed: Whether the tank has a lid that holds the fluid.
        velocity: Returns the initial velocities (n, 3) [m/s] and their gradients (n, 3, 3) [1/s]
            at positions (n, 3) [m]; None at rest.
        corner: Lower corner of the box that is filled, from that of the tank [m].
        more: Further boxes that are filled, each its edges and its corner [m].
        block: Edges and corner of a body of BLOCK_DENSITY that floats [m].
    """

    title: str
    body: Edges
    tank: Edges | None
    end: float
    interval: float
    measure: Callable[[np.ndarray, np.ndarray, float], Measure]
    resolution: float = 0.0
    family: str = "fluid"
    gravity: float = GRAVITY
    modulus: float = 0.0
    clamp: float = 0.0
    viscosity: float = 0.0
    bulk_modulus: float = 0.0
    closed: bool = False
    velocity: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]] | None = None
    corner: Edges = (0.0, 0.0, 0.0)
    more: tuple[tuple[Edges, Edges], ...] = ()
    block: tuple[Edges, Edges] | None = None

    def boxes(self) -> tuple[tuple[Edges, Edges], ...]:
        """Return edges and corner of each box that is filled [m]."""
        return ((self.body, self.corner), *self.more)


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
    FREQUENCY = float(np.sqrt(BAR_MODULUS / ELASTIC_DENSITY)) / (2 * LENGTH)  # [Hz]

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


def beam_sag(x: np.ndarray) -> np.ndarray:
    """Return how far a beam sinks under its weight at distances x (n,) from its clamp [m].

    Euler and Bernoulli's deflection and Timoshenko's of shear.
    """
    load, length = ELASTIC_DENSITY * GRAVITY * BEAM_HEIGHT**2, BEAM_LENGTH  # [N/m], [m]
    bending = BEAM_MODULUS * BEAM_HEIGHT**4 / 12
    shear = SHEAR_FACTOR * BEAM_MODULUS / 2 * BEAM_HEIGHT**2
    sag = load * x**2 * (6 * length**2 - 4 * length * x + x**2) / (24 * bending)
    return sag + load * (length * x - x**2 / 2) / shear


class BeamMeasure:
    """Mean deflection of the tip of a beam that swings about its rest, against beam theory.

    Gravity acts from the start, so that the beam swings about the deflection it would have at rest.
    The mean is weighted by Hann's window over the run, three periods of the first mode: a period
    that is off by 5 % changes it by 0.5 %. The tip is the last quarter of a height. What particles
    inside the clamp sink is subtracted.
    """

    def __init__(self, volume: np.ndarray, x: np.ndarray, cell: float):
        self.tip = x[:, 0] > BEAM_CLAMP + BEAM_LENGTH - BEAM_HEIGHT / 4
        self.inside = x[:, 0] < BEAM_CLAMP - cell
        self.height = self._tip_height(x)
        self.theory = float(beam_sag(x[self.tip, 0] - BEAM_CLAMP).mean())
        self.rows: list[tuple[float, float]] = []

    def record(self, now: BoardState) -> None:
        """Record the deflection over that of theory."""
        self.rows.append((now.t, (self.height - self._tip_height(now.x)) / self.theory))

    def _tip_height(self, x: np.ndarray) -> float:
        """Return the height of the tip over the particles inside the clamp, if there are any."""
        z = x[:, 2].astype(np.float64)
        return float(z[self.tip].mean() - (z[self.inside].mean() if self.inside.any() else 0.0))

    def result(self) -> dict[str, float]:
        """Return the mean deflection over the right one, and its error."""
        t, sag = np.array(self.rows).T
        value = float(np.average(sag, weights=np.sin(np.pi * t / t[-1]) ** 2))
        return {"error": abs(value - 1), "deflection": value}


class VortexMeasure:
    """Rate at which the kinetic energy of vortices decays, over that of Taylor and Green.

    The energy is that of the particles' velocities. The first record does not count: a transfer may
    change the energy that was given in the first step, whatever the viscosity.
    """

    RATE = 4 * VORTEX_VISCOSITY / 1000.0 * (np.pi / VORTEX_EDGE) ** 2  # [1/s]

    def __init__(self, volume: np.ndarray, x: np.ndarray, cell: float):
        self.volume = volume
        self.rows: list[tuple[float, float]] = []

    def record(self, now: BoardState) -> None:
        """Record twice the kinetic energy over the density."""
        speed_squared = (now.v.astype(np.float64) ** 2).sum(axis=1)
        self.rows.append((now.t, float((self.volume * speed_squared).sum())))

    def result(self) -> dict[str, float]:
        """Return the rate of the exponential through the records over the right one, its error."""
        t, energy = np.array(self.rows[1:]).T
        decay = float(-np.polyfit(t, np.log(energy), 1)[0] / self.RATE)
        return {"error": abs(decay - 1), "decay": decay}


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


def bar_velocity(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return velocities [m/s] and gradients [1/s] of the bar's mode at positions x (n, 3) [m]."""
    k = np.pi / BarMeasure.LENGTH
    v, gradient = np.zeros((len(x), 3)), np.zeros((len(x), 3, 3))
    v[:, 0] = BAR_SPEED * np.cos(k * x[:, 0])
    gradient[:, 0, 0] = -BAR_SPEED * k * np.sin(k * x[:, 0])
    return v, gradient


def vortex_velocity(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return velocities [m/s] and gradients [1/s] of Taylor-Green vortices at x (n, 3) [m]."""
    k = np.pi / VORTEX_EDGE
    sine, cosine = np.sin(k * x[:, ::2]), np.cos(k * x[:, ::2])
    v, gradient = np.zeros((len(x), 3)), np.zeros((len(x), 3, 3))
    v[:, 0] = VORTEX_SPEED * sine[:, 0] * cosine[:, 1]
    v[:, 2] = -VORTEX_SPEED * cosine[:, 0] * sine[:, 1]
    gradient[:, 0, 0] = k * VORTEX_SPEED * cosine[:, 0] * cosine[:, 1]
    gradient[:, 0, 2] = -k * VORTEX_SPEED * sine[:, 0] * sine[:, 1]
    gradient[:, 2, 0], gradient[:, 2, 2] = -gradient[:, 0, 2], -gradient[:, 0, 0]
    return v, gradient


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
        "elastic", 0.0, BAR_MODULUS, velocity=bar_velocity),
    "cantilever": BoardCase(
        "beam under its weight: deflection", (BEAM_CLAMP + BEAM_LENGTH, BEAM_HEIGHT, BEAM_HEIGHT),
        None, 0.68, 0.01, BeamMeasure, 0.01, "elastic", GRAVITY, BEAM_MODULUS, BEAM_CLAMP),
    "vortices": BoardCase(
        "vortices that die out: decay of energy", (VORTEX_EDGE, 0.025, VORTEX_EDGE),
        (VORTEX_EDGE, 0.025, VORTEX_EDGE), 0.25, 0.025, VortexMeasure, 5e-3, gravity=0.0,
        viscosity=VORTEX_VISCOSITY, bulk_modulus=VORTEX_BULK_MODULUS, closed=True,
        velocity=vortex_velocity),
    "jet": BoardCase(
        "jet on a plate: force", JET_BODY, JET_TANK, 0.25, 1 / 120, JetMeasure, 0.02, gravity=0.0,
        velocity=jet_velocity, corner=JET_CORNER),
    "block": BoardCase(
        "block that floats: draught", BLOCK_POOL, BLOCK_TANK, 2.0, 0.05, BlockMeasure, 0.03,
        more=BLOCK_SIDES, block=(BLOCK_EDGES, BLOCK_CORNER)),
    "rest": BoardCase(
        "pool at rest", (0.4, 0.4, 0.08), (0.4, 0.4, 0.4), 0.1, 0.02, HeightMeasure),
    "splash": BoardCase(
        "column of water that splashes", (0.16, 0.4, 0.2), (0.4, 0.4, 0.4), 0.2, 0.02,
        HeightMeasure),
}  # fmt: skip
