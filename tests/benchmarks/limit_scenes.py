"""Scenes at the ends of what a scene may say, as text of public keys, and what each must do."""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from vgmpi.api import Run
from vgmpi.materials import registry
from vgmpi.tools.bench.benchmark_case import KEYS

DX = 0.02  # [m]
WATER = {"kind": "fluid", "tait_coefficient": 5e4}
RUBBER = {"kind": "elastic", "density": 1000, "youngs_modulus": 1e5}
LOW, HIGH = (0.12, 0.16, 0.16), (0.20, 0.24, 0.24)  # a cube of 4 cells, and one cell to its east:
NEXT = ((0.22, 0.16, 0.16), (0.30, 0.24, 0.24))
# stiff enough for 10 m/s to stay well below the speed of sound, where the benchmark's are not
STIFF = {
    "fluid": {"tait_coefficient": 1e6},
    "paste": {"preset": "ketchup", "tait_coefficient": 1e6},
    "foam": {"preset": "shaving foam", "youngs_modulus": 1e5},
    "snow": {"youngs_modulus": 1e6},
}


@dataclass(frozen=True)
class Row:
    """One scene and its outcome.

    code: 0 runs to the end, 2 is refused, 3 blows up. says: words that must be logged or be in the
    refusal. momentum: nothing pushes on it, so momentum must stay. check: (run, its first arrays)
    -> (as expected, what was found) of a run that came to its end. fast: for a quick look.
    """

    name: str
    text: str
    expected: str
    code: int = 0
    says: tuple[str, ...] = ()
    momentum: bool = False
    check: Callable[[Run, dict], tuple[bool, str]] | None = None
    fast: bool = False
    steps: int = 20_000  # more are taken for a hang


def toml(values: dict) -> str:
    """Keys of a table."""
    return "\n".join(f"{key} = {json.dumps(value)}" for key, value in values.items())


def box(name: str, material: str, low: Sequence, high: Sequence, **more) -> str:
    """An object of this material between two corners [m]."""
    shape = f"{{ box = [{json.dumps(list(low))}, {json.dumps(list(high))}] }}"
    keys = {"name": name, "material": material, **more}
    return f"[[object]]\n{toml(keys)}\nshape = {shape}\n"


def scene(
    materials: dict[str, dict],
    *rest: str,
    end: float,
    gravity: float = 0.0,
    size: Sequence = (0.4, 0.4, 0.4),
    walls: str = '"slip"',
    dt: float = 0.0,
) -> str:
    """The text of a scene. rest: objects and couplings."""
    named = "".join(f"[material.{name}]\n{toml(keys)}\n" for name, keys in materials.items())
    return (
        '[accuracy]\npressure = "explicit"\nprecision = "double"\n'
        f"[domain]\nsize = {json.dumps(list(size))}\ncell = {DX}\ngravity = [0, 0, {-gravity}]\n"
        f"boundary = {{ default = {walls} }}\n"
        f"[time]\nend = {end}\nframes = 2\ndt = {dt}\n{named}{''.join(rest)}"
    )


def coupling(kind: str, one: str, other: str, **keys) -> str:
    """A coupling of two materials."""
    return f"[[coupling]]\n{toml({'between': [one, other], 'kind': kind, **keys})}\n"


def of_law(kind: str) -> dict:
    """The keys of a material that can be thrown at 10 m/s."""
    return {"kind": kind, **STIFF.get(kind, KEYS.get(kind, {}))}


def collision(one: dict, other: dict, speed: float, end: float, **more) -> str:
    """Two cubes meet at `speed` [m/s] in the middle of an empty box, without weight."""
    return scene(
        {"one": one, "other": other},
        box("left", "one", LOW, HIGH, velocity=[speed, 0, 0], **more),
        box("right", "other", *NEXT, **more),
        end=end,
    )


def middle(run: Run, thing: int, axis: int = 2) -> float:
    """Mean position of an object's particles [m]."""
    found = run.arrays("positions", "object")
    return float(found["positions"][found["object"] == thing, axis].mean())


