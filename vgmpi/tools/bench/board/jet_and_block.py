"""A jet on a plate and a block that floats: their boxes and their measures."""

import numpy as np

from .board_state import BoardState

# [m], [m/s] of the jet: edges and lower corner of the column, edges of the tank, speed downwards
JET_BODY, JET_CORNER = (0.05, 0.05, 0.4), (0.375, 0.375, 0.0)
JET_TANK, JET_SPEED = (0.8, 0.8, 0.45), 1.0
# [s] in which the force is steady: the impact is over, and the sheet has not reached the side walls
JET_START, JET_END = 0.15, 0.25
# [m], [kg/m3] of the block: edges, corner at the start, density; the tank; boxes of water, each its
# edges and its corner, that leave the block out
BLOCK_EDGES, BLOCK_CORNER, BLOCK_DENSITY = (0.12, 0.06, 0.06), (0.06, 0.0, 0.075), 500.0
BLOCK_TANK, BLOCK_POOL = (0.24, 0.06, 0.18), (0.24, 0.06, 0.075)
BLOCK_SIDES = (((0.06, 0.06, 0.015), (0.0, 0.0, 0.075)), ((0.06, 0.06, 0.015), (0.18, 0.0, 0.075)))
BLOCK_START = 0.4  # [s] from which on draught and level are averaged


class JetMeasure:
    """Force of a jet on a plate against the flux of its momentum, rho A v^2.

    The force is the slope of the straight line through the momenta of all particles, in the time
    from JET_START to JET_END. The unsteadiness is the rms deviation of the force between records.
    """

    FORCE = JET_BODY[0] * JET_BODY[1] * JET_SPEED**2  # [m4/s2] over the density

    def __init__(self, volume: np.ndarray, x: np.ndarray, cell: float):
        self.volume = volume
        self.rows: list[tuple[float, float]] = []

    def record(self, now: BoardState) -> None:
        """Record the momentum over the density."""
        momentum = (self.volume * now.v[:, 2].astype(np.float64)).sum()
        self.rows.append((now.t, float(momentum)))

    def result(self) -> dict[str, float]:
        """Return the force over the right one, its error, and its deviation between records."""
        t, momentum = np.array(self.rows).T
        steady = (t > JET_START - 1e-6) & (t < JET_END + 1e-6)
        force = float(np.polyfit(t[steady], momentum[steady], 1)[0] / self.FORCE)
        deviation = np.diff(momentum[steady]) / np.diff(t[steady]) / self.FORCE - force
        unsteadiness = float(np.sqrt(np.mean(deviation**2)))
        return {"error": abs(force - 1), "force": force, "unsteadiness": unsteadiness}


class BlockMeasure:
    """Draught of a block that floats in a closed tank against Archimedes.

    The draught is that below the level at both ends of the tank, twice the median height of the
    water there. The block bobs: the mean over the time from BLOCK_START on, some four periods, is
    weighted by Hann's window. The block is what lies in its box at the start.
    """

    DRAUGHT = BLOCK_EDGES[2] * BLOCK_DENSITY / 1000.0
    LEVEL = (
        BLOCK_POOL[2]
        + (2 * np.prod(BLOCK_SIDES[0][0]) + np.prod(BLOCK_EDGES[:2]) * DRAUGHT)
        / np.prod(BLOCK_TANK[:2])
    )  # fmt: skip

    def __init__(self, volume: np.ndarray, x: np.ndarray, cell: float):
        low, high = np.array(BLOCK_CORNER), np.array(BLOCK_CORNER) + BLOCK_EDGES
        self.block = ((x > low) & (x < high)).all(axis=1)
        self.rows: list[tuple[float, float, float]] = []

    def record(self, now: BoardState) -> None:
        """Record the draught and the level, both over the right ones."""
        x = now.x.astype(np.float64)
        edge = BLOCK_CORNER[0] / 2
        ends = ~self.block & (np.minimum(x[:, 0], BLOCK_TANK[0] - x[:, 0]) < edge)
        level = 2 * float(np.median(x[ends, 2])) if ends.any() else 0.0
        draught = level - float(x[self.block, 2].mean()) + BLOCK_EDGES[2] / 2
        self.rows.append((now.t, draught / self.DRAUGHT, level / self.LEVEL))

    def result(self) -> dict[str, float]:
        """Return draught and level over the right ones, and the error of the draught."""
        t, draught, level = np.array(self.rows).T
        weights = np.sin(np.pi * np.clip((t - BLOCK_START) / (t[-1] - BLOCK_START), 0, 1)) ** 2
        value, mean_level = (float(np.average(row, weights=weights)) for row in (draught, level))
        return {"error": abs(value - 1), "draught": value, "level": mean_level}


def jet_velocity(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return velocities [m/s] and gradients [1/s] of the jet at positions x (n, 3) [m]."""
    return np.tile([0.0, 0.0, -JET_SPEED], (len(x), 1)), np.zeros((len(x), 3, 3))
