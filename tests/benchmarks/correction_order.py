"""Further terms of the transfer correction: what they save of a wave, and what they cost.

A transfer reduces the amplitude of a wave by the fraction e, so that N transfers leave (1 - e)^N.
The transfer correction adds N e, the first term of (1 - e)^-N = sum_k C(N + k - 1, k) e^k; each
further term takes another step of no time for what the one before it has left. XPIC and FMPM take
terms of the same series (Hammerquist and Nairn 2017; Nairn and Hammerquist 2021).
"""

import tempfile
import time
from math import comb
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tests.physics import test_slosh, test_vortices
from tests.support.oscillation import keeps, period
from tests.support.simulate import advance, begin, by_id, totals
from vgmpi.kernels.particle_records import VOLUME

MOTION = slice(0, VOLUME)  # channels of the velocity and its gradient
PERIODS = 6
CASES = (20, 8, 2e4), (20, 27, 2e4), (20, 27, 2e5), (40, 8, 2e4)  # cells, particles, modulus


class WaveResult(NamedTuple):
    """What is left of a standing wave."""

    period: float  # [-] over that of theory
    loss: float  # [-] of the amplitude in a period
    energy: float  # [-] largest energy over that at the start, less 1
    seconds: float  # [s] processor time of a step


def take_terms(simulation, order: int) -> None:
    """Make the transfer correction of a simulation take `order` terms of the series.

    Args:
        simulation: A simulation with "apic-corrected" (in/out).
        order: Number of terms, 1 as the solver has it.
    """
    first_term, times = simulation.restore, simulation.plan.restores

    def restore(dt, shifts=False, restores=True):
        before = _motion(simulation)
        overflows = first_term(dt, shifts, restores)
        rest = [(new - old) / times for new, old in zip(_motion(simulation), before, strict=True)]
        motion = _motion(simulation)
        for k in range(2, order + 1):
            _set_motion(simulation, rest)
            first_term(dt)  # rest + N (rest - S rest)
            after = _motion(simulation)
            rest = [(new - old) / times for new, old in zip(after, rest, strict=True)]
            factor = comb(times + k - 1, k)
            motion = [old + factor * new for old, new in zip(motion, rest, strict=True)]
        _set_motion(simulation, motion)
        return overflows

    if order > 1:
        simulation.restore = restore


def _motion(simulation) -> list[np.ndarray]:
    return [group.f[MOTION].copy() for group in simulation.groups]


def _set_motion(simulation, motion: list[np.ndarray]) -> None:
    for group, values in zip(simulation.groups, motion, strict=True):
        group.f[MOTION] = values


def wave_result(order: int, cells: int, particles: int, modulus: float) -> WaveResult:
    """Return what a number of terms leaves of a standing wave (tests/physics/test_slosh.py).

    Args:
        order: Number of terms.
        cells: Cells per wavelength.
        particles: Particles per cell.
        modulus: Tait coefficient [Pa].
    """
    dx = 2 * test_slosh.L / cells
    text = test_slosh.SCENE.format(
        deep=4 * dx, dx=dx, accuracy="", cfl=0.4, particles=particles, modulus=modulus
    )
    with tempfile.TemporaryDirectory() as folder:
        simulation, _ = begin(Path(folder), text, velocity=test_slosh.wave)
    take_terms(simulation, order)
    times, found, energies = [], [], []
    started = time.thread_time()
    for k in range(20 * PERIODS + 1):
        advance(simulation, k * test_slosh.PERIOD / 20) if k else None
        x, v = by_id(simulation, "x", "v")
        mode = test_slosh.wave(x)
        times.append(simulation.time)
        found.append((mode * v).sum() / (mode**2).sum())
        energies.append(totals(simulation)["energy"])
    seconds = (time.thread_time() - started) / simulation.step
    return WaveResult(
        period(times, found) / test_slosh.PERIOD,
        1.0 - keeps(times, found),
        (max(energies) - energies[0]) / abs(energies[0]),
        seconds,
    )


def vortex_rate(order: int, cells: int, number: float) -> float:
    """Return the decay rate of Taylor-Green vortices over that of theory.

    Args:
        order: Number of terms.
        cells: Cells along the box.
        number: UL / nu.
    """
    nu = test_vortices.SPEED * test_vortices.L / number
    dx = test_vortices.L / cells
    text = test_vortices.SCENE.format(
        dx=dx, deep=4 * dx, mu=1000 * nu, transfer="apic-corrected", k=test_vortices.K
    )
    with tempfile.TemporaryDirectory() as folder:
        simulation, _ = begin(Path(folder), text)
    take_terms(simulation, order)
    found = []
    for step in range(2):
        if step:
            advance(simulation, 0.5 / (2 * nu * test_vortices.K**2))
        x, v = by_id(simulation, "x", "v")
        s, c = np.sin(test_vortices.K * x[:, ::2]), np.cos(test_vortices.K * x[:, ::2])
        shape = np.stack([s[:, 0] * c[:, 1], -c[:, 0] * s[:, 1]], 1)
        found.append((shape * v[:, ::2]).sum() / (shape**2).sum())
    return float(-np.log(found[1] / found[0]) / 0.5)


def run(orders: list[int]) -> None:
    """Print the tables.

    Args:
        orders: Numbers of terms.
    """
    print("| terms | cells per wave | particles per cell | k [Pa] | period | loss per period |"
          " energy over the start | ms per step |")  # fmt: skip
    print("|---|---|---|---|---|---|---|---|")
    for case in CASES:
        for order in orders:
            one = wave_result(order, *case)
            print(
                f"| {order} | {case[0]} | {case[1]} | {case[2]:.0e} | {one.period:.4f} |"
                f" {one.loss:.4f} | {one.energy:+.1e} | {1e3 * one.seconds:.2f} |",
                flush=True,
            )
    print("\n| terms | cells | UL / nu | decay rate over theory |")
    print("|---|---|---|---|")
    for cells, number in ((16, 10.0), (24, 10.0)):
        for order in orders:
            rate = vortex_rate(order, cells, number)
            print(f"| {order} | {cells} | {number:g} | {rate:.4f} |", flush=True)
