"""python -m tests.benchmarks.implicit_pressure: what an implicit pressure gives water in the plane.

Runs water cases of the board and of the validation with `plane_liquid`, explicit and implicit at
several steps, and prints the table docs/benchmarks/data/implicit_pressure.csv: some minutes.
"""

import argparse
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from tests.benchmarks.plane_liquid import PlaneLiquid
from vgmpi.tools.bench.board.board_cases import GRAVITY, BoardState, FrontMeasure, LevelMeasure

SIDE = 2  # particles along the edge of a cell
SPEED, COMPRESSION = 2.5, 0.01  # [m/s] that compresses the water by this share
STIFFNESS = SPEED**2 / COMPRESSION  # [m2/s2]
STEPS = (0.2, 0.4, 0.8)  # [cells] of the fastest particle


class Outcome(NamedTuple):
    """Result of a run: the liquid at its end, and what was measured."""

    liquid: PlaneLiquid
    measured: dict[str, float]


def lattice(x0: float, x1: float, y0: float, y1: float) -> np.ndarray:
    """Particles in rows that fill a box [cells]."""
    axes = [
        low + (np.arange(round((high - low) * SIDE)) + 0.5) / SIDE
        for low, high in ((x0, x1), (y0, y1))
    ]
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 2)


def make_liquid(n, x, dx: float, stiffness: float, options: dict, v=None, gravity=GRAVITY):
    """Return a liquid; dx [m], stiffness [m2/s2], gravity [m/s2]."""
    v = np.zeros_like(x) if v is None else v
    return PlaneLiquid(n, x, v, stiffness / dx**2, gravity / dx, **options)


def as_board_state(liquid: PlaneLiquid, dx: float) -> BoardState:
    """Return positions and velocities as the board's measures read them: x, -, z [m]."""
    flat = np.zeros(len(liquid.x))
    x, v = (np.stack([a[:, 0] * dx, flat, a[:, 1] * dx], 1) for a in (liquid.x, liquid.v))
    return BoardState(liquid.time, x, v)


