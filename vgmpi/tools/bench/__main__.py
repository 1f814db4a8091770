"""`python -m vgmpi bench`: this solver by stage and law beside its rivals on one scene."""

import argparse
import json
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from vgmpi.materials import registry
from vgmpi.runtime.command_line import exit_code_from_exceptions
from vgmpi.runtime.user_files import replace_file
from vgmpi.runtime.versions import versions

from . import gpu, interleaved_rounds, result_tables, roofline
from .benchmark_case import BenchError, Case, lay_out
from .board import board_command
from .interleaved_rounds import Contestant
from .subcommands import (
    check_file_can_be_written,
    parse_arguments,
    positive_number,
    positive_seconds,
    print_progress,
    run_command,
)


def arguments(argv: list[str]) -> argparse.Namespace:
    """The flags; `speed` is meant where no command is named."""
    if "--compare" in argv:
        argv = ["compare", *(word for word in argv if word != "--compare")]
    elif argv[:2] == ["--engine", "cuda"]:
        argv = ["card", *argv[2:]]
    elif not argv or argv[0] not in (*COMMANDS, "-h", "--help"):
        argv = ["speed", *argv]
    return parse_arguments("vgmpi bench", __doc__, COMMANDS, argv)


def _speed(parser: argparse.ArgumentParser) -> None:
    say = parser.add_argument
    say(
        "--particles",
        nargs="+",
        type=positive_number,
        default=[600_000],
        metavar="N",
        help="particle counts, such as 1e5 4e5 1e6; small counts fit the last cache, which other"
        " users of a machine may share",
    )
    say(
        "--laws",
        nargs="+",
        metavar="LAW",
        help=f"materials, any of {', '.join(registry)}; default: all",
    )
    say(
        "--precision",
        nargs="+",
        choices=("single", "double"),
        default=["single", "double"],
        help="precision of vgmpi; the other codes use single precision",
    )
    say("--rounds", type=positive_number, default=5, metavar="N", help="rounds of all programs")
    say("--seconds", type=positive_seconds, default=0.6, help="length of a round [s]")
    say(
        "--only",
        nargs="+",
        default=[],
        metavar="WORD",
        help='rows whose label contains one of these, such as vgmpi, Taichi, "1 core", "2 ranks",'
        " machine (bandwidth and peak); the first row of each material is always measured",
    )
    say(
        "--cpu",
        choices=("avx2",),
        help="also run vgmpi without 512-bit vectors",
    )
    say("--json", type=Path, metavar="FILE", help="write all rounds to this file")


def _compare(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("files", nargs=2, type=Path, metavar="JSON", help="two files of --json")


def contestants(law: str, args: argparse.Namespace) -> list[Contestant]:
    """Return the contestants of one law; the first is this solver on one core."""
    contestants_of_law = []
    for precision in args.precision:
        contestants_of_law.append(Contestant("own", precision))
        if args.cpu:
            contestants_of_law.append(Contestant("own", precision, cpu=args.cpu))
        contestants_of_law.append(Contestant("own", precision, threads=2))
        contestants_of_law.append(Contestant("own", precision, ranks=2))
    if law in interleaved_rounds.RIVAL_LAWS:
        contestants_of_law += [Contestant("plain"), Contestant("taichi_rival")]
        contestants_of_law += [Contestant("taichi_rival", threads=2), Contestant("warp_rival")]
    if args.only:
        words = [word.lower() for word in args.only]
        selected = [
            c for c in contestants_of_law[1:] if any(word in c.label.lower() for word in words)
        ]
        contestants_of_law = [contestants_of_law[0], *selected]
    return contestants_of_law


def measure(args: argparse.Namespace, say) -> dict:
    """All that was asked for, as plain JSON values. Raises BenchError."""
    laws = args.laws or list(registry)
    cases = [Case(law, n) for n in args.particles for law in laws]
    roofs = {}
    if not args.only or "machine" in args.only:
        say("machine: memory bandwidth and peak")
        roofs = roofline.measure_roofline()
    results: dict[str, Any] = {
        "when": time.strftime("%Y-%m-%d %H:%M:%S"),
        "command": sys.argv[1:],
        "machine": machine(),
        "versions": versions(),
        "roof": roofs,
        "groups": [],
    }
    for case in cases:
        need = roofline.operation_count(case.material)
        contestants_of_law = contestants(case.law, args)
        with tempfile.TemporaryDirectory(prefix="vgmpi-bench-") as folder:
            say(f"{case.law}, {case.particles:,} particles: preparing")
            lay_out(
                case,
                sorted({c.precision for c in contestants_of_law if c.module == "own"}),
                Path(folder),
            )
            rows = interleaved_rounds.run_interleaved(
                case, contestants_of_law, args.rounds, args.seconds, Path(folder), say
            )
        for row in rows:
            results["versions"] |= row.pop("versions", {})
            if roofs:
                cores = row["ranks"] * row["threads"]
                row["floor"] = roofline.minimum_time(roofs, need, row["precision"], cores)
        group = {"law": case.law, "particles": case.particles, "rounds": args.rounds, **need}
        results["groups"].append({**group, "rows": rows})
    return results


def machine() -> dict:
    """Name of the processor, cores this process may use, caches of one core."""
    name, caches = "unknown processor", []
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        name = next(
            line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")
        )
        for index in sorted(Path("/sys/devices/system/cpu/cpu0/cache").glob("index*")):
            kind, level, size = ((index / f).read_text().strip() for f in ("type", "level", "size"))
            if kind != "Instruction":
                caches.append(f"L{level} {size}")
    except (OSError, StopIteration):
        pass
    cores = len(os.sched_getaffinity(0))
    return {"name": name, "cores": cores, "caches": ", ".join(caches) or "unknown"}


@exit_code_from_exceptions
def main(argv: list[str] | None = None) -> int:
    """Run the command; returns the exit code."""
    words = sys.argv[1:] if argv is None else argv
    return run_command("vgmpi bench", arguments(words), (BenchError,))


def _run_compare(args: argparse.Namespace) -> int:
    print(result_tables.compare(*(_read(path) for path in args.files)))
    return 0


def _run_speed(args: argparse.Namespace) -> int:
    if args.json:
        check_file_can_be_written(args.json)
    results = measure(args, print_progress)
    if args.json:
        replace_file(args.json, json.dumps(results, indent=1) + "\n")
    print(result_tables.text(results))
    failed = result_tables.failures(results)
    for line in failed:
        print(f"vgmpi bench: {line}", file=sys.stderr)
    return 1 if failed else 0


def _read(path: Path) -> dict:
    try:
        results = json.loads(path.read_text())
        if not isinstance(results, dict) or "groups" not in results:
            raise ValueError("it is not one of this program's")
        return results
    except (OSError, ValueError) as error:
        raise BenchError(f"{path}: cannot be read: {error}") from None


COMMANDS = {  # what it does, its flags, how it runs
    "speed": ("measure the throughput (the default)", _speed, _run_speed),
    "card": ("compare programs on a GPU", gpu.flags, gpu.run),
    "board": (
        "measure error against seconds beside other solvers",
        board_command.flags,
        board_command.run_board,
    ),
    "compare": ("print two measurements side by side", _compare, _run_compare),
}

if __name__ == "__main__":
    sys.exit(main())
