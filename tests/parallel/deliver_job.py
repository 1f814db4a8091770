"""Rows between random ranks, round after round without a pause: mpirun -n N python -m this.

In each round every rank sends some rows, also to itself and to nobody, and knows from the same
random numbers what must come; some ranks are late. Persistent messages travel meanwhile.
"""

import time

import numpy as np

from vgmpi.parallel.communicator import MpiCommunicator

ROUNDS = 300


def sent(turn: int, rank: int, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows (n, 2) of a rank in a round, and to whom."""
    random = np.random.default_rng([turn, rank])
    to = random.integers(0, size, random.integers(0, 20) * random.integers(0, 2))
    return np.stack([1000 * rank + np.arange(len(to)), np.full(len(to), turn)], 1), to


def main() -> None:
    ranks = MpiCommunicator()
    ahead, behind = (ranks.rank + 1) % ranks.size, (ranks.rank - 1) % ranks.size
    out, back = np.zeros(3), np.zeros(3)
    link = ranks.link([(ahead, out)], [(behind, back)])
    for turn in range(ROUNDS):
        out[:] = turn
        link.start()
        if (turn + ranks.rank) % 7 == 0:
            time.sleep(1e-3)
        got = ranks.sparse_exchange(*sent(turn, ranks.rank, ranks.size))
        every = [sent(turn, r, ranks.size) for r in range(ranks.size)]
        want = np.concatenate([rows[to == ranks.rank] for rows, to in every])
        assert got.tolist() == want.tolist(), (turn, got, want)
        link.wait()
        assert (back == turn).all()
    link.close()
    below = ranks.before(ranks.rank + 1), ranks.total(ranks.rank + 1)
    assert below == (ranks.rank * (ranks.rank + 1) // 2, ranks.size * (ranks.size + 1) // 2)
    assert ranks.each(np.array([ranks.rank, 7])).tolist() == [[r, 7] for r in range(ranks.size)]
    print(f"rank {ranks.rank} done", flush=True)


if __name__ == "__main__":
    main()
