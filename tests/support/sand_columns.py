"""Columns of dry sand that collapse: how far they run out and how high they stay.

Published, a = height / length of the column at the start:
- between walls, quartz sand (Lube, Huppert, Sparks, Freundt 2005, Phys. Rev. E 72, 041301): run-out
  / length = 1.2 a, above a = 2.3 (1.8 to 2.8) 1.9 a^(2/3); height / length = a, above 1.15 a^(2/5).
- between walls, glass beads (Lajeunesse, Monnier, Homsy 2005, Phys. Fluids 17, 103302): 1.8 a for
  a < 3, 2.3 a^(2/3) above. Both as in Lagree, Staron, Popinet 2011, J. Fluid Mech. 686, 378.
- round, quartz sand (Lube et al. 2004, J. Fluid Mech. 508, 175): run-out / radius = 1.24 a for
  a < 1.7, 1.6 a^(1/2) above; height / radius = a, but no more than 0.88 a^(1/6).

    python -m tests.support.sand_columns plane 1 2 --cells 8 16 32 --transfer apic apic-corrected
    python -m tests.support.sand_columns plane 2 --sand "glass beads"
    python -m tests.support.sand_columns round .5 1 2 --angle 31 --test triaxial
"""

import argparse
import tempfile
import time
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np

from tests.support.simulate import advance, begin, by_id, totals

GRAVITY, LENGTH = 9.81, 0.16
SCENE = """
[domain]
size = [{long!r}, {wide!r}, {high!r}]
cell = {cell!r}
gravity = [0, 0, -9.81]
boundary = {{ default = "slip", bottom = {floor} }}
[time]
end = 1
[accuracy]
precision = "single"
transfer = "{transfer}"
[material.sand]
kind = "sand"
{sand}
youngs_modulus = {stiff}
[[object]]
name = "column"
material = "sand"
shape = {{ {shape} }}
"""


@dataclass(frozen=True)
class Column:
    form: str  # "plane": half of a wall's width between walls; "round": a quarter of a cylinder
    a: float  # height / length, or radius, at the start
    cells: int  # per length
    sand: str = "quartz sand"  # preset
    angle: float | None = None  # of friction [degrees], instead of the preset's
    test: str = "slope"  # of `angle`
    transfer: str = "apic-corrected"
    floor: float | None = None  # Coulomb coefficient; None: sand does not slide on it

    @property
    def cell(self) -> float:
        return LENGTH / self.cells

    @property
    def width(self) -> float:
        """of the channel [m]."""
        return 4 * self.cell

    def material(self) -> str:
        if self.angle is None:
            return f'preset = "{self.sand}"'
        return (
            f'preset = "{self.sand}"\nfriction_angle = "{self.angle} deg"\n'
            f'friction_angle_test = "{self.test}"'
        )

    def scene(self) -> str:
        long = round((1.5 + 1.6 * run_out(self)) * self.cells) * self.cell
        top = self.a * LENGTH
        shape = f"box = [[0, 0, 0], [{LENGTH!r}, {self.width!r}, {top!r}]]"
        if self.form == "round":  # a quarter, in strips as wide as a row of particles
            y = np.arange(2 * self.cells + 1) * self.cell / 2
            x = np.sqrt(LENGTH**2 - ((y[1:] + y[:-1]) / 2) ** 2)
            rows = [f"[[0, {a!r}, 0], [{c!r}, {b!r}, {top!r}]]" for a, b, c in zip(
                y[:-1].tolist(), y[1:].tolist(), x.tolist(), strict=True)]  # fmt: skip
            shape = "union = [" + ", ".join(f"{{ box = {row} }}" for row in rows) + "]"
        floor = f'{{ kind = "separate", friction = {self.floor} }}'
        return SCENE.format(
            long=long,
            wide=self.width if self.form == "plane" else long,
            high=(np.ceil(round(self.a * self.cells, 6)) + 2).item() * self.cell,
            cell=self.cell,
            floor='"stick"' if self.floor is None else floor,
            transfer=self.transfer,
            sand=self.material(),
            stiff=5e5 * max(1.0, self.a / 2),
            shape=shape,
        )  # fmt: skip


