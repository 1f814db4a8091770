"""`python -m vgmpi bench --engine cuda`: this solver on a graphics card, by stage and law.

Warp and Taichi run on the same card in turns.
"""

import argparse
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from vgmpi.runtime.command_line import EXIT_USAGE

from . import interleaved_rounds
from .benchmark_case import BenchError, Case, lay_out
from .interleaved_rounds import Contestant, Worker
from .subcommands import positive_number, positive_seconds

LIMIT = 480.0  # [s] of all of it
STAGES = ("p2g", "grid", "g2p", "sort", "halo", "wait")
CONTRACTED = (("VGMPI_CARD_CONTRACTION", "on"),)
PLAIN = (("VGMPI_CONTRACTION", "off"),)


def flags(parser: argparse.ArgumentParser) -> None:
    """Add the flags of the command."""
    say = parser.add_argument
    say("--precision", choices=("single", "double"), default="single", help="precision of vgmpi")
    say(
        "--particles",
        nargs="+",
        type=positive_number,
        default=[1e5, 1e6, 1e7, 1e8],
        metavar="N",
        help="particle counts",
    )
    say("--laws", nargs="+", default=["fluid", "elastic", "sand"], metavar="LAW", help="materials")
    say("--rounds", type=positive_number, default=3, help="rounds of all programs")
    say("--seconds", type=positive_seconds, default=1.0, help="length of a round [s]")


def run(args: argparse.Namespace) -> int:
    """Print what was asked for; return the exit code, 2 where there is no card."""
    try:
        for text in lines(args):
            sys.stdout.write(text + "\n")
            sys.stdout.flush()
    except (BenchError, ImportError) as error:
        sys.stderr.write(f"vgmpi bench: {error}\n")
        return getattr(error, "exit_code", EXIT_USAGE)
    return 0


def lines(args: argparse.Namespace) -> Iterator[str]:
    """Yield the lines of the table; cases above LIMIT are named.

    Raises:
        BenchError: There is no card.
    """
    from vgmpi.solver.engines.cuda import graphics_card

    problem = graphics_card.select_device(0)
    if problem:
        raise BenchError(problem)
    began = time.perf_counter()
    yield f"a copy within the card moves {graphics_card.copy_bandwidth(1 << 30) / 1e9:.0f} GB/s"
    yield f"{'law':10s} {'particles':>11s} {'on the card':24s} {'Mpps':>8s}  ratio  by stage"
    for n in map(int, args.particles):
        for law in args.laws:
            if time.perf_counter() - began > LIMIT:
                yield f"{law:10s} {n:11,} left out: the time is up"
                continue
            yield from _contest(Case(law, n), args)
    yield from same_bits(Case("fluid", 20_000))


def _contest(case: Case, args: argparse.Namespace) -> Iterator[str]:
    """Rows of one law and number of particles: ours, ours contracted, Warp, Taichi."""
    own = Contestant("own", args.precision, card=True)
    contestants = [own, Contestant("own", args.precision, card=True, more=CONTRACTED)]
    if case.law in interleaved_rounds.RIVAL_LAWS:
        contestants += [Contestant("warp_rival", card=True), Contestant("taichi_rival", card=True)]
    with tempfile.TemporaryDirectory(prefix="vgmpi-bench-") as folder:
        lay_out(case, [args.precision], Path(folder))
        rows = interleaved_rounds.run_interleaved(
            case, contestants, args.rounds, args.seconds, Path(folder), lambda line: None
        )
    first = None
    for contestant, row in zip(contestants, rows, strict=True):
        label = f"{contestant.name}{', contracted' if contestant.more else ''}"
        if not row.get("rounds"):
            yield f"{case.law:10s} {case.particles:11,} {label:24s} {row.get('note', 'no answer')}"
            continue
        rates = [1e-6 * case.particles * r["steps"] / r["seconds"] for r in row["rounds"]]
        first = first or rates
        ratio = np.median(np.array(first) / np.array(rates))
        wrong = f"  {row['wrong']}" if "wrong" in row else ""
        yield (
            f"{case.law:10s} {case.particles:11,} {label:24s} {np.median(rates):8.0f}"
            f" {ratio:6.2f}  {_by_stage(row)}{wrong}"
        )


def _by_stage(row: dict) -> str:
    """Shares of the time, and launches."""
    spent: dict[str, float] = {}
    for round_times in row["rounds"]:
        for stage, seconds in round_times["stages"].items():
            spent[stage] = spent.get(stage, 0.0) + seconds
    total = sum(spent.values())
    shares = [f"{s} {100 * spent[s] / total:.0f} %" for s in STAGES if spent.get(s)]
    launches = [r["launches"] for r in row["rounds"] if r.get("launches")]
    return ", ".join(shares) + (f"; {np.median(launches):.1f} launches a step" if launches else "")


def same_bits(case: Case) -> Iterator[str]:
    """Compare the bits of two runs on a GPU and of one on a processor without contraction.

    The last line is the cost of a message to another rank without its transfer.
    """
    results: list[list[bytes]] = []
    halo: dict[str, float] = {}
    contestants = [
        Contestant("own", card=True), Contestant("own", card=True), Contestant("own", more=PLAIN),
    ]  # fmt: skip
    for contestant in contestants:
        with tempfile.TemporaryDirectory(prefix="vgmpi-bench-") as folder:
            lay_out(case, ["single"], Path(folder))
            worker = Worker(contestant, case, Path(folder))
            try:
                worker.ask("check", steps=40, path=str(Path(folder) / "bits"))
                halo = worker.ask("halo", blocks=4096) if contestant.card else halo
            finally:
                worker.close()
            with np.load(Path(folder) / "bits.0.npz") as rows:
                order = np.argsort(rows["id"])
                results.append([rows[name][order].tobytes() for name in ("x", "v")])
    for k, what in ((1, "on the card twice"), (2, "on the card and on a processor")):
        yield f"{what}: {'the same bits' if results[0] == results[k] else 'OTHER BITS'}"
    yield (
        f"halo of {halo['blocks']} node blocks: {1e6 * halo['pack']:.0f} us to pack and fetch,"
        f" {1e6 * halo['add']:.0f} us to send and add, {halo['bytes'] / 1e6:.1f} MB"
    )
