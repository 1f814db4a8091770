"""Writes one of every file with made-up numbers that depend only on the particle id, on any ranks.

mpirun -n N python -m tests.parallel.files_job FOLDER
"""

import sys
from pathlib import Path

import numpy as np

from vgmpi.io import checkpoint, csv_log, frames, initial_state
from vgmpi.parallel.communicator import init_communicator

TOTAL = 150_000  # more than two checksum chunks, so that pieces of chunks are joined
MISSING = 1_000  # the last ids are not there yet in frame 0


def columns(ids: np.ndarray) -> dict[str, np.ndarray]:
    """Fields of a frame for these particles."""
    x = np.stack([np.sin(ids), np.cos(ids), ids / TOTAL], 1)
    return {
        "positions": x,
        "velocity": 2 * x,
        "J": 1 + x[:, 0] / 10,
        "F": np.tile(np.eye(3).reshape(9), (len(ids), 1)) + x[:, :1],
        "object": (ids % 3).astype(np.int32),
        "phase": (ids % 2).astype(np.int32),
    }


def mine(ranks, total: int, shuffled: bool) -> np.ndarray:
    """Ids of this rank: scattered as the grid scatters them, or consecutive. Rank 1 has none."""
    holders = [r for r in range(ranks.size) if r != 1]
    if ranks.rank not in holders:
        return np.zeros(0, np.int64)
    place, count = holders.index(ranks.rank), len(holders)
    order = np.random.default_rng(1).permutation(total) if shuffled else np.arange(total)
    if shuffled:
        return order[place::count]
    return order[total * place // count : total * (place + 1) // count]


def state(ranks, step: int) -> dict:
    """A checkpoint: rows in an order that does not depend on the ranks."""
    ids = mine(ranks, TOTAL, shuffled=False)
    found = columns(ids)
    particles = {"id": ids, "x": found["positions"] + step, "state": found["F"]}
    return {
        "attrs": {"step": step, "time": step / 1000, "scene": "x" * 100_000},
        "groups": {"particles": particles},
    }


def rest_rows(total: int) -> dict[str, np.ndarray]:
    found = columns(np.arange(total))
    return {
        "x0": found["positions"],
        "vol0": np.full(total, 1e-6),
        "object": np.zeros(total, np.int32),
        "cov0": np.tile([1e-4, 0, 0, 1e-4, 0, 1e-4], (total, 1)),
        "opacity": np.full(total, 0.5),
        "sh": found["positions"][:, None, :],
    }


def row(step: int) -> dict:
    numbers = {name: step + 0.1 for name in csv_log.COLUMNS}
    return {**numbers, "step": step, "phase": "water", "particles": TOTAL, "time": step / 1000}


def write_all(folder: Path, ranks) -> None:
    objects = [{"name": "pool", "first_row": 0, "row_count": TOTAL}]
    rows = rest_rows(TOTAL) if ranks.rank == 0 else None
    initial_state.write(
        folder / "gaussians.h5", ranks, rows, objects, None, {"title": "made up"}, "abc"
    )
    series = frames.Frames(folder, ranks, TOTAL)
    book = csv_log.ConservationLog(folder, ranks)
    for index, count in enumerate((TOTAL - MISSING, TOTAL)):
        ids = mine(ranks, count, shuffled=True)
        series.write(index, index / 10, 100 * index, ids, columns(ids))
        book.append([row(100 * index)])
    for step in (50, 100, 150):
        checkpoint.write(folder / "checkpoints", ranks, state(ranks, step))


if __name__ == "__main__":
    write_all(Path(sys.argv[1]), init_communicator())