@dataclass(frozen=True)
class Deposit:
    column: Column
    depth: np.ndarray  # of the sand in rings or slices one cell wide, from the middle on [m]
    kinetic: float  # share of the energy at the start that still moves
    lost: bool  # energy is less than at the start
    mass: float  # [kg]
    seconds: float  # it took

    def front(self, least: float = 1 / 40) -> float:
        """Run-out / length: to where sand lies deeper than `least` times the length."""
        shallow = self.depth < least * LENGTH
        end = int(np.argmax(shallow))
        if end == 0:
            return -1.0
        high, low = self.depth[end - 1], self.depth[end]
        share = (high - least * LENGTH) / (high - low)  # between the middles of two slices
        return float((end - 0.5 + share) * self.column.cell / LENGTH - 1.0)

    @property
    def height(self) -> float:
        """In the middle, over the length."""
        inner = max(1 if self.column.form == "plane" else 2, self.column.cells // 10)
        share = np.ones(inner) if self.column.form == "plane" else np.arange(inner) + 0.5
        return float(np.average(self.depth[:inner], weights=share) / LENGTH)


def run_out(column: Column) -> float:
    """Published run-out / length."""
    a = column.a
    if column.form == "round":
        return 1.24 * a if a < 1.7 else 1.6 * a**0.5
    if column.sand == "glass beads":
        return 1.8 * a if a < 3 else 2.3 * a ** (2 / 3)
    return 1.2 * a if a < 2.3 else 1.9 * a ** (2 / 3)


def height(column: Column) -> float:
    """Published height / length, of quartz sand."""
    a = column.a
    return min(a, 0.88 * a ** (1 / 6)) if column.form == "round" else a if a < 1.15 else a**0.4


def depths(column: Column, x: np.ndarray, volume: np.ndarray) -> np.ndarray:
    """Volume over floor [m] in slices, or rings of the quarter, one cell wide."""
    far = x[:, 0] if column.form == "plane" else np.hypot(x[:, 0], x[:, 1])
    held = np.bincount((far / column.cell).astype(int), volume)
    edges = np.arange(len(held) + 1) * column.cell
    floor = edges * column.width if column.form == "plane" else np.pi / 4 * edges**2
    return np.append(held / np.diff(floor), 0.0)


def collapse(column: Column, folder: Path) -> Deposit:
    """It falls, and comes to rest."""
    began = time.perf_counter()
    simulation, made = begin(folder, column.scene())
    before = totals(simulation)
    lasts = 4.5 if column.sand != "glass beads" else 8.0
    advance(simulation, lasts * np.sqrt(max(column.a, 1.0) * LENGTH / GRAVITY))
    after = totals(simulation)
    (x,) = by_id(simulation, "x")
    return Deposit(
        column,
        depths(column, x, made.vol0),
        after["kinetic"] / before["energy"],
        after["energy"] < before["energy"],
        after["mass"],
        time.perf_counter() - began,
    )


def row(found: Deposit) -> str:
    c, ran, high = found.column, found.front(), found.height
    floor = "stick" if c.floor is None else f"{c.floor:g}"
    named = c.sand if c.angle is None else f"{c.angle:g} {c.test}"
    return (
        f"| {c.form} | {c.a:g} | {c.cells} | {c.transfer} | {named} | {floor} "
        f"| {ran:.2f} | {run_out(c):.2f} | {100 * (ran / run_out(c) - 1):+.0f} % "
        f"| {found.front(1 / 16):.2f} "
        f"| {high:.2f} | {height(c):.2f} | {100 * (high / height(c) - 1):+.0f} % "
        f"| {found.kinetic:.0e} | {found.seconds:.0f} |"
    )


HEAD = (
    "| form | a | cells | transfer | sand | floor | run-out | published | | deep | height "
    "| published | | moves | s |\n|" + "---|" * 15
)


def main() -> None:
    args = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    args.add_argument("form", choices=["plane", "round"])
    args.add_argument("a", type=float, nargs="+")
    args.add_argument("--cells", type=int, nargs="+", default=[16])
    args.add_argument("--transfer", nargs="+", default=["apic-corrected"])
    args.add_argument(
        "--angle", type=float, nargs="+", default=[None], help="instead of the preset's"
    )
    args.add_argument("--test", default="slope", help="of --angle")
    args.add_argument("--sand", default="quartz sand", help="preset")
    args.add_argument("--floor", type=float, help="Coulomb coefficient; default: it holds")
    said = args.parse_args()
    base = Column(said.form, 1.0, 10, said.sand, test=said.test, floor=said.floor)
    print(HEAD, flush=True)
    for a, transfer, angle, cells in product(said.a, said.transfer, said.angle, said.cells):
        column = replace(base, a=a, cells=cells, angle=angle, transfer=transfer)
        with tempfile.TemporaryDirectory() as folder:
            print(row(collapse(column, Path(folder))), flush=True)


if __name__ == "__main__":
    main()
