"""`python -m tests.benchmarks NAME`: what only makers of this program ask: studies of its sums,
sorts, registers, of many ranks on paper, of another checkout.
"""

import argparse
import os
import sys
import tempfile
from pathlib import Path
from typing import get_args

from tests.benchmarks.comparison_commands import COMPARISON_COMMANDS
from tests.benchmarks.liquid_commands import LIQUID_COMMANDS
from tests.benchmarks.photograph_commands import PHOTOGRAPH_COMMANDS
from vgmpi.io.run_reader import RunError
from vgmpi.runtime.command_line import exit_code_from_exceptions
from vgmpi.scene.sections import Transfer
from vgmpi.tools.bench import interleaved_rounds
from vgmpi.tools.bench.benchmark_case import BenchError, Case, lay_out
from vgmpi.tools.bench.interleaved_rounds import Contestant
from vgmpi.tools.bench.subcommands import parse_arguments, print_progress, run_command

PROGRAM = "python -m tests.benchmarks"


def arguments(argv: list[str]) -> argparse.Namespace:
    """The flags."""
    return parse_arguments(PROGRAM, __doc__, COMMANDS, argv)


@exit_code_from_exceptions
def main(argv: list[str] | None = None) -> int:
    """Run the command; returns the exit code."""
    words = sys.argv[1:] if argv is None else argv
    return run_command(PROGRAM, arguments(words), (BenchError, ImportError, RunError))


def _balance(parser: argparse.ArgumentParser) -> None:
    say = parser.add_argument
    say("scene", type=Path, help="scene file (TOML)")
    say("--ranks", nargs="+", type=int, default=[8, 64], metavar="N", help="default 8 64")
    say("--set", action="append", default=[], metavar="KEY=VALUE", help="as for a run")
    say("--time", type=float, default=0.0, metavar="S", help="of the scene; default: to its end")


def _run_balance(args: argparse.Namespace) -> int:
    from tests.benchmarks import balance_study

    result = balance_study.follow(args.scene, args.set, args.ranks, args.time, print_progress)
    print(balance_study.text(result))
    return 0


def _census(parser: argparse.ArgumentParser) -> None:
    say = parser.add_argument
    say("--ranks", nargs="+", type=int, default=[64, 512, 4096], metavar="N")
    say("--particles", type=int, default=100_000, metavar="N", help="per rank, default 100,000")


def _run_census(args: argparse.Namespace) -> int:
    from tests.benchmarks import sort_scaling

    print(sort_scaling.text([sort_scaling.measure(n, args.particles) for n in args.ranks]))
    return 0


