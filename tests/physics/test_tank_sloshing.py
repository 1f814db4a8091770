"""Sloshing in tanks that are moved to and fro: the height of the water beside experiments.

Deep: Faltinsen, Rognebakke, Lukovsky and Timokha 2000 (J. Fluid Mech. 407, 201-234), figure 7: a
tank 1.73 m long, 0.6 m of water, moved by 0.032 m to both sides with a period of 1.3 s. Shallow:
Bouscasse, Antuono, Colagrossi and Lugni 2013 (Int. J. Nonlinear Sci. Numer. Simul. 14, 123-138),
figure 19: a tank 1 m long, 0.03 m of water, moved by 2.333 depths at 1.231 times the lowest natural
frequency; a bore runs to and fro. Gauges 0.05 m from the left wall. The curves as PySPH read them
from the figures (pysph/examples/st_exp_data.py), the deep one every 0.1 s.

Here slabs 4 cells deep between slip walls, in the frame of the tank: gravity has the acceleration
of the tank, linear between 60 keyframes per period. Tolerances: 1 % of the times of the crests of
the deep tank from the second on, 2 % of a period of those of the shallow one.

Heights are beside the measured ones without a tolerance. In the deep tank, ours differ by 1 to 3 %
with twice the cells and by 2 to 9 % with the other pressure; linear theory of the same motion is
0.026 m (rms) off the measured curve, and 0.014 m off ours. The experiment's authors found that an
initial variation of its period matters, which the figure does not tell. In the shallow tank, the
lowest water is two to three cells deep.
"""

import numpy as np
import pytest

import vgmpi
from tests.support.validation_record import held

GRAVITY = 9.81  # [m/s2]
SCENE = """
[domain]
size = [{length!r}, {wide!r}, {high!r}]
cell = {dx!r}
gravity = [0, 0, -9.81]
boundary = "slip"
[time]
end = {end!r}
frames = 2
[accuracy]
pressure = "{pressure}"
[material.water]
kind = "fluid"
max_speed = {fast!r}
[[object]]
name = "water"
material = "water"
initial_pressure = "hydrostatic"
velocity = [{speed!r}, 0, 0]
shape = {{ box = [[0, 0, 0], [{length!r}, {wide!r}, {depth!r}]] }}
[[probe]]
name = "height"
sampling_rate = 100
surface_height = [0.05, {middle!r}]
"""
KEYFRAME = """
[[domain.gravity_keyframes]]
time = {time!r}
gravity = [{across!r}, 0, -9.81]
"""

DEEP = "Faltinsen et al. 2000"
LENGTH, DEPTH, PERIOD, STROKE = 1.73, 0.6, 1.3, 0.032  # [m], [m], [s], [m]
TIMES = np.arange(1, 99) / 10  # [s]
RISES = np.array([
    -3, -10, -18, -26, -31, -24, -11, 13, 36, 58, 70, 73, 62, 33, -11, -51, -70, -82, -87, -81,
    -59, -15, 56, 109, 135, 138, 119, 79, 28, -21, -67, -86, -89, -77, -45, -12, 21, 56, 87, 105,
    101, 72, 32, -1, -27, -42, -45, -38, -28, -14, -1, 7, 13, 11, 8, 3, 3, 6, 12, 22, 31, 37, 40,
    34, 20, -1, -27, -49, -62, -67, -57, -42, -16, 18, 62, 105, 124, 108, 73, 43, -11, -60, -82,
    -79, -72, -51, -19, 26, 70, 109, 134, 137, 112, 55, -15, -58, -68, -66,
]) / 1000  # fmt: skip
CRESTS = {"first": (1.163, 0.0754), "second": (2.574, 0.1421), "sixth": (7.707, 0.1248),
          "seventh": (9.159, 0.1414)}  # fmt: skip

SHALLOW = "Bouscasse et al. 2013"
SHALLOW_DEPTH, PERIODS = 0.03, 7  # [m], [-]
CREST_PHASE, CREST, LOWEST = 0.876, 0.058, -0.011  # [periods], [m], [m]: means of three periods


