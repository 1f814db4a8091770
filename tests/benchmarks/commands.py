"""Commands of `python -m tests.benchmarks`: what each one does, its flags, and how it runs."""

import os
import tempfile
from argparse import ArgumentParser, Namespace
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any, get_args

import numpy as np

from tests.benchmarks import core_use, predictions, scene_checkouts, step_model
from vgmpi.scene.sections import Transfer
from vgmpi.tools.bench import interleaved_rounds
from vgmpi.tools.bench.benchmark_case import Case, lay_out
from vgmpi.tools.bench.interleaved_rounds import Contestant
from vgmpi.tools.bench.subcommands import Command, print_progress

Flag = tuple[str, dict[str, Any]]


def flag(name: str, default=None, help=None, kind=None, **more) -> Flag:
    """A flag with one value, of the type of its default unless `kind` says it."""
    kind = kind or (None if default is None or isinstance(default, str) else type(default))
    return name, {"default": default, "help": help, "type": kind, **more}


def some(name: str, default=None, help=None, kind=None, nargs="+", **more) -> Flag:
    """A flag with several values."""
    return flag(name, default, help, kind or str, nargs=nargs, **more)


def needed(name: str, help: str, **more) -> Flag:
    """A path that must be given."""
    return name, {"type": Path, "help": help, **more}


def switch(name: str, help: str) -> Flag:
    """A flag that is given or not."""
    return name, {"action": "store_true", "help": help}


def number(name: str, default, help=None, **more) -> Flag:
    """A flag with a number, N in its help."""
    return flag(name, default, help, metavar="N", **more)


def command(summary: str, module: str, run: Callable, *flags: Flag) -> Command:
    """A command.

    Args:
        summary: What it does.
        module: Name of the study, which is imported when it runs.
        run: Called with the study and the flags; gives the text, lines, or whether all is well.
        flags: Its flags.
    """

    def add(parser: ArgumentParser) -> None:
        for name, keys in flags:
            parser.add_argument(name, **keys)

    def start(args: Namespace) -> int:
        result = run(import_module(f"tests.benchmarks.{module}"), args)
        if isinstance(result, bool):
            return 0 if result else 1
        for line in [result] if isinstance(result, str) else result:
            print(line, flush=True)
        return 0

    return summary, add, start


def _volume(study, args) -> str | list[str]:
    if not (args.cost or args.dilatation):
        study.run(args.corrections, args.cells, args.end)
        return []
    measure = study.step_cost if args.cost else study.dilatation_cost
    ratios = measure(args.cells, args.cost or args.dilatation)
    what = "shifting" if args.cost else "the dilatation by cells"
    return (
        f"step with {what} over that without: {np.median(ratios):.3f}"
        f" ({min(ratios):.3f} .. {max(ratios):.3f}, {len(ratios)} rounds)"
    )


def _packed(study, args):
    yield study.HEAD
    for case in args.cases:
        for speed in args.max_speed:
            yield from study.rows(case, speed)


def _poured(study, args) -> list:
    study.run(args.scene, args.folder, args.liquid, args.frames)
    return []


def _together(study, args) -> str:
    how = int(args.particles), args.rounds
    ranks = [study.ranks(law, *how, print_progress) for law in args.laws]
    return study.text(ranks, [study.threads(law, *how) for law in args.laws])


def _overhead(_, args):
    yield "a step whose kernels get nothing to do: its Python and its messages"
    case = Case("fluid", 64)
    for ranks in args.ranks:
        with tempfile.TemporaryDirectory(prefix="vgmpi-bench-") as folder:
            lay_out(case, ["single"], Path(folder))
            worker = interleaved_rounds.Worker(Contestant("own", ranks=ranks), case, Path(folder))
            try:
                result = worker.ask("empty", steps=args.steps)
            finally:
                worker.close()
        yield (
            f"{ranks} rank(s): {result['us']:.1f} us per step, least of 10 rounds;"
            f" {result['stays']:.2f} bytes per step stay allocated,"
            f" at most {result['most']:.0f} bytes at a time"
        )


def _scaling(study, args) -> str:
    from tests.benchmarks import sort_scaling

    rows, busy, empty = study.measure(sorted({1, 2, *args.real}), args.particles, print_progress)
    result = study.fit_cost_constants(rows, busy, empty)
    sort = sort_scaling.measure(64, 100_000)
    result["tables"] = 1e-3 * sort["kept"][0] / sort["blocks"] / study.STEPS_PER_SORT
    cores = len(os.sched_getaffinity(0))
    return study.text(rows, result, args.latency, args.bandwidth, cores)


def _costs(study, args) -> str:
    how = int(args.particles), args.rounds, args.precision, print_progress
    return study.text(study.measure(*how))


def _bodies(study, args) -> str:
    if args.pins:
        from tests.benchmarks import pinned_cost

        return pinned_cost.text(pinned_cost.measure(args.rounds, print_progress))
    how = args.count, int(args.particles), args.rounds, print_progress
    return study.text(study.measure(*how))