def _accuracy(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--particles", type=int, default=4000, metavar="N", help="default 4,000")


def _run_accuracy(args: argparse.Namespace) -> int:
    from tests.benchmarks import single_precision_error

    print(single_precision_error.text(args.particles))
    return 0


def _emulate(parser: argparse.ArgumentParser) -> None:
    say = parser.add_argument
    say("--ranks", nargs="+", type=int, default=[1, 8, 64], metavar="N")
    say("--particles", type=int, default=100_000, metavar="N", help="per rank, default 100,000")
    say("--steps", type=int, default=200, help="of each, in turns, default 200")


def _run_emulate(args: argparse.Namespace) -> int:
    from tests.benchmarks import rank_emulation

    print(rank_emulation.text(rank_emulation.measure(args.ranks, args.particles, args.steps)))
    return 0


def _together(parser: argparse.ArgumentParser) -> None:
    say = parser.add_argument
    say("--laws", nargs="+", default=["fluid", "elastic"], metavar="LAW")
    say("--particles", type=float, default=4e5, metavar="N", help="of all ranks, default 4e5")
    say("--rounds", type=int, default=9, help="default 9")


def _run_together(args: argparse.Namespace) -> int:
    from tests.benchmarks import decomposition_overhead

    how = int(args.particles), args.rounds
    ranks = [decomposition_overhead.ranks(law, *how, print_progress) for law in args.laws]
    print(
        decomposition_overhead.text(
            ranks, [decomposition_overhead.threads(law, *how) for law in args.laws]
        )
    )
    return 0


def _overhead(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--ranks", nargs="+", type=int, default=[1, 2], metavar="N")
    parser.add_argument("--steps", type=int, default=300, help="of a round, default 300")


def _run_overhead(args: argparse.Namespace) -> int:
    print("a step whose kernels get nothing to do: its Python and its messages")
    case = Case("fluid", 64)
    for ranks in args.ranks:
        with tempfile.TemporaryDirectory(prefix="vgmpi-bench-") as folder:
            lay_out(case, ["single"], Path(folder))
            worker = interleaved_rounds.Worker(
                Contestant("inside", ranks=ranks), case, Path(folder)
            )
            try:
                result = worker.ask("empty", steps=args.steps)
            finally:
                worker.close()
        print(
            f"{ranks} rank(s): {result['us']:.1f} us per step, least of 10 rounds;"
            f" {result['stays']:.2f} bytes per step stay allocated,"
            f" at most {result['most']:.0f} bytes at a time"
        )
    return 0


def _scaling(parser: argparse.ArgumentParser) -> None:
    say = parser.add_argument
    say("--real", nargs="+", type=int, default=[1, 2, 4, 8], metavar="N", help="ranks to run here")
    say("--particles", type=int, default=50_000, metavar="N", help="per rank of the real runs")
    say("--latency", type=float, default=2e-6, help="of a message [s], default 2e-6")
    say("--bandwidth", type=float, default=1e10, help="of a rank's link [B/s], default 1e10")


def _run_scaling(args: argparse.Namespace) -> int:
    from tests.benchmarks import scaling_model, sort_scaling

    rows, busy, empty = scaling_model.measure(
        sorted({1, 2, *args.real}), args.particles, print_progress
    )
    result = scaling_model.fit_cost_constants(rows, busy, empty)
    sort = sort_scaling.measure(64, 100_000)
    result["tables"] = 1e-3 * sort["kept"][0] / sort["blocks"] / scaling_model.STEPS_PER_SORT
    cores = len(os.sched_getaffinity(0))
    print(scaling_model.text(rows, result, args.latency, args.bandwidth, cores))
    return 0


def _cost(parser: argparse.ArgumentParser) -> None:
    say = parser.add_argument
    say("scene", type=Path, help="scene file (TOML)")
    say("--set", action="append", default=[], metavar="KEY=VALUE", help="as for a run")
    say("--rows", type=int, default=40, metavar="N", help="of the table, default 40")


def _run_cost(args: argparse.Namespace) -> int:
    from tests.benchmarks import compile_cost

    print(compile_cost.text(compile_cost.measure(args.scene, args.set), args.rows))
    return 0


def _couplings(parser: argparse.ArgumentParser) -> None:
    say = parser.add_argument
    say("--particles", type=float, default=4e5, metavar="N", help="default 4e5")
    say("--rounds", type=int, default=5, help="default 5")
    say("--precision", choices=("single", "double"), default="single")


def _run_couplings(args: argparse.Namespace) -> int:
    from tests.benchmarks import coupling_cost, feature_cost

    study = feature_cost if args.command == "features" else coupling_cost
    rows = study.measure(int(args.particles), args.rounds, args.precision, print_progress)
    print(study.text(rows))
    return 0


def _extremes(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("words", nargs="*", metavar="WORD", help="rows with one in their name")
    parser.add_argument("--fast", action="store_true", help="a quick part of them")


def _run_extremes(args: argparse.Namespace) -> int:
    from tests.benchmarks import limit_cases

    print(limit_cases.HEAD)
    good = True
    for row in limit_cases.chosen(args.words, args.fast):
        result = limit_cases.run_case(row)
        good &= result.good
        print(limit_cases.line(result), flush=True)
    return 0 if good else 1


def _stability(parser: argparse.ArgumentParser) -> None:
    say = parser.add_argument
    say("--ratios", action="store_true", help="where two meet that differ, in words by --only")
    say("--only", nargs="+", default=[], metavar="NAME", help="laws or couplings; default: all")
    say("--transfer", nargs="+", choices=get_args(Transfer), help="default: all or apic-corrected")
    say("--precision", nargs="+", choices=("single", "double"), default=["single", "double"])


def _run_stability(args: argparse.Namespace) -> int:
    from tests.benchmarks import contrast_stability, stability_limits

    rows = contrast_stability.lines(args.only, args.transfer or ["apic-corrected"])
    if not args.ratios:
        rows = stability_limits.lines(args.only, args.transfer, args.precision)
    for text in rows:
        print(text, flush=True)
    return 0


def _bodies(parser: argparse.ArgumentParser) -> None:
    say = parser.add_argument
    say("--count", type=int, default=1000, metavar="N", help="bodies apart, default 1000")
    say("--particles", type=float, default=1e6, metavar="N", help="of the water, default 1e6")
    say("--rounds", type=int, default=5, help="default 5")
    say("--pins", action="store_true", help="the particles of pinned parts instead")


def _run_bodies(args: argparse.Namespace) -> int:
    from tests.benchmarks import body_cost, pinned_cost

    if args.pins:
        print(pinned_cost.text(pinned_cost.measure(args.rounds, print_progress)))
        return 0
    print(body_cost.text(
        body_cost.measure(args.count, int(args.particles), args.rounds, print_progress)
    ))  # fmt: skip
    return 0


def _run_spills(args: argparse.Namespace) -> int:
    from tests.benchmarks import register_spills

    print(register_spills.text(register_spills.measure()))
    return 0


def _registers(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--precision", choices=("single", "double"), default="single")


def _run_registers(args: argparse.Namespace) -> int:
    from tests.benchmarks import gpu_registers

    for text in gpu_registers.lines(args.precision):
        print(text, flush=True)
    return 0


def _choose_tests(parser: argparse.ArgumentParser) -> None:
    say = parser.add_argument
    say("files", nargs="+", type=Path, metavar="FILE", help="of pytest --junitxml")
    say("--budget", type=float, default=900.0, metavar="S", help="of make test, default 900")


def _run_choose_tests(args: argparse.Namespace) -> int:
    from tests.benchmarks import choose_tests

    print(choose_tests.write(args.files, args.budget))
    return 0


def _test_times(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("files", nargs="+", type=Path, metavar="FILE", help="of pytest --junitxml")
    parser.add_argument("--rows", type=int, default=40, metavar="N", help="files told, default 40")


def _run_test_times(args: argparse.Namespace) -> int:
    from tests.benchmarks import test_times

    print(test_times.text(test_times.read_costs(args.files), args.rows))
    return 0


def _predictions(parser) -> None:
    from tests.benchmarks.predictions import SCENES

    parser.add_argument(
        "scenes", nargs="*", default=list(SCENES), help="folders of runs/, or files"
    )


def _run_predictions(args) -> int:
    from tests.benchmarks import predictions

    print(predictions.HEAD, flush=True)
    results = []
    for scene in args.scenes:
        results.append(predictions.measure(scene))
        print(predictions.row(results[-1]), flush=True)
    return 0 if all(result.holds for result in results) else 1


def _step_model(parser) -> None:
    from tests.benchmarks.step_model import TIMES

    parser.add_argument("scenes", nargs="*", default=list(TIMES), help="folders of runs/")


def _run_step_model(args) -> int:
    from tests.benchmarks import step_model

    step_model.run(args.scenes)
    return 0


def _moving_page(parser) -> None:
    say = parser.add_argument
    say("--folder", type=Path, help="folder of a run; default: made-up motion")
    say("--gaussians", type=float, default=3e5, metavar="N", help="made up, default 3e5")
    say("--frames", type=int, default=250, metavar="N", help="at most, default 250")
    say("--accuracy", type=float, default=0.02, metavar="A", help="in cells, default 0.02")
    say("-o", "--output", help="file to keep the page in")


def _run_moving_page(args) -> int:
    from tests.benchmarks import moving_page

    print(moving_page.run_benchmark(args, print_progress))
    return 0


def _live(parser) -> None:
    say = parser.add_argument
    say("--gaussians", type=int, default=100_000, metavar="N", help="default 100,000")
    say("--rounds", type=int, default=5, help="pairs of runs, default 5")
    say("--ranks", type=int, default=1, metavar="N", help="of the runs, default 1")
    say("--end", type=float, default=0.3, metavar="S", help="of the scene, default 0.3")
    say("--frames", type=int, default=13, metavar="N", help="of the scene, default 13")


def _run_live(args) -> int:
    from tests.benchmarks import live_cost

    delays = live_cost.measure_delays(args.gaussians, 10, print_progress)
    slowdown = live_cost.measure_slowdown(
        args.rounds, args.ranks, args.end, args.frames, print_progress
    )
    print(live_cost.text(delays, slowdown))
    return 0


COMMANDS = {  # what it does, its flags, how it runs
    **LIQUID_COMMANDS,
    **COMPARISON_COMMANDS,
    **PHOTOGRAPH_COMMANDS,
    "accuracy": ("how exact single precision is", _accuracy, _run_accuracy),
    "balance": ("how even a scene's work would be on many ranks", _balance, _run_balance),
    "bodies": ("what free rigid bodies cost", _bodies, _run_bodies),
    "census": ("what a sort costs one rank of many beside its particles", _census, _run_census),
    "choose-tests": ("which tests make test leaves out", _choose_tests, _run_choose_tests),
    "compile-cost": ("what each specialization of a scene costs to compile", _cost, _run_cost),
    "couplings": ("what mixing and drag cost", _couplings, _run_couplings),
    "emulate": ("one rank of many by its own tables", _emulate, _run_emulate),
    "extremes": ("scenes at the ends of what is allowed", _extremes, _run_extremes),
    "features": ("what contact, colliders and probes cost", _couplings, _run_couplings),
    "live": ("what the page of a run costs", _live, _run_live),
    "moving-page": ("size and times of a run's web page", _moving_page, _run_moving_page),
    "overhead": ("what a step costs beside its kernels", _overhead, _run_overhead),
    "predictions": ("what --plan tells, and what runs take", _predictions, _run_predictions),
    "registers": ("what a graphics card's kernels take; needs no card", _registers, _run_registers),
    "spills": ("vectors that do not fit the registers", lambda _: None, _run_spills),
    "stability": ("the largest stable time step of every law", _stability, _run_stability),
    "step-model": ("the model of a step's time beside steps", _step_model, _run_step_model),
    "scaling": ("predict many ranks from what is measured here", _scaling, _run_scaling),
    "test-times": ("where the time of the tests goes", _test_times, _run_test_times),
    "together": ("two ranks beside two runs, two threads", _together, _run_together),
}

if __name__ == "__main__":
    sys.exit(main())