def heights(folder, text, acceleration, end, period, depth):
    """Times [s] and rises [m] at the gauge of a tank with an acceleration [m/s2] of its water."""
    for time in [1e-3, *(np.arange(1, end * 60 / period) * period / 60)]:
        text += KEYFRAME.format(time=float(time), across=float(acceleration(time)))
    run = vgmpi.run(vgmpi.load(folder / "scene.toml", text=text))
    assert run.code == 0
    rows = [(row["time"], row["surface_height"]) for row in run.probes["height"]]
    times, found = np.array(rows).T
    return times, np.nan_to_num(found) - depth


@pytest.mark.parametrize(
    "cells, pressure",
    [
        (58, "implicit"),
        pytest.param(116, "implicit", marks=pytest.mark.slow),
        pytest.param(58, "explicit", marks=pytest.mark.slow),
    ],
)
def test_deep_tank(tmp_path, cells, pressure):
    dx, omega = LENGTH / cells, 2 * np.pi / PERIOD
    text = SCENE.format(
        length=LENGTH, wide=4 * dx, high=float(np.ceil(1 / dx) * dx), dx=dx, end=10,
        pressure=pressure, fast=3, speed=0, depth=DEPTH, middle=2 * dx,
    )  # fmt: skip
    times, rises = heights(
        tmp_path, text, lambda t: STROKE * omega**2 * np.cos(omega * t), 10, PERIOD, DEPTH
    )
    end = f"{cells} cells per length, {pressure} pressure"
    for name, (time, rise) in CRESTS.items():
        near = abs(times - time) < PERIOD / 3
        found = float(times[near][np.argmax(rises[near])])
        held(f"sloshing in a deep tank: {name} crest, {end}", float(rises[near].max()), rise,
             np.inf, unit="m", source=DEEP)  # fmt: skip
        held(f"sloshing in a deep tank: time of the {name} crest, {end}", found, time,
             np.inf if name == "first" else 0.01, unit="s", source=DEEP)  # fmt: skip
    off = np.interp(TIMES, times, rises) - RISES
    plot = {"ours": (times, rises), "experiment, Faltinsen et al.": (TIMES, RISES)}
    is_drawn = (cells, pressure) == (116, "implicit")
    held(f"sloshing in a deep tank: off the measured curve, {end}",
         float(np.sqrt(np.mean(off**2))), 0.0, np.inf, kind="below", unit="m, rms", source=DEEP,
         curves=plot if is_drawn else None, axes=("t [s]", "rise [m]"))  # fmt: skip


@pytest.mark.slow
def test_bore_in_a_shallow_tank(tmp_path):
    dx, wave = 0.005, np.pi  # [m], [1/m]
    omega = float(1.231 * np.sqrt(GRAVITY * wave * np.tanh(wave * SHALLOW_DEPTH)))
    stroke, period = 2.333 * SHALLOW_DEPTH, 2 * np.pi / omega
    text = SCENE.format(
        length=1.0, wide=4 * dx, high=0.2, dx=dx, end=PERIODS * period, pressure="implicit",
        fast=1.5, speed=-stroke * omega, depth=SHALLOW_DEPTH, middle=2 * dx,
    )  # fmt: skip
    times, rises = heights(
        tmp_path, text, lambda t: stroke * omega**2 * np.sin(omega * t), PERIODS * period, period,
        SHALLOW_DEPTH,
    )  # fmt: skip
    phases = [(times / period >= n) & (times / period < n + 1) for n in range(PERIODS - 3, PERIODS)]
    crest = np.mean([times[part][np.argmax(rises[part])] / period % 1 for part in phases])
    end = "6 cells per depth, implicit pressure"
    held(f"bore in a shallow tank: time of the crest, {end}", float(crest), CREST_PHASE, 0.02,
         kind="absolute", unit="periods", source=SHALLOW)  # fmt: skip
    held(f"bore in a shallow tank: crest, {end}",
         float(np.mean([rises[part].max() for part in phases])), CREST, np.inf, unit="m",
         source=SHALLOW)  # fmt: skip
    held(f"bore in a shallow tank: lowest water, {end}",
         float(np.mean([rises[part].min() for part in phases])), LOWEST, np.inf, unit="m",
         source=SHALLOW)  # fmt: skip
