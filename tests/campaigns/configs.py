"""Spoiled configurations of PhysGaussian and VersaGauss through `vgmpi convert` and the check."""

import copy
import json
import random
import re
from pathlib import Path
from typing import Any

from tests.campaigns import worker
from tests.campaigns.result import Result
from tests.support import foreign_configs

NAME, COUNT, SMALL = "configs", 2000, 20

VALUES: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 1e-300, 1e300, -1e300, 2**63, float("nan"), float("inf"), "", "é",
    "../x", "\x1b[31m", [], [1], [1, 2, 3], [[1, 2, 3]], ["a"], {}, {"a": 1}, [float("nan")] * 3,
    "9" * 500, [0] * 1000,
)  # fmt: skip


def bases() -> list[dict]:
    """Good configurations."""
    water = ({"material": "fluid", "bulk_modulus": 900}, {"center_point": [2, 2, 2.5]})
    jelly = ({"material": "jelly", "E": 2e4, "nu": 0.3}, {"center_point": [2, 2, 1.5]})
    turning = {"boundary_conditions": [foreign_configs.BOX, foreign_configs.TURN]}
    return [
        foreign_configs.ONE,
        foreign_configs.ONE | {"boundary_conditions": [foreign_configs.HOLD]},
        foreign_configs.ONE | turning,
        foreign_configs.several(water, jelly),
    ]


def spoiled(draw: random.Random, config: dict) -> bytes:
    """A configuration after one to three blows, as JSON; sometimes no JSON any more."""
    config = copy.deepcopy(config)
    for _ in range(draw.choice((1, 1, 2, 3))):
        holder, key = draw.choice(list(_places(config)))
        match draw.randrange(6):
            case 0:
                del holder[key]
            case 1 if isinstance(holder, dict):
                holder[draw.choice(("x", "Material", " E", "g", "object_num"))] = holder[key]
            case 2 if isinstance(holder[key], int | float):
                holder[key] *= draw.choice((-1, 0, 1e-9, 1e-3, 10, 1e3, 1e9, 1e200))
            case _:
                holder[key] = copy.deepcopy(draw.choice(VALUES))
        if not config:
            break
    data = json.dumps(config).encode()
    if draw.random() < 0.1:
        cut = draw.randrange(len(data))
        data = draw.choice((data[:cut], data[:cut] + b"\xff" + data[cut:], b"\xef\xbb\xbf" + data))
    return data


def _places(node: Any):
    """Yield (holder, key or index) of every value."""
    items = node.items() if isinstance(node, dict) else enumerate(node)
    for key, value in list(items):
        yield node, key
        if isinstance(value, dict | list):
            yield from _places(value)


def campaign(count: int, seed: int, folder: Path) -> Result:
    """count: of configurations. Those that fail stay in the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    flags = ["--gaussians", str(foreign_configs.egg(folder))]
    good, cases, paths = bases(), [], []
    for k in range(count):
        draw, path = random.Random(f"{seed} {k}"), folder / f"{k:04}.json"
        path.write_bytes(spoiled(draw, draw.choice(good)))
        paths.append(path)
        scene = str(path.with_suffix(".toml"))
        convert = ["convert", str(path), "-o", scene, "--overwrite", *flags]
        cases.append([convert, ["vgmpi", scene, "--check", "-q"]])
    first = folder / "good.json"
    first.write_text(json.dumps(good[0]))
    warm = [["convert", str(first), "-o", str(folder / "good.toml"), "--overwrite", *flags]]
    return worker.judged(paths, cases, warm, _where, _named)


def _named(path: Path, command: list[str], code: int) -> str:
    return "passed" if code == 0 else f"refused by {command[0]}"


def _where(path: Path, command: list[str]) -> re.Pattern:
    """How lines begin: with the file and a key, or the file of a body."""
    return re.compile(rf"{re.escape(str(path.parent))}/\S+?(?::\d+)?: .+")
