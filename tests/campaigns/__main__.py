"""Campaigns: many hostile cases from a fixed seed, `python -m tests.campaigns [NAME ...]`.

A module of this package is one when it has NAME, COUNT (cases of the full size), SMALL (cases in
its test) and `campaign(count, seed, folder) -> Result`; MARKS, if it has them, are those of its
test. `folder` is there and keeps the cases that failed. What this machine cannot do, a campaign
says by pytest.skip.
"""

import argparse
import importlib
import pkgutil
import shutil
import sys
import time
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]


def campaigns() -> dict[str, ModuleType]:
    """Every campaign of the package by its name."""
    found = {}
    for module in pkgutil.iter_modules([str(Path(__file__).parent)]):
        if module.name != "__main__" and not module.name.startswith("test_"):
            one = importlib.import_module(f"tests.campaigns.{module.name}")
            if hasattr(one, "campaign"):
                found[one.NAME] = one
    return dict(sorted(found.items()))


def _run(one: ModuleType, count: int, seed: int, keep: Path) -> bool:
    """Run a campaign and print what it found; whether nothing failed."""
    folder, begin = keep / one.NAME, time.monotonic()
    shutil.rmtree(folder, ignore_errors=True)  # cases that an earlier run kept
    folder.mkdir(parents=True)
    print(f"{one.NAME}: {count} cases, seed {seed} ...", flush=True)
    try:
        result = one.campaign(count, seed, folder)
    except pytest.skip.Exception as reason:
        print(f"{one.NAME}: left out: {reason}", flush=True)
        return True
    counts = ", ".join(f"{number} {name}" for name, number in sorted(result.counts.items()))
    print(
        f"{one.NAME}: {result.tried} tried: {counts}; {len(result.failures)} failed"
        f" ({time.monotonic() - begin:.0f} s)"
    )
    for line in result.failures:
        print(f"    {line}")
    sys.stdout.flush()
    return not result.failures


def main(argv: list[str] | None = None) -> int:
    """The command; 1 where a case failed."""
    there = campaigns()
    parser = argparse.ArgumentParser(prog="python -m tests.campaigns", description=__doc__)
    parser.add_argument(
        "names", nargs="*", metavar="NAME", help=f"of {', '.join(there)}; default: all"
    )
    parser.add_argument("--count", type=int, help="cases of each; default: its full size")
    parser.add_argument("--seed", type=int, default=0, help="default 0")
    parser.add_argument(
        "--keep", dest="failures", type=Path, default=ROOT / ".cache" / "campaigns",
        metavar="FOLDER",
        help="where the cases that failed lie afterwards; default .cache/campaigns",
    )  # fmt: skip
    given = parser.parse_args(argv)
    for name in given.names:
        if name not in there:
            parser.error(f"there is no campaign {name}; there are {', '.join(there)}")
    chosen = [there[name] for name in given.names or there]
    passed = [_run(one, given.count or one.COUNT, given.seed, given.failures) for one in chosen]
    return 0 if all(passed) else 1


if __name__ == "__main__":
    sys.exit(main())
