"""Two ranks beside two independent runs of one rank each at the same time, which share this
machine's memory and caches in the same way: what the decomposition costs, what the machine does.
And two threads beside one, by processor time.
"""

import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from .rounds import Contestant, Worker
from .scene import Case, lay_out


def _seconds(answer: dict) -> float:
    return answer["wall"] / answer["steps"]


def ranks(law: str, particles: int, rounds: int, say) -> dict:
    """Per round, seconds per step by the wall of one rank alone, of two independent runs with half
    the particles each (the slower), and of two ranks; in turns."""
    whole, half = Case(law, particles), Case(law, particles // 2)
    with tempfile.TemporaryDirectory(prefix="vgmpi-bench-") as name:
        folders = [Path(name) / part for part in ("whole", "half")]
        for case, folder in zip((whole, half), folders, strict=True):
            folder.mkdir()
            lay_out(case, ["single"], folder)
        say(f"{law}: {particles:,} particles")
        one = Worker(Contestant("inside"), whole, folders[0])
        two = Worker(Contestant("inside", ranks=2), whole, folders[0])
        pair = [Worker(Contestant("inside"), half, folders[1]) for _ in range(2)]
        found = []
        try:
            with ThreadPoolExecutor(2) as pool:
                for _ in range(rounds):
                    alone = _seconds(one.ask("round", units=1))
                    both = max(pool.map(lambda w: _seconds(w.ask("round", units=3)), pair))
                    found.append([alone, both, _seconds(two.ask("round", units=2))])
        finally:
            for worker in (one, two, *pair):
                worker.close()
    return {"law": law, "seconds": np.array(found)}


def threads(law: str, particles: int, rounds: int, count: int = 2) -> dict:
    """Per round, processor seconds per step of one thread and of `count`; in turns, here."""
    from . import own

    with tempfile.TemporaryDirectory(prefix="vgmpi-bench-") as name:
        lay_out(Case(law, particles), ["single"], Path(name))
        given = {"ranks": 1, "folder": f"{name}/single"}
        every = [own.Contestant(given | {"threads": n}) for n in (1, count)]
        found = []
        for one in every:
            one.now = time.process_time
            one.cycle()
        for _ in range(rounds):
            row = [one.round(1) for one in every]
            found.append([answer["seconds"] / answer["steps"] for answer in row])
    return {"law": law, "seconds": np.array(found)}


def text(of_ranks: list[dict], of_threads: list[dict]) -> str:
    """The result as lines."""
    lines = ["two ranks, wall time; the ceiling is what two independent runs reach:"]
    for row in of_ranks:
        alone, both, two = row["seconds"].T
        share, gain, most = both / two, alone / two, alone / both
        lines.append(
            f"  {row['law']:8s} {share.min():.2f} .. {np.median(share):.2f} .. {share.max():.2f} of"
            f" the ceiling (least, median, best); {np.median(gain):.2f} times one rank, ceiling"
            f" {np.median(most):.2f}"
        )
    lines.append("two threads, processor time beside one:")
    for row in of_threads:
        ratio = row["seconds"][:, 1] / row["seconds"][:, 0]
        lines.append(f"  {row['law']:8s} {np.median(ratio):.3f} (least {ratio.min():.3f})")
    return "\n".join(lines)
