"""Where the surfaces of two bodies of particles are, found without the grid."""

import numpy as np
from scipy.spatial import cKDTree


def clearance(x, volume, master, dx: float) -> float:
    """Smallest distance [cells] of the other body's particles, as cubes, from the surface of the
    master; below 0: it has been entered. Nothing within a cell: inf.

    x: (n, 3) [m]; volume: (n,) [m3]; master: (n,) bool; 8 particles per cell. The share f of a ball
    about a particle that the master fills tells how far its surface is, taken as a plane: with t
    the distance in radii f = (1 - t)^2 (2 + t) / 4. An edge or a corner of the master fills less,
    so that a particle beyond it counts as further away.
    """
    body, other = cKDTree(x[master]), x[~master]
    other = other[body.query(other, distance_upper_bound=dx)[0] < dx]
    if not len(other):
        return np.inf
    radius = 1.5 * dx
    within = body.query_ball_point(other, radius)
    filled = np.array([volume[master][i].sum() for i in within]) / (4 / 3 * np.pi * radius**3)
    t = np.linspace(1, -1, 2001)
    away = np.interp(filled, (1 - t) ** 2 * (2 + t) / 4, t) * radius
    return float((away.min() - dx / 4) / dx)


def standoff(x, volume, upper, middle, half: float, fluid: str, dx: float) -> float:
    """Mean gap [cells] between an upper and a lower body over a square about `middle` (2,) [m] with
    edges of 2 `half` [m].

    Particles of a solid lie in layers: its face is half a spacing beyond the outermost of each
    column of one particle. fluid: "upper", "lower" or "" for what has no layers: its face is where
    its volume, counted from a cell and a quarter away from the other's face, ends.
    """
    h = dx / 2
    beside = np.abs(x[:, :2] - middle)
    inside = (beside < half).all(1)
    column = np.floor((x[:, :2] - middle) / h).astype(int) @ [1000, 1]

    def face(body, sign):
        rows = inside & body
        return (
            np.mean([(sign * x[rows & (column == k), 2]).max() for k in set(column[rows])]) + h / 2
        )

    if not fluid:
        return float((-face(upper, -1) - face(~upper, 1)) / dx)
    sign, body = (1, upper) if fluid == "upper" else (-1, ~upper)
    plane = face(~body, sign) + 1.25 * dx
    share = np.clip((half + h / 2 - beside) / h, 0, 1).prod(1)
    share *= np.clip((plane - sign * x[:, 2]) / h + 0.5, 0, 1)
    return float(1.25 - (volume * share)[body].sum() / (2 * half) ** 2 / dx)