def _extremes(study, args) -> bool:
    print(study.HEAD)
    good = True
    for row in study.chosen(args.words, args.fast):
        result = study.run_case(row)
        good &= result.good
        print(study.line(result), flush=True)
    return good


def _stability(study, args):
    from tests.benchmarks import contrast_stability

    if args.ratios:
        return contrast_stability.lines(args.only, args.transfer or ["apic-corrected"])
    return study.lines(args.only, args.transfer, args.precision)


def _predictions(study, args) -> bool:
    print(study.HEAD, flush=True)
    results = []
    for scene in args.scenes:
        results.append(study.measure(scene))
        print(study.row(results[-1]), flush=True)
    return all(result.is_accurate for result in results)


def _step_model(study, args) -> list:
    study.run(args.scenes)
    return []


def _live(study, args) -> str:
    delays = study.measure_delays(args.gaussians, 10, print_progress)
    slowdown = study.measure_slowdown(
        args.rounds, args.ranks, args.end, args.frames, print_progress
    )
    return study.text(delays, slowdown)


def _cores(study, args):
    if args.start:
        return study.measure_start(args.rounds, args.free, args.patience, print_progress)
    return study.compare_uses(args.scenes, args.rounds, print_progress)


SCENE = needed("scene", "scene file (TOML)")
SET = "--set", {"action": "append", "default": [], "metavar": "KEY=VALUE", "help": "as for a run"}
LAWS = some("--laws", ["fluid", "elastic"], metavar="LAW")
OF_RANK = number("--particles", 100_000, "per rank, default 100,000")
PRECISION = flag("--precision", "single", choices=("single", "double"))
COST_FLAGS = (
    number("--particles", 4e5, "default 4e5"), flag("--rounds", 5, "default 5"), PRECISION
)  # fmt: skip
TREE = needed("tree", "another checkout")
PATIENCE = flag("--patience", 120.0, "longest wait, default 120 s", metavar="S")
FILES = needed("files", "of pytest --junitxml", nargs="+", metavar="FILE")