def _moved(thing: int, low: float, high: float, axis: int = 2):
    """The object's middle moves by low .. high [m]."""

    def check(run: Run, first: dict) -> tuple[bool, str]:
        way = middle(run, thing, axis) - float(
            first["positions"][first["object"] == thing, axis].mean()
        )
        return low <= way <= high, f"moved {way * 1e3:+.2f} mm"

    return check


def _density() -> list[Row]:
    pool = ((0.0, 0.0, 0.0), (0.2, 0.2, 0.1))
    cube = ((0.06, 0.06, 0.1), (0.14, 0.14, 0.18))

    def afloat(fluid: dict, solid: dict) -> str:
        return scene(
            {"stuff": fluid, "toy": solid},
            box("pool", "stuff", *pool),
            box("block", "toy", *cube),
            end=0.05,
            gravity=9.8,
            size=(0.2, 0.2, 0.3),
        )

    light, heavy = {"density": 1}, {"density": 1000}
    foam = {"kind": "foam", "preset": "shaving foam", "density": 7.85}
    metal = {"kind": "metal", "youngs_modulus": 1e6, "yield_stress": 1e4, "density": 7850}
    gas = {**WATER, "tait_coefficient": 1e3, **light}
    mixture = scene(
        {"gas": gas, "water": WATER},
        box("left", "gas", LOW, HIGH, velocity=[0.5, 0, 0]),
        box("right", "water", (0.20, 0.16, 0.16), (0.28, 0.24, 0.24)),
        coupling("mixing", "gas", "water", diffusivity=1e-4),
        end=0.02,
    )
    return [
        Row("1000:1 block on a fluid", afloat(gas, {**RUBBER, **heavy}),
            "sinks: 4 .. 12.3 mm", check=_moved(1, -0.0123, -0.004)),
        Row("1:1000 block on a fluid", afloat(WATER, {**RUBBER, "youngs_modulus": 1e3, **light}),
            "floats: within 4 mm", check=_moved(1, -0.004, 0.004)),
        Row("1000:1 metal hits foam", collision(metal, foam, 1.0, 0.03),
            "metal goes on", momentum=True, check=_moved(0, 0.028, 0.0301, axis=0)),
        Row("1:1000 foam hits metal", collision(foam, metal, 1.0, 0.03),
            "metal stays", momentum=True, check=_moved(1, -1e-4, 1e-4, axis=0)),
        Row("1:1000 fluids mix", mixture, "runs", momentum=True, fast=True),
    ]  # fmt: skip


def _stiffness() -> list[Row]:
    rows = []
    for power in range(3, 8):
        law = {**WATER, "tait_coefficient": 10.0**power}
        rows.append(Row(f"k = 1e{power} Pa", collision(law, law, 0.5, 0.05), "runs",
                        momentum=True, fast=power in (3, 7)))  # fmt: skip
    for power in range(3, 9):
        law = {**RUBBER, "youngs_modulus": 10.0**power}
        rows.append(Row(f"E = 1e{power} Pa", collision(law, law, 0.5, 0.05), "runs",
                        momentum=True, fast=power in (3, 8)))  # fmt: skip
    law = {**RUBBER, "poisson_ratio": 0.49}
    rows.append(Row("nu = .49", collision(law, law, 0.5, 0.05), "warned of, runs",
                    says=("poisson_ratio", "'one'"), momentum=True, fast=True))  # fmt: skip
    return rows


def _sharing() -> list[Row]:
    rows = []
    for power in (-12, -9, -6, -4, -3, -2, 0, 2):
        text = scene(
            {"water": WATER, "grains": {"kind": "sand"}},
            box("pores", "water", LOW, HIGH, velocity=[0.5, 0, 0], volume_fraction=0.4),
            box("bed", "grains", LOW, HIGH),
            coupling("drag", "water", "grains", hydraulic_conductivity=10.0**power),
            end=0.01,
        )
        rows.append(Row(f"hydraulic conductivity 1e{power} m/s", text, "runs", momentum=True,
                        fast=power in (-12, 2)))  # fmt: skip
    # at 1.0 the drift is 2.7 times as fast as sound
    for diffusivity in (0.0, 1e-3, 0.02, 0.2, 1.0):

        def follows(run: Run, first: dict, diffusivity=diffusivity) -> tuple[bool, str]:
            share = 6.0 * diffusivity * first["bound"] / DX**2
            good = share <= 1.0 + 1e-12 and (diffusivity < 0.2 or share > 0.999)
            return good, f"first step at {share:.3f} of its limit"

        rows.append(Row(f"diffusivity {diffusivity:g} m2/s", _diffusing(diffusivity),
                        "the step follows", momentum=True, check=follows,
                        fast=diffusivity in (0.0, 0.2)))  # fmt: skip
    rows.append(Row("dt above diffusion's limit", _diffusing(1.0, dt=1e-4), "refused", code=2,
                    says=("scene.toml:", "time.dt", "diffusion"), fast=True))  # fmt: skip
    return rows


