"""Commands of `python -m tests.benchmarks` on liquids and on what piles up."""

from pathlib import Path

import numpy as np


def _volume(parser) -> None:
    parser.add_argument("corrections", nargs="*", default=["none", "density", "shifting"])
    parser.add_argument("--cells", type=int, default=32, help="cells along the tank")
    parser.add_argument("--end", type=float, default=20.0, help="[s]")
    parser.add_argument("--cost", type=int, metavar="ROUNDS", help="time of a step, instead")
    parser.add_argument("--dilatation", type=int, metavar="ROUNDS", help="that by cells, instead")
    parser.add_argument("--picture", type=Path, help="PNG of the liquids at the end")


def _run_volume(args) -> int:
    from tests.benchmarks import liquid_volume

    if args.cost or args.dilatation:
        measure = liquid_volume.step_cost if args.cost else liquid_volume.dilatation_cost
        ratios = measure(args.cells, args.cost or args.dilatation)
        what = "shifting" if args.cost else "the dilatation by cells"
        print(f"step with {what} over that without: {np.median(ratios):.3f}", end="")
        print(f" ({min(ratios):.3f} .. {max(ratios):.3f}, {len(ratios)} rounds)")
        return 0
    liquid_volume.run(args.corrections, args.cells, args.end, args.picture)
    return 0


def _correction_order(parser) -> None:
    say = parser.add_argument
    say("orders", nargs="*", type=int, default=[1, 2, 3], help="numbers of terms, default 1 2 3")


def _run_correction_order(args) -> int:
    from tests.benchmarks import correction_order

    correction_order.run(args.orders)
    return 0


def _poured(parser) -> None:
    parser.add_argument("scene", type=Path, help="scene file (TOML)")
    parser.add_argument("folder", type=Path, help="folder of its run")
    parser.add_argument("--liquid", default="water", help="name of its material")
    parser.add_argument("--frames", type=int, default=5, help="last frames, default 5")


def _run_poured(args) -> int:
    from tests.benchmarks import poured_level

    poured_level.run(args.scene, args.folder, args.liquid, args.frames)
    return 0


def _packed(parser) -> None:
    say = parser.add_argument
    say("cases", nargs="*", default=["released", "shaken", "broken"], help="default: all")
    say("--max-speed", nargs="+", type=float, default=[2.5], metavar="V", help="[m/s], default 2.5")


def _run_packed(args) -> int:
    from tests.benchmarks import packed_columns

    print(packed_columns.HEAD, flush=True)
    for case in args.cases:
        for speed in args.max_speed:
            print("\n".join(packed_columns.rows(case, speed)), flush=True)
    return 0


def _crowding(parser) -> None:
    from tests.benchmarks.crowding import MATERIALS

    parser.add_argument("materials", nargs="*", default=list(MATERIALS), help="default: all")


def _run_crowding(args) -> int:
    from tests.benchmarks import crowding

    print(crowding.HEAD, flush=True)
    for material in args.materials:
        for sample in crowding.collapse(material):
            print(crowding.row(material, sample), flush=True)
    return 0


def _run_surfaces(args) -> int:
    from tests.benchmarks import surface_methods

    print(surface_methods.text())
    return 0


LIQUID_COMMANDS = {
    "correction-order": (
        "further terms of the transfer correction",
        _correction_order,
        _run_correction_order,
    ),
    "crowding": ("how sand, snow and paste pile up", _crowding, _run_crowding),
    "packed": ("splashed liquids over columns packed at rest", _packed, _run_packed),
    "poured": ("a run's water by its level beside what was poured", _poured, _run_poured),
    "surfaces": ("ways to make a mesh of particles", lambda _: None, _run_surfaces),
    "volume": ("what splashed liquids lose of their level", _volume, _run_volume),
}