COMMANDS: dict[str, Command] = {
    # --- liquids
    "packed": command(
        "splashed liquids over columns packed at rest", "packed_columns", _packed,
        some("cases", ["released", "shaken", "broken"], "default: all", nargs="*"),
        some("--max-speed", [2.5], "[m/s], default 2.5", float, metavar="V"),
    ),
    "poured": command(
        "a run's water by its level beside what was poured", "poured_level", _poured,
        SCENE, needed("folder", "folder of its run"),
        flag("--liquid", "water", "name of its material"),
        flag("--frames", 5, "last frames, default 5"),
    ),
    "volume": command(
        "what splashed liquids lose of their level", "liquid_volume", _volume,
        some("corrections", ["none", "density", "shifting"], nargs="*"),
        flag("--cells", 32, "cells along the tank"), flag("--end", 20.0, "[s]"),
        flag("--cost", None, "time of a step, instead", int, metavar="ROUNDS"),
        flag("--dilatation", None, "that by cells, instead", int, metavar="ROUNDS"),
    ),
    # --- other checkouts
    "against": command(
        "beside another checkout", "compare_checkouts",
        lambda study, a: study.lines(a.tree, a.laws, a.particles, a.rounds, print_progress),
        needed("tree", "another checkout, or uncontracted"), LAWS,
        some("--particles", [1e5, 4e5, 1e6], None, float, metavar="N"),
        flag("--rounds", 9, "default 9"),
    ),
    "bits": command(
        "results of scenes beside another checkout, to the bit", "same_bits",
        lambda study, a: study.compare_bits(
            a.tree, a.scenes, a.steps, a.ranks, a.set, print_progress
        ),
        TREE, ("scenes", {"nargs": "+", "help": "scene files, or folders below runs/"}),
        flag("--steps", 40, "default 40"), number("--ranks", 1, "default 1"), SET,
    ),
    "cores": command(
        "ranks beside threads, and what a start on ranks costs", "core_use", _cores,
        some("--scenes", list(core_use.SCENES), choices=core_use.SCENES, metavar="NAME"),
        flag("--rounds", 5, "default 5"),
        flag("--free", 1.8, "cores to wait for before a start, default 1.8"), PATIENCE,
        switch("--start", "what a start on ranks costs instead"),
    ),
    "pictures": command(
        "pictures of a run beside another checkout", "compare_pictures",
        lambda study, a: study.compare(
            a.tree, a.folder, a.settings, a.frames, a.rounds, print_progress
        ),
        TREE, needed("folder", "folder of a run"), needed("settings", "its render.toml"),
        some("--frames", [1], "default 1", int, metavar="N"), flag("--rounds", 3, "default 3"),
    ),
    "scenes": command(
        "scenes of runs/ beside another checkout", "scene_checkouts",
        lambda study, a: study.compare_scenes(
            a.tree, a.scenes, a.steps, a.ranks, a.rounds, print_progress
        ),
        TREE, some("--scenes", scene_checkouts.SCENES, "folders below runs/", metavar="NAME"),
        flag("--steps", 400, "of each part, default 400"), number("--ranks", 2, "default 2"),
        flag("--rounds", 5, "default 5"),
    ),
    # --- steps, sorts, registers, many ranks on paper
    "balance": command(
        "how even a scene's work would be on many ranks", "balance_study",
        lambda study, a: study.text(
            study.follow(a.scene, a.set, a.ranks, a.time, print_progress)
        ),
        SCENE, some("--ranks", [8, 64], "default 8 64", int, metavar="N"), SET,
        flag("--time", 0.0, "of the scene; default: to its end", metavar="S"),
    ),
    "bodies": command(
        "what free rigid bodies cost", "body_cost", _bodies,
        number("--count", 1000, "bodies apart, default 1000"),
        number("--particles", 1e6, "of the water, default 1e6"), flag("--rounds", 5, "default 5"),
        switch("--pins", "the particles of pinned parts instead"),
    ),
    "census": command(
        "what a sort costs one rank of many beside its particles", "sort_scaling",
        lambda study, a: study.text([study.measure(n, a.particles) for n in a.ranks]),
        some("--ranks", [64, 512, 4096], None, int, metavar="N"), OF_RANK,
    ),
    "choose-tests": command(
        "which tests make test leaves out", "choose_tests",
        lambda study, a: study.write(a.files, a.budget), FILES,
        flag("--budget", 900.0, "of make test, default 900", metavar="S"),
    ),
    "compile-cost": command(
        "what each specialization of a scene costs to compile", "compile_cost",
        lambda study, a: study.text(study.measure(a.scene, a.set), a.rows),
        SCENE, SET, number("--rows", 40, "of the table, default 40"),
    ),
    "couplings": command("what mixing and drag cost", "coupling_cost", _costs, *COST_FLAGS),
    "extremes": command(
        "scenes at the ends of what is allowed", "limit_cases", _extremes,
        some("words", None, "rows with one in their name", nargs="*", metavar="WORD"),
        switch("--fast", "a quick part of them"),
    ),
    "features": command(
        "what contact, colliders and probes cost", "feature_cost", _costs, *COST_FLAGS
    ),
    "live": command(
        "what the page of a run costs", "live_cost", _live,
        number("--gaussians", 100_000, "default 100,000"),
        flag("--rounds", 5, "pairs of runs, default 5"),
        number("--ranks", 1, "of the runs, default 1"),
        flag("--end", 0.3, "of the scene, default 0.3", metavar="S"),
        number("--frames", 13, "of the scene, default 13"),
    ),
    "overhead": command(
        "what a step costs beside its kernels", "commands", _overhead,
        some("--ranks", [1, 2], None, int, metavar="N"),
        flag("--steps", 300, "of a round, default 300"),
    ),
    "predictions": command(
        "what --plan tells, and what runs take", "predictions", _predictions,
        some("scenes", list(predictions.SCENES), "folders of runs/, or files", nargs="*"),
    ),
    "registers": command(
        "what a graphics card's kernels take; needs no card", "gpu_registers",
        lambda study, a: study.lines(a.precision), PRECISION,
    ),
    "scaling": command(
        "predict many ranks from what is measured here", "scaling_model", _scaling,
        some("--real", [1, 2, 4, 8], "ranks to run here", int, metavar="N"),
        number("--particles", 50_000, "per rank of the real runs"),
        flag("--latency", 2e-6, "of a message [s], default 2e-6"),
        flag("--bandwidth", 1e10, "of a rank's link [B/s], default 1e10"),
    ),
    "stability": command(
        "the largest stable time step of every law", "stability_limits", _stability,
        switch("--ratios", "where two meet that differ, in words by --only"),
        some("--only", [], "laws or couplings; default: all", metavar="NAME"),
        some("--transfer", None, "default: all or apic-corrected", choices=get_args(Transfer)),
        some("--precision", ["single", "double"], choices=("single", "double")),
    ),
    "step-model": command(
        "the model of a step's time beside steps", "step_model", _step_model,
        some("scenes", list(step_model.TIMES), "folders of runs/", nargs="*"),
    ),
    "test-times": command(
        "where the time of the tests goes", "test_times",
        lambda study, a: study.text(study.read_costs(a.files), a.rows),
        FILES, number("--rows", 40, "files told, default 40"),
    ),
    "together": command(
        "two ranks beside two runs, two threads", "decomposition_overhead", _together,
        LAWS, number("--particles", 4e5, "of all ranks, default 4e5"),
        flag("--rounds", 9, "default 9"),
    ),
}  # fmt: skip
