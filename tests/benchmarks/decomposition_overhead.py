"""Two ranks beside two independent runs of one rank each at the same time, which share this
machine's memory and caches in the same way: what the decomposition costs, what the machine does.
And two threads beside one, by processor time.
"""

import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from vgmpi.tools.bench.benchmark_case import Case, lay_out
from vgmpi.tools.bench.interleaved_rounds import Contestant, Worker


def _seconds(answer: dict) -> float:
    return answer["wall"] / answer["steps"]


def ranks(law: str, particles: int, rounds: int, say) -> dict:
    """Return seconds per step of two ranks, one rank and two independent runs, in turns.

    The wall times of a round are those of one rank alone, of two independent runs with half the
    particles each (the slower), and of two ranks.

    Args:
        law: Material law.
        particles: Particles of all ranks.
        rounds: Number of rounds.
        say: Called with a progress line.
    """
    full, half = Case(law, particles), Case(law, particles // 2)
    with tempfile.TemporaryDirectory(prefix="vgmpi-bench-") as name:
        folders = [Path(name) / part for part in ("whole", "half")]
        for case, folder in zip((full, half), folders, strict=True):
            folder.mkdir()
            lay_out(case, ["single"], folder)
        say(f"{law}: {particles:,} particles")
        single = Worker(Contestant("own"), full, folders[0])
        double = Worker(Contestant("own", ranks=2), full, folders[0])
        pair = [Worker(Contestant("own"), half, folders[1]) for _ in range(2)]
        seconds = []
        try:
            with ThreadPoolExecutor(2) as pool:
                for _ in range(rounds):
                    alone = _seconds(single.ask("round", units=1))
                    both = max(pool.map(lambda w: _seconds(w.ask("round", units=3)), pair))
                    seconds.append([alone, both, _seconds(double.ask("round", units=2))])
        finally:
            for worker in (single, double, *pair):
                worker.close()
    return {"law": law, "seconds": np.array(seconds)}


def threads(law: str, particles: int, rounds: int, count: int = 2) -> dict:
    """Return processor seconds per step of one thread and of `count`, in turns, in this process.

    Args:
        law: Material law.
        particles: Number of particles.
        rounds: Number of rounds.
        count: Number of threads.
    """
    from vgmpi.tools.bench import vgmpi_contestant

    with tempfile.TemporaryDirectory(prefix="vgmpi-bench-") as name:
        lay_out(Case(law, particles), ["single"], Path(name))
        config = {"ranks": 1, "folder": f"{name}/single"}
        every = [vgmpi_contestant.Contestant(config | {"threads": n}) for n in (1, count)]
        seconds = []
        for contestant in every:
            contestant.now = time.process_time
            contestant.cycle()
        for _ in range(rounds):
            row = [contestant.round(1) for contestant in every]
            seconds.append([answer["seconds"] / answer["steps"] for answer in row])
    return {"law": law, "seconds": np.array(seconds)}


def text(of_ranks: list[dict], of_threads: list[dict]) -> str:
    """The result as lines."""
    lines = ["two ranks, wall time; the ceiling is what two independent runs reach:"]
    for row in of_ranks:
        alone, both, two = row["seconds"].T
        share, gain, ceiling = both / two, alone / two, alone / both
        lines.append(
            f"  {row['law']:8s} {share.min():.2f} .. {np.median(share):.2f} .. {share.max():.2f} of"
            f" the ceiling (least, median, best); {np.median(gain):.2f} times one rank, ceiling"
            f" {np.median(ceiling):.2f}"
        )
    lines.append("two threads, processor time beside one:")
    for row in of_threads:
        ratio = row["seconds"][:, 1] / row["seconds"][:, 0]
        lines.append(f"  {row['law']:8s} {np.median(ratio):.3f} (least {ratio.min():.3f})")
    return "\n".join(lines)
