"""The card's kernels compiled for cards that need not be here: registers, spills, shared memory,
and how many warps fit on a multiprocessor at a time. Nothing is run.
"""

import tempfile
from collections.abc import Iterator
from pathlib import Path

from tests.support.simulate import begin
from vgmpi.materials import registry
from vgmpi.solver.run_options import ENGINES
from vgmpi.tools.bench.benchmark_case import KEYS

CARDS = (80, 90)
SCENE = """
[domain]
size = [0.4, 0.4, 0.4]
cell = 0.04
boundary = { default = "slip", bottom = "stick", east = { kind = "separate", friction = 0.2 } }
[time]
end = 1
[accuracy]
pressure = "explicit"
precision = "PRECISION"
ACCURACY
"""
BODY = """
[material.NAME]
kind = "KIND"
KEYS
[[object]]
name = "NAME"
material = "NAME"
shape = { box = [[LOW, 0, 0], [HIGH, 0.12, 0.12]] }
PLUS
"""
POST = """
[[object]]
name = "post"
role = "scenery"
collider = true
shape = { box = [[0.3, 0, 0], [0.38, 0.4, 0.1]] }
"""
MIX = '[[coupling]]\nkind = "mixing"\nbetween = ["fluid", "milk"]\ndiffusivity = 1e-4\n'
SEEP = '[[coupling]]\nkind = "drag"\nbetween = ["fluid", "sand"]\nhydraulic_conductivity = 1e-2\n'
DRIVEN = 'motion = { velocity = [1, 0, 0], end_time = "2 ms" }\n'
COLORS = '[appearance]\ncolor_transfer = "step"\n'


def _body(name: str, kind: str, low: float = 0.0, plus: str = "") -> str:
    keys = "\n".join(f"{k} = {v if isinstance(v, float) else repr(v)}" for k, v in
                     KEYS.get(kind, {}).items())  # fmt: skip
    text = BODY.replace("NAME", name).replace("KIND", kind).replace("KEYS", keys)
    return text.replace("LOW", str(low)).replace("HIGH", str(low + 0.12)).replace("PLUS", plus)


# what is below [accuracy], and the rest of a scene: each law alone, and what asks for more kernels
CASES = {kind: ("", _body(kind, kind)) for kind in registry} | {
    "contact, colliders": ("", _body("fluid", "fluid") + _body("elastic", "elastic", 0.16) + POST),
    "bspline": ('transfer = "pic"\ngradient = "bspline"', _body("elastic", "elastic")),
    "density correction": ('volume_correction = "density"', _body("fluid", "fluid")),
    "dilatation by cells": ('dilatation = "cells"', _body("fluid", "fluid")),
    "aflip": ('transfer = "aflip"\nflip_decay_time = "5 ms"', _body("fluid", "fluid")),
    "several densities": (
        "", _body("fluid", "fluid")
        + _body("oil", "fluid", 0.08).replace('kind = "fluid"', 'kind = "fluid"\ndensity = 800.0'),
    ),
    "driven": ("", _body("elastic", "elastic", plus=DRIVEN)),
    "couplings, colors": (
        "", COLORS + _body("fluid", "fluid") + _body("milk", "fluid", 0.08) + _body("sand", "sand")
        + MIX + SEEP,
    ),
}  # fmt: skip


def compiled(
    name: str, precision: str = "single", cards: tuple[int, ...] = CARDS, only: tuple = ()
) -> list:
    """Return the kernels (engines.cuda.compiled.Compiled) that a case launches.

    Args:
        name: Case of CASES.
        precision: "single" or "double".
        cards: Compute capabilities times 10.
        only: Names of the kernels, empty for all.
    """
    from vgmpi.solver.engines.cuda.offline_compile import kernels_of, offline_engine

    accuracy, body_text = CASES[name]
    text = SCENE.replace("PRECISION", precision).replace("ACCURACY", accuracy) + body_text
    ENGINES["compiled"] = offline_engine(cards, only)
    try:
        with tempfile.TemporaryDirectory() as folder:
            simulation, _ = begin(Path(folder), text, engine="compiled")
    finally:
        del ENGINES["compiled"]
    return kernels_of(simulation)


HEAD = (
    "| kernel | law, or scene | registers A100, H100 | stack | spilled | shared | warps of 64 |\n"
    "|---|---|---|---|---|---|---|"
)


def lines(precision: str) -> Iterator[str]:
    """A table as Markdown, a row per kernel; those that several cases have alike once."""
    yield HEAD
    listed = set()
    for name in CASES:
        rows: dict[tuple, list] = {}
        for k, item in enumerate(compiled(name, precision)):
            rows.setdefault((item.name, item.law, k // len(CARDS)), []).append(item)
        for (kernel, law, _), kernels in rows.items():
            numbers = [(item.registers, item.warps) for item in kernels]
            key = kernel, law, tuple(numbers), kernels[0].stack
            if key in listed:
                continue
            listed.add(key)
            yield (
                f"| {kernel} | {name if law == '-' else law} |"
                f" {', '.join(str(r) for r, _ in numbers)} | {kernels[0].stack} |"
                f" {max(item.spilled for item in kernels)} | {kernels[0].shared / 1024:.1f} KiB |"
                f" {', '.join(str(w) for _, w in numbers)} |"
            )
