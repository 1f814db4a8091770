"""What campaigns share: cases one after the other, each from its own random numbers."""

import collections
import shutil
import traceback
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.campaigns.result import Result

Case = Callable[[int, np.random.Generator, Path], str]


def each(count: int, seed: int, folder: Path, case: Case) -> Result:
    """case(number, random, its folder) returns the name of what came out of it; one that raises
    failed, and its folder is kept, with why.txt. Cases are the same whatever their count."""
    outcomes: collections.Counter[str] = collections.Counter()
    failures = []
    for k in range(count):
        own = folder / f"case_{seed}_{k:03d}"
        shutil.rmtree(own, ignore_errors=True)
        own.mkdir()
        try:
            outcomes[case(k, np.random.default_rng([seed, k]), own)] += 1
        except (Exception, pytest.fail.Exception) as error:
            (own / "why.txt").write_text(traceback.format_exc())
            line = (str(error).splitlines() or [""])[0]
            failures.append(f"{own}: {type(error).__name__}: {line[:300]}")
        else:
            shutil.rmtree(own)
    return Result(count, dict(outcomes), failures)