def dam_break(cells: int, options: dict) -> Outcome:
    """Front of a column of `cells` in width, rms over the published times [widths]."""
    dx = FrontMeasure.WIDTH / cells
    liquid = make_liquid(
        (4 * cells, 5 * cells // 2), lattice(0, cells, 0, 2 * cells), dx, STIFFNESS, options
    )
    volume = np.full(len(liquid.x), liquid.volume * dx * dx * FrontMeasure.DEPTH)
    measure = FrontMeasure(volume, liquid.x, dx)
    for k in range(1, 19):
        liquid.advance(0.02 * k)
        measure.record(as_board_state(liquid, dx))
    return Outcome(liquid, {"front": measure.result()["error"]})


def level(cells: int, options: dict) -> Outcome:
    """Level of water that sways for 5 s in a tank of `cells`, less 1."""
    dx = LevelMeasure.TANK[0] / cells
    height = round(LevelMeasure.COLUMN[1] / dx)
    liquid = make_liquid((cells, cells), lattice(0, cells // 2, 0, height), dx, STIFFNESS, options)
    volume = np.full(len(liquid.x), liquid.volume * dx * dx * LevelMeasure.TANK[1])
    measure, fullest = LevelMeasure(volume, liquid.x, dx), 0.0
    for k in range(1, 51):
        liquid.advance(0.1 * k)
        measure.record(as_board_state(liquid, dx))
        fullest = max(fullest, float(liquid.fields["filled"].max())) if k > 30 else 0.0
    return Outcome(liquid, {"level": measure.result()["level"] - 1, "fullest": fullest})


def standing_wave(cells: int, options: dict) -> Outcome:
    """Period of a standing wave over theory, less 1, and energy lost in a period."""
    length, depth, number = 0.2, 0.1, np.pi / 0.2
    dx = 2 * length / cells
    period = 2 * np.pi / np.sqrt(GRAVITY * number * np.tanh(number * depth))
    n = cells // 2, round(0.16 / dx)

    def mode(x: np.ndarray) -> np.ndarray:
        across, up = number * dx * x.T
        scale = 0.01 / np.cosh(number * depth) / dx
        return scale * np.stack([np.cosh(up) * np.sin(across), -np.sinh(up) * np.cos(across)], 1)

    x = lattice(0, n[0], 0, round(depth / dx))
    liquid = make_liquid(n, x, dx, 140.0, options, mode(x))
    liquid.rest_in_its_weight(depth / dx)
    t, amplitude = [], []
    for k in range(129):
        liquid.advance(k * period / 40)
        shape = mode(liquid.x)
        t.append(liquid.time)
        amplitude.append(float((shape * liquid.v).sum() / (shape * shape).sum()))
    a = np.array(amplitude)
    index = np.flatnonzero(a[1:] * a[:-1] < 0)
    zero = np.array(t)[index] + period / 40 * a[index] / (a[index] - a[index + 1])
    peaks = [np.abs(a[i:j]).max() for i, j in zip(index[:-1], index[1:])]
    loss = 1 - (peaks[-1] / peaks[0]) ** (4 / (len(peaks) - 1))
    return Outcome(liquid, {"period": 2 * float(np.diff(zero).mean()) / period - 1, "loss": loss})


def pool_at_rest(cells: int, options: dict) -> Outcome:
    """Disordered water at rest: sinking, pressure (rms, of the floor's), speed over sqrt(gH)."""
    dx = 0.2 / cells
    x = lattice(0, 2 * cells, 0, cells)
    x += 0.25 * np.random.default_rng(1).uniform(-1, 1, x.shape)
    liquid = make_liquid((2 * cells, cells + 6), x, dx, GRAVITY * 0.2 / COMPRESSION, options)
    liquid.rest_in_its_weight(cells)
    start, rows = float(x[:, 1].mean()), []
    for k in range(1, 41):
        liquid.advance(k * 0.125)
        p = -liquid.stiffness * liquid.theta / (liquid.gravity * cells)
        weight = np.maximum(cells - liquid.x[:, 1], 0) / cells
        speed = np.sqrt((liquid.v**2).sum(1).mean() / (liquid.gravity * cells))
        sunk = 2 * (start - liquid.x[:, 1].mean()) / cells
        rows.append((sunk, np.sqrt(((p - weight) ** 2).mean()), speed))
    sunk, pressure, speed = np.mean(rows[30:], axis=0)
    return Outcome(liquid, {"sunk": sunk, "pressure": pressure, "speed": speed})


def vortices(cells: int, options: dict) -> Outcome:
    """Four vortices without viscosity in a full box: their kinetic energy after 1 and 4 turns."""
    dx, speed = 1.0 / cells, 0.5
    x = lattice(0, cells, 0, cells)
    across, up = 2 * np.pi * dx * x.T
    v = speed / dx * np.stack([np.sin(across) * np.cos(up), -np.cos(across) * np.sin(up)], 1)
    liquid = make_liquid(
        (cells, cells), x, dx, 4 * speed**2 / COMPRESSION, options, v, gravity=1e-9
    )
    before, energy = (v**2).sum(), []
    for k in range(1, 5):
        liquid.advance(float(k))
        energy.append(float((liquid.v**2).sum() / before))
    return Outcome(liquid, {"energy 1 s": energy[0], "energy 4 s": energy[3]})


CASES: dict[str, tuple[Callable[[int, dict], Outcome], tuple[int, ...]]] = {
    "dam break": (dam_break, (16, 32, 64)),
    "level": (level, (16, 32)),
    "standing wave": (standing_wave, (20,)),
    "pool at rest": (pool_at_rest, (10,)),
    "vortices": (vortices, (32,)),
}


def print_case(name: str, sweeps: list[int]) -> None:
    """Print the table of a case."""
    run, sizes = CASES[name]
    run(sizes[0] // 2, {}), run(sizes[0] // 2, {"implicit": False})  # compile
    settings: list[dict] = [{"implicit": False}, *({"cfl": cfl} for cfl in STEPS)]
    settings += [{"sweeps": (count, max(count // 2, 1))} for count in sweeps]
    for cells in sizes:
        base = 0.0
        for options in settings:
            liquid, measured = run(cells, options)
            base = base or liquid.seconds
            text = "explicit" if not liquid.implicit else f"{liquid.cfl:g}, {liquid.sweeps[0]}"
            numbers = ", ".join(f"{key} {value:.4f}" for key, value in measured.items())
            print(
                f"| {name}, {cells} | {text} | {liquid.steps:,} | {liquid.seconds:.2f} |"
                f" {base / liquid.seconds:.1f} | {numbers} |",
                flush=True,
            )


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="+", choices=CASES, default=list(CASES), metavar="CASE")
    parser.add_argument("--sweeps", nargs="+", type=int, default=[10, 40], metavar="N")
    args = parser.parse_args()
    print("| case, cells | cells per step, sweeps | steps | processor s | faster | measured |")
    print("|---|---|---|---|---|---|")
    for name in args.only:
        print_case(name, args.sweeps)


if __name__ == "__main__":
    main()