def _diffusing(diffusivity: float, dt: float = 0.0) -> str:
    return scene(
        {"water": WATER, "milk": {**WATER, "density": 1030}},
        box("left", "water", LOW, HIGH),
        box("right", "milk", (0.20, 0.16, 0.16), (0.28, 0.24, 0.24)),
        coupling("mixing", "water", "milk", diffusivity=diffusivity),
        end=0.01,
        dt=dt,
    )


def _few() -> list[Row]:
    rows = []
    for name, law in (("water", WATER), ("rubber", RUBBER), ("sand", {"kind": "sand"})):
        text = scene(
            {"stuff": law},
            box("one", "stuff", (0.1, 0.1, 0.1), (0.12, 0.12, 0.12), particles_per_cell=1,
                velocity=[1, 0.5, -0.25]),
            end=0.1,
        )  # fmt: skip

        def flies(run: Run, first: dict) -> tuple[bool, str]:
            way = run.array("positions") - first["positions"] - 0.1 * np.array([1, 0.5, -0.25])
            off = float(np.abs(way).max())
            return len(way) == 1 and off < 1e-9, f"{len(way)} particle, off by {off:.0e} m"

        rows.append(Row(f"one particle of {name}", text, "flies straight", momentum=True,
                        check=flies, fast=name == "water"))  # fmt: skip
    for name, law in (("water", WATER), ("rubber", RUBBER)):
        text = collision(law, law, 0.5, 0.05, particles_per_cell=1)
        rows.append(Row(f"one per cell, {name}", text, "runs", momentum=True,
                        fast=name == "rubber"))  # fmt: skip
    empty = scene(
        {"rubber": RUBBER},
        box("cube", "rubber", LOW, HIGH),
        box("crumb", "rubber", (0.301, 0.301, 0.301), (0.302, 0.302, 0.302)),
        end=0.01,
    )
    rows.append(Row("an object without particles", empty, "refused", code=2,
                    says=("scene.toml:", "particle"), fast=True))  # fmt: skip
    return rows


def _edges() -> list[Row]:
    rows = []
    for name, law in (("water", WATER), ("rubber", RUBBER)):
        # particles begin at odd multiples of 5 mm: in steps of 0.5 mm along every axis all of them
        # come to lie on nodes, and some on block edges, at steps 10, 30 and 50
        text = scene(
            {"stuff": law},
            box("block", "stuff", LOW, HIGH, velocity=[1, 1, 1]),
            end=0.025,
            dt=5e-4 if name == "rubber" else 2.5e-4,
        )

        def on_edges(run: Run, first: dict) -> tuple[bool, str]:
            at = run.array("positions") / (4 * DX)
            edge = int((np.abs(at - np.round(at)) < 1e-12).sum())
            return edge > 0, f"{edge} coordinates on block edges at the end"

        rows.append(Row(f"on block edges, {name}", text, "runs", momentum=True, check=on_edges,
                        fast=name == "water"))  # fmt: skip
        # bodies stand half a spacing inside a wall; thrown at it, they cross it and come back
        text = scene(
            {"stuff": {**law, **({"tait_coefficient": 1e6} if name == "water" else {})}},
            box("block", "stuff", (0, 0, 0), (0.16, 0.16, 0.16), velocity=[-1, -1, -1]),
            end=0.05,
            size=(0.16, 0.16, 0.16),
        )
        rows.append(Row(f"pressed on walls, {name}", text, "runs", fast=name == "rubber"))
    outside = scene(
        {"stuff": RUBBER},
        box("block", "stuff", (-0.005, 0, 0), (0.1, 0.1, 0.1)),
        end=0.01,
    )
    rows.append(Row("particles on a face of the domain", outside, "refused", code=2,
                    says=("scene.toml:", "outside the domain"), fast=True))  # fmt: skip
    return rows


