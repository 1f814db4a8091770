"""`python -m vgmpi bench`: this solver by stage and law beside its rivals on one scene."""

import argparse
import json
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from vgmpi.materials import registry
from vgmpi.runtime.command_line import exit_code_from_exceptions
from vgmpi.runtime.user_files import replace_file
from vgmpi.runtime.versions import versions

from . import gpu, interleaved_rounds, roofline
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

ORDER = ("p2g", "halo", "grid", "g2p", "wait", "sort")


def per_step(row: dict, particles: int, clock: str = "seconds") -> np.ndarray:
    """Time of a particle and step [ns] of every round."""
    return np.array([1e9 * r[clock] / r["steps"] / particles for r in row["rounds"]])


def text(results: dict) -> str:
    """All that a run found."""
    lines = [_machine(results)]
    for group in results["groups"]:
        lines += ["", _heading(group), *_rows(group)]
    return "\n".join(lines)


def _machine(results: dict) -> str:
    m, roof = results["machine"], results["roof"]
    versions = ", ".join(f"{k} {v[:12]}" for k, v in results["versions"].items())
    lines = [f"{m['name']}, {m['cores']} cores, caches {m['caches']}", versions]
    if roof:
        for name in ("copy", "triad"):
            cores = ", ".join(f"{v:.1f} on {k}" for k, v in roof[name].items())
            lines.append(f"{name:5s}  {cores} core(s) [GB/s]")
        peak = ", ".join(f"{v:.0f} {k}" for k, v in roof["fma"].items())
        lines.append(f"fma    {peak} [GFlop/s per core]")
    return "\n".join(lines)


def _heading(group: dict) -> str:
    n, words = group["particles"], group["words"]
    return (
        f"{group['law']}, {n:,} particles: ns per particle and step, least and median of"
        f" {group['rounds']} rounds; at least {words} words ({4e-6 * words * n:.0f} MB in single"
        f" precision) and {group['flops']} flops"
    )


def stages_of(group: dict) -> list[str]:
    """Stages that any row has, in the order of a step."""
    present = {s for row in group["rows"] for r in row.get("rounds", []) for s in r["stages"]}
    return [s for s in ORDER if s in present] + sorted(present - set(ORDER))


def _label(row: dict) -> str:
    words = (row["name"], row["precision"], row["on"], row["cpu"])
    return " ".join(word for word in words if word)


def _rows(group: dict) -> list[str]:
    stages, n = stages_of(group), group["particles"]
    head = f"  {'':31s} {'time':>6s} {'median':>6s} {'Mpps':>6s}"
    head += "".join(f"{s:>6s}" for s in stages)
    head += f" {'floor':>6s} {'reached':>7s} {'speed':>7s} {'slower':>7s}"
    lines = [head]
    for row in group["rows"]:
        label = f"  {_label(row):31s}"
        if not row.get("rounds"):
            lines.append(f"{label} {row.get('note', 'not run')}")
            continue
        time = per_step(row, n)
        minimum, fastest = float(time.min()), row["rounds"][int(time.argmin())]
        line = f"{label} {minimum:6.1f} {np.median(time):6.1f} {1e3 / minimum:6.2f}"
        for stage in stages:
            spent = 1e9 * fastest["stages"].get(stage, 0.0) / fastest["steps"] / n
            line += f"{spent:6.1f}" if fastest["stages"] else f"{'':6s}"
        low = row.get("floor")
        line += f" {low:6.1f} {low / minimum:7.0%}" if low else f" {'-':>6s} {'-':>7s}"
        ratio = speed(group, row)
        line += f" {ratio:7.3f} {1 / ratio:7.2f}" if ratio else ""
        line += " (wall)" if row["clock"] == "wall" else ""
        lines.append(line)
        if "wrong" in row:
            lines.append(f"    {row['wrong']}")
    busy = _busy(group)
    if busy > 1.1:
        lines.append(
            f"  careful: other programs kept the cores busy ({busy:.2f} s passed per second of"
            " work); rows of wall time suffer most"
        )
    return lines


def _busy(group: dict) -> float:
    """Wall time over processor time of the rows on one core."""
    every = [r for row in group["rows"] if row["clock"] == "cpu" for r in row.get("rounds", [])]
    return sum(r["wall"] for r in every) / max(sum(r["seconds"] for r in every), 1e-9)


def speed(group: dict, row: dict) -> float | None:
    """Return the speed relative to the group's first row: median ratio of neighboring rounds.

    Rows measured by wall time are compared with the wall time of the first row.
    """
    first = group["rows"][0]
    if not (first.get("rounds") and row.get("rounds")):
        return None
    clock = "wall" if row["clock"] == "wall" else "seconds"
    n = group["particles"]
    return float(np.median(per_step(first, n, clock) / per_step(row, n, clock)))


def failures(results: dict) -> list[str]:
    """Rows that computed something else, and those whose program failed."""
    return [
        f"{group['law']}, {_label(row)}: {row.get('wrong', row.get('note'))}"
        for group in results["groups"]
        for row in group["rows"]
        if "wrong" in row or row.get("failed")
    ]


def compare(a: dict, b: dict) -> str:
    """Two runs side by side: time of each row in a and b, and b / a.

    The last column divides by what the plain numba loops, which do not change, did between the
    runs: the machine's pace.
    """
    lines = []
    if a["machine"] != b["machine"]:
        names = [f"{r['machine']['name']}, {r['machine']['cores']} cores" for r in (a, b)]
        lines.append(f"careful: measured on two machines: {names[0]} | {names[1]}")
    lines.append(" | ".join(f"{r['versions'].get('commit', '?')[:12]} {r['when']}" for r in (a, b)))
    theirs = {(g["law"], g["particles"]): g for g in b["groups"]}
    for group in a["groups"]:
        other = theirs.get((group["law"], group["particles"]))
        if other:
            lines += _side_by_side(group, other)
    if len(lines) == 1 + (a["machine"] != b["machine"]):
        lines.append("the two have no row in common")
    return "\n".join(lines)


def _side_by_side(group: dict, other: dict) -> list[str]:
    n = group["particles"]
    pairs = []
    for row in group["rows"]:
        for twin in other["rows"]:
            if _label(twin) == _label(row) and row.get("rounds") and twin.get("rounds"):
                pairs.append((row, per_step(row, n), per_step(twin, n)))
    pace = [np.median(y) / np.median(x) for row, x, y in pairs if row["module"] == "plain"]
    lines = [
        "",
        f"{group['law']}, {n:,} particles: ns per particle and step",
        f"  {'':31s} {'A':>7s} {'B':>7s} {'B / A':>7s} {'and least':>10s} {'at equal pace':>14s}",
    ]
    for row, x, y in pairs:
        ratio = np.median(y) / np.median(x)
        line = f"  {_label(row):31s} {np.median(x):7.1f} {np.median(y):7.1f} {ratio:7.3f}"
        line += f" {y.min() / x.min():10.3f}"
        lines.append(line + (f" {ratio / pace[0]:14.3f}" if pace else ""))
    return lines


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
    print(compare(*(_read(path) for path in args.files)))
    return 0


def _run_speed(args: argparse.Namespace) -> int:
    if args.json:
        check_file_can_be_written(args.json)
    results = measure(args, print_progress)
    if args.json:
        replace_file(args.json, json.dumps(results, indent=1) + "\n")
    print(text(results))
    failed = failures(results)
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
