"""Commands of `python -m tests.benchmarks` that compare this program with another checkout."""

import argparse
from pathlib import Path

from vgmpi.tools.bench.subcommands import print_progress


def _against(parser: argparse.ArgumentParser) -> None:
    say = parser.add_argument
    say("tree", type=Path, help="another checkout, or stripped: without features, or uncontracted")
    say("--laws", nargs="+", default=["fluid", "elastic"], metavar="LAW")
    say("--particles", nargs="+", type=float, default=[1e5, 4e5, 1e6], metavar="N")
    say("--rounds", type=int, default=9, help="default 9")


def _run_against(args: argparse.Namespace) -> int:
    from tests.benchmarks import compare_checkouts

    for line in compare_checkouts.lines(
        args.tree, args.laws, args.particles, args.rounds, print_progress
    ):
        print(line, flush=True)
    return 0


def _scenes(parser: argparse.ArgumentParser) -> None:
    from tests.benchmarks.scene_checkouts import SCENES

    say = parser.add_argument
    say("tree", type=Path, help="another checkout")
    say("--scenes", nargs="+", default=SCENES, metavar="NAME", help="folders below runs/")
    say("--steps", type=int, default=400, help="of each part, default 400")
    say("--ranks", type=int, default=2, metavar="N", help="default 2")
    say("--rounds", type=int, default=5, help="default 5")


def _run_scenes(args: argparse.Namespace) -> int:
    from tests.benchmarks import scene_checkouts

    for line in scene_checkouts.compare_scenes(
        args.tree, args.scenes, args.steps, args.ranks, args.rounds, print_progress
    ):
        print(line, flush=True)
    return 0


def _bits(parser: argparse.ArgumentParser) -> None:
    say = parser.add_argument
    say("tree", type=Path, help="another checkout")
    say("scenes", nargs="+", help="scene files, or folders below runs/")
    say("--steps", type=int, default=40, help="default 40")
    say("--ranks", type=int, default=1, metavar="N", help="default 1")
    say("--set", action="append", default=[], metavar="KEY=VALUE", help="as for a run")


def _run_bits(args: argparse.Namespace) -> int:
    from tests.benchmarks import same_bits

    for line in same_bits.compare_bits(
        args.tree, args.scenes, args.steps, args.ranks, args.set, print_progress
    ):
        print(line, flush=True)
    return 0


def _pictures(parser: argparse.ArgumentParser) -> None:
    say = parser.add_argument
    say("tree", type=Path, help="another checkout")
    say("folder", type=Path, help="folder of a run")
    say("settings", type=Path, help="its render.toml")
    say("--frames", nargs="+", type=int, default=[1], metavar="N", help="default 1")
    say("--rounds", type=int, default=3, help="default 3")


def _run_pictures(args: argparse.Namespace) -> int:
    from tests.benchmarks import compare_pictures

    for line in compare_pictures.compare(
        args.tree, args.folder, args.settings, args.frames, args.rounds, print_progress
    ):
        print(line, flush=True)
    return 0


def _board_steps(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("cases", nargs="*", help="cases of the board, default: all")
    parser.add_argument("--cfl", type=float, default=0.4, help="of the shorter step, default 0.4")


def _run_board_steps(args: argparse.Namespace) -> int:
    from tests.benchmarks import board_steps

    board_steps.run(args.cases, args.cfl)
    return 0


def _cores(parser: argparse.ArgumentParser) -> None:
    from tests.benchmarks.core_use import SCENES

    say = parser.add_argument
    say("--scenes", nargs="+", default=list(SCENES), choices=SCENES, metavar="NAME")
    say("--rounds", type=int, default=5, help="default 5")
    say("--free", type=float, default=1.8, help="cores to wait for before a start, default 1.8")
    say("--patience", type=float, default=120.0, metavar="S", help="longest wait, default 120 s")
    say("--start", action="store_true", help="what a start on ranks costs instead")


def _run_cores(args: argparse.Namespace) -> int:
    from tests.benchmarks import core_use

    rows = core_use.compare_uses(args.scenes, args.rounds, print_progress)
    if args.start:
        rows = core_use.measure_start(args.rounds, args.free, args.patience, print_progress)
    for line in rows:
        print(line, flush=True)
    return 0


def _frames(parser: argparse.ArgumentParser) -> None:
    say = parser.add_argument
    say("tree", type=Path, nargs="?", help="another checkout, in turns")
    say("--particles", type=float, default=121525, metavar="N", help="default: of runs/splash")
    say("--frames", nargs="+", type=int, default=[50, 250], metavar="N", help="default 50 250")
    say("--rounds", type=int, default=5, help="default 5")


def _run_frames(args: argparse.Namespace) -> int:
    from tests.benchmarks import frame_cost

    how = int(args.particles), args.frames, args.rounds, print_progress
    for line in frame_cost.compare_frames(args.tree, *how):
        print(line, flush=True)
    return 0


def _first_use(parser: argparse.ArgumentParser) -> None:
    say = parser.add_argument
    say("tree", type=Path, nargs="?", help="another checkout, in turns")
    say("--install", action="store_true", help="also into new environments, from the network")
    say("--rounds", type=int, default=3, help="default 3")
    say("--patience", type=float, default=120.0, metavar="S", help="longest wait, default 120 s")


def _run_first_use(args: argparse.Namespace) -> int:
    from tests.benchmarks import first_use

    how = args.install, args.rounds, args.patience, print_progress
    for line in first_use.compare_first_use(args.tree, *how):
        print(line, flush=True)
    return 0


COMPARISON_COMMANDS = {
    "against": ("beside another checkout", _against, _run_against),
    "board-steps": ("runs of the board with a shorter step", _board_steps, _run_board_steps),
    "cores": ("ranks beside threads, and what a start on ranks costs", _cores, _run_cores),
    "first-use": ("install, first run and first picture, by the clock", _first_use, _run_first_use),
    "frames": ("what writing a frame costs", _frames, _run_frames),
    "pictures": ("pictures of a run beside another checkout", _pictures, _run_pictures),
    "bits": ("results of scenes beside another checkout, to the bit", _bits, _run_bits),
    "scenes": ("scenes of runs/ beside another checkout", _scenes, _run_scenes),
}
