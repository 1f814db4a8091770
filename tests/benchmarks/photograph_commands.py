"""Command of `python -m tests.benchmarks` on photographs."""

from pathlib import Path


def _photographs(parser) -> None:
    say = parser.add_argument
    say("names", nargs="*", help="pictures, default: the twelve")
    say("--folder", type=Path, help="with pictures, before those of installed packages")
    say("--cells", type=int, default=24, help="along the longest edge, default 24")
    say("--end", default="0.3 s", help="of the runs, default 0.3 s")
    say("-o", dest="out", type=Path, required=True, help="folder of the scenes and runs")


def _run_photographs(args) -> int:
    from tests.benchmarks import photographs

    rows = photographs.run(args.names, args.folder, args.out, args.cells, args.end)
    return 0 if all(photographs.is_right(row) for row in rows) else 1


PHOTOGRAPH_COMMANDS = {
    "photographs": ("photographs to the end of their runs", _photographs, _run_photographs),
}