def _impacts() -> list[Row]:
    rows = []
    for kind in registry:
        wall = scene(
            {"stuff": of_law(kind)},
            box("cube", "stuff", (0.16, 0.16, 0.01), (0.24, 0.24, 0.09), velocity=[0, 0, -10]),
            end=0.01,
        )
        rows.append(Row(f"10 m/s on the floor, {kind}", wall, "runs", fast=kind == "elastic"))
        toy = {**RUBBER, "youngs_modulus": 1e6}
        text = collision(of_law(kind), toy, 10.0, 0.006)
        rows.append(Row(f"10 m/s on rubber, {kind}", text, "runs", momentum=True,
                        fast=kind == "snow"))  # fmt: skip
    return rows


def _friction() -> list[Row]:
    rows = []
    for mu in (0, 5):
        text = scene(
            {"one": RUBBER, "other": RUBBER},
            box("left", "one", LOW, HIGH, velocity=[0.5, 0, 0.5]),
            box("right", "other", *NEXT),
            coupling("contact", "one", "other", friction=mu),
            end=0.08,
        )

        def rubs(run: Run, first: dict, mu=mu) -> tuple[bool, str]:
            found = run.arrays("velocity", "object")
            up = float(found["velocity"][found["object"] == 1, 2].mean())
            return (up < 0.01 if mu == 0 else up > 0.05), f"takes {up:+.3f} m/s along"

        rows.append(Row(f"friction {mu}, two bodies", text,
                        "takes nothing along" if mu == 0 else "takes it along",
                        momentum=True, check=rubs, fast=True))  # fmt: skip
        text = scene(
            {"stuff": RUBBER},
            box("cube", "stuff", (0.06, 0.16, 0), (0.14, 0.24, 0.08), velocity=[0.5, 0, 0]),
            end=0.2,
            gravity=9.8,
            walls=f'{{ kind = "separate", friction = {mu} }}',
        )
        low, high = (0.099, 0.101) if mu == 0 else (0.0, 0.03)
        rows.append(Row(f"friction {mu}, floor", text, f"slides {low:g} .. {high:g} m",
                        check=_moved(0, low, high, axis=0)))  # fmt: skip
    return rows


def _endings() -> list[Row]:
    splash = scene(
        {"water": WATER},
        box("pool", "water", (0, 0, 0), (0.2, 0.2, 0.06)),
        box("jet", "water", (0.08, 0.08, 0.07), (0.12, 0.12, 0.11), velocity=[0, 0, 1]),
        end=0.4,
        gravity=9.8,
        size=(0.2, 0.2, 0.24),
    )

    def returns(run: Run, first: dict) -> tuple[bool, str]:
        top = float(run.array("positions")[:, 2].max())
        return top < 0.06 + 2 * DX, f"highest drop at {top * 1e3:.0f} mm"

    soft = {**WATER, "tait_coefficient": 10}
    fall = scene(
        {"jelly": soft},
        box("drop", "jelly", (0.16, 0.16, 0), (0.24, 0.24, 0.08), velocity=[0, 0, -10]),
        end=0.02,
    ).replace("[accuracy]", '[accuracy]\nvolume_correction = "none"')
    hard = scene({"steel": {**RUBBER, "youngs_modulus": 1e8}}, box("cube", "steel", LOW, HIGH),
                 end=0.01, dt=1e-4)  # fmt: skip
    return [
        Row("spray that returns", splash, "below 100 mm at the end", check=returns),
        Row("J leaves .1 .. 5", fall, "exit 3", code=3,
            says=("object drop", "particle", "step", "J left"), fast=True),
        Row("a fixed dt above the bound", hard, "refused", code=2,
            says=("scene.toml:", "time.dt", "material 'steel'"), fast=True),
    ]  # fmt: skip


def rows() -> list[Row]:
    """All of them."""
    return [
        *_density(), *_stiffness(), *_sharing(), *_few(), *_edges(), *_impacts(), *_friction(),
        *_endings(),
    ]  # fmt: skip
