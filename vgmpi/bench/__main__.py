"""`python -m vgmpi.bench`: this solver by stage and law beside its rivals on one scene."""

import argparse
import json
import os
import sys
import tempfile
import time
from pathlib import Path

from ..ends import guarded
from ..materials import registry
from ..solver.run import versions
from . import card, roof, rounds, table
from .commands import parse_arguments, print_progress, run_command
from .rounds import Contestant
from .scene import BenchError, Case, lay_out


def arguments(argv: list[str]) -> argparse.Namespace:
    """The flags; `speed` is meant where no command is named."""
    if "--compare" in argv:
        argv = ["compare", *(word for word in argv if word != "--compare")]
    elif argv[:2] == ["--engine", "cuda"]:
        argv = ["card", *argv[2:]]
    elif not argv or argv[0] not in (*COMMANDS, "-h", "--help"):
        argv = ["speed", *argv]
    return parse_arguments("python -m vgmpi.bench", __doc__, COMMANDS, argv)


def _speed(parser: argparse.ArgumentParser) -> None:
    def number(text: str) -> int:
        if int(float(text)) < 1:
            raise ValueError
        return int(float(text))

    say = parser.add_argument
    say("--particles", nargs="+", type=number, default=[100_000], metavar="N", help="1e5 4e5 1e6")
    say("--laws", nargs="+", metavar="LAW", help=f"of {', '.join(registry)}; default: all")
    say(
        "--precision",
        nargs="+",
        choices=("single", "double"),
        default=["single", "double"],
        help="of this solver; the rivals compute in single precision",
    )
    say("--rounds", type=number, default=5, metavar="N", help="of all contestants, default 5")
    say("--seconds", type=float, default=0.6, help="length of a round, default 0.6")
    say(
        "--only",
        nargs="+",
        default=[],
        metavar="WORD",
        help='rows with one of these in their label, such as vgmpi, Taichi, "1 core", "2 ranks",'
        " machine (bandwidth and peak); each law's first row is always there",
    )
    say(
        "--cpu",
        choices=("avx2",),
        help="run this solver also as on a processor without 512-bit vectors",
    )
    say("--json", type=Path, metavar="FILE", help="keep all rounds")


def _compare(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("files", nargs=2, type=Path, metavar="JSON", help="before, after")


def contestants(law: str, given: argparse.Namespace) -> list[Contestant]:
    """Rows of one law; the first is this solver on one core."""
    found = []
    for precision in given.precision:
        found.append(Contestant("own", precision))
        if given.cpu:
            found.append(Contestant("own", precision, cpu=given.cpu))
        found.append(Contestant("own", precision, threads=2))
        found.append(Contestant("own", precision, ranks=2))
    if law in rounds.RIVAL_LAWS:
        found += [Contestant("plain"), Contestant("taichi_rival")]
        found += [Contestant("taichi_rival", threads=2), Contestant("warp_rival")]
    if given.only:
        words = [word.lower() for word in given.only]
        kept = [c for c in found[1:] if any(word in c.label.lower() for word in words)]
        found = [found[0], *kept]
    return found


def measure(given: argparse.Namespace, say) -> dict:
    """All that was asked for, as plain JSON values. Raises BenchError."""
    laws = given.laws or list(registry)
    cases = [Case(law, n) for n in given.particles for law in laws]
    roofs = {}
    if not given.only or "machine" in given.only:
        say("machine: memory bandwidth and peak")
        roofs = roof.machine_roof()
    results = {
        "when": time.strftime("%Y-%m-%d %H:%M:%S"),
        "command": sys.argv[1:],
        "machine": machine(),
        "versions": versions(),
        "roof": roofs,
        "groups": [],
    }
    for case in cases:
        need = roof.needs(case.material)
        wanted = contestants(case.law, given)
        with tempfile.TemporaryDirectory(prefix="vgmpi-bench-") as folder:
            say(f"{case.law}, {case.particles:,} particles: preparing")
            lay_out(case, sorted({c.precision for c in wanted if c.module == "own"}), Path(folder))
            rows = rounds.contest(case, wanted, given.rounds, given.seconds, Path(folder), say)
        for row in rows:
            results["versions"] |= row.pop("versions", {})
            if roofs:
                cores = row["ranks"] * row["threads"]
                row["floor"] = roof.floor(roofs, need, row["precision"], cores)
        group = {"law": case.law, "particles": case.particles, "rounds": given.rounds, **need}
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


@guarded
def main(argv: list[str] | None = None) -> int:
    """Run the command; returns the exit code."""
    words = sys.argv[1:] if argv is None else argv
    return run_command("vgmpi.bench", arguments(words), (BenchError,))


def _run_compare(given: argparse.Namespace) -> int:
    print(table.compare(*(_read(path) for path in given.files)))
    return 0


def _run_speed(given: argparse.Namespace) -> int:
    results = measure(given, print_progress)
    if given.json:
        given.json.write_text(json.dumps(results, indent=1) + "\n")
    print(table.text(results))
    wrong = table.failures(results)
    for line in wrong:
        print(f"vgmpi.bench: {line}", file=sys.stderr)
    return 1 if wrong else 0


def _read(path: Path) -> dict:
    try:
        found = json.loads(path.read_text())
        if not isinstance(found, dict) or "groups" not in found:
            raise ValueError("it is not one of this program's")
        return found
    except (OSError, ValueError) as error:
        raise BenchError(f"{path}: cannot be read: {error}") from None


COMMANDS = {  # what it does, its flags, how it runs
    "speed": ("measure (the default)", _speed, _run_speed),
    "card": ("a graphics card beside others on it", card.flags, card.run),
    "compare": ("print two measurements side by side", _compare, _run_compare),
}

if __name__ == "__main__":
    sys.exit(main())
