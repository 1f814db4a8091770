"""python -m tests.benchmarks.softness: what the stiffness of a liquid does, and costs.

The paper's bulk modulus k, as the compression that it allows: the height of water at rest, the
front of a breaking dam, and the processor time of both (runs/accuracy/hydrostatic.toml, 16 cells
deep, and dam_break.toml, 48 cells long). Prints the table of docs/benchmarks/studies.md. Existing
runs are kept (runs/accuracy/out/softness).
"""

import argparse
from collections.abc import Callable

import numpy as np

from tests.benchmarks.levels import SCENES, dam_break, hydrostatic, last
from vgmpi.scene.loader import load
from vgmpi.tools.tradeoff.error_measures import RunOutcome
from vgmpi.tools.tradeoff.parameter_sweep import Setting
from vgmpi.tools.tradeoff.study_runs import Study

COMPRESSIONS = (0.1, 0.04, 0.01, 0.0025)
CELLS = {"hydrostatic": "1 cm", "dam_break": repr(0.584 / 48)}
DEPTH = 0.16  # [m]
SINKS = ("object.water.initial_pressure=zero", "time.end=2", "time.frames=401")


def sunk(found: RunOutcome) -> float:
    """Share of its height by which water that was filled in as it is without weight stands lower
    when it carries its own: mean of the second half of the run, since it swings."""
    volume = np.asarray(found.run.gaussians.vol0)
    frames = range(len(found.run) // 2, len(found.run))
    z = np.mean([(last(found, k)[0][:, 2] * volume).sum() / volume.sum() for k in frames])
    return 1 - 2 * float(z) / DEPTH


def measured(
    name: str, measure: Callable[[RunOutcome], float], ranks: int, *overrides: str
) -> list[tuple[float, float]]:
    """For each compression a measure of a scene, and its processor time [s]."""
    scene = load(SCENES / f"{name}.toml", [f"domain.cell={CELLS[name]}", *overrides])
    study = Study(scene, SCENES / "out" / "softness" / measure.__name__, ranks)
    rows = []
    for value in COMPRESSIONS:
        one = Setting(
            (("max_compression", f"{value:g}"),), (f"material.water.max_compression={value!r}",)
        )
        cpu = study.run(one)
        rows.append((measure(study.outcome(one)), cpu))
    return rows


def main() -> None:
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    p.add_argument("--ranks", type=int, default=1, help="of each run")
    ranks = p.parse_args().ranks
    sinks = measured("hydrostatic", sunk, ranks, *SINKS)
    rest = measured("hydrostatic", hydrostatic, ranks)
    dam = measured("dam_break", dam_break, ranks)
    print("| compression | lower at rest, theory | found | pressure off | front off | time |")
    print("|---|---|---|---|---|---|")
    found = zip(COMPRESSIONS, sinks, rest, dam, strict=True)
    for value, (low, _), (pressure, _), (front, cpu) in found:
        shares = [f"{100 * s:.2g} %" for s in (value, theory(value), low, pressure, front)]
        print(f"| {' | '.join([*shares, f'{cpu:.1f} s'])} |")


def theory(compression: float, gamma: float = 7.0) -> float:
    """The same share of a column in which p = k (J^-gamma - 1) carries what is above (k by depth
    and compression: materials/liquid_stiffness.py)."""
    above = (np.arange(1000) + 0.5) / 1000  # share of the mass
    J = (1 + gamma * compression * above) ** (-1 / gamma)
    return 1 - 2 * float((J * above).mean())  # the mean height is that of all J below


if __name__ == "__main__":
    main()
