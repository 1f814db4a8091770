"""Random numbers of particles that are equal in every frame and on every machine."""

import numpy as np


def uniform(ids: np.ndarray, stream: int) -> np.ndarray:
    """Return random numbers in 0..1 (n,) that depend only on a particle's number and a stream.

    References:
        S. Vigna's splitmix64.
    """
    with np.errstate(over="ignore"):
        bits = ids.astype(np.uint64) * np.uint64(256) + np.uint64(stream + 1)
        bits *= np.uint64(0x9E3779B97F4A7C15)
        bits = (bits ^ (bits >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        bits = (bits ^ (bits >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return ((bits ^ (bits >> np.uint64(31))) >> np.uint64(11)).astype(np.float64) * 2.0**-53


def low_discrepancy(count: int) -> np.ndarray:
    """Return points (count, 3) that fill the unit cube evenly.

    References:
        M. Roberts. The unreasonable effectiveness of quasirandom sequences. 2018 (R3).
    """
    phi = 1.2207440846057596
    steps = np.array([1 / phi, 1 / phi**2, 1 / phi**3])
    return np.mod(0.5 + (np.arange(count)[:, None] + 1) * steps, 1.0)
