"""The scene every contestant of the benchmark computes: a cube of particles in free flight.

8 particles per cell, jittered about a lattice so that cells hold unequal numbers, in motion with
shear and compression on top, so that a law has work to do. The fastest particle moves 0.05 cells
per step along an axis: this solver sorts about every 19 steps, inside the time that is measured.
"""

import json
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from vgmpi.io import file_layout, initial_state
from vgmpi.materials import registry
from vgmpi.materials.material import Material, law_function
from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.preprocess.scene_builder import build_scene
from vgmpi.runtime.command_line import EXIT_USAGE
from vgmpi.scene.loader import load
from vgmpi.scene.scene import Scene
from vgmpi.solver.initial_particles import preparation_hash

# the least a material needs to be valid, where its defaults are not enough
KEYS: dict[str, dict] = {
    "corotated": {"youngs_modulus": 1e6},
    "elastic": {"youngs_modulus": 1e6},
    "foam": {"preset": "shaving foam"},
    "metal": {"youngs_modulus": 1e6, "yield_stress": 1e4},
    "paste": {"preset": "ketchup"},
    "plasticine": {"preset": "clay"},
}

DX = 0.01  # [m]
PER_STEP = 0.05  # cells the fastest particle moves per step, along one axis
DIRECTION = np.array([1.0, 0.8, 0.6])  # every axis changes cells, none in step with another
SWIRL = 0.1  # share of the speed that is shear and compression
COURANT = 0.3  # time step as a share of the time sound needs to cross a cell
START = 40  # cells from the walls: nothing comes near them
STEPS = 1000  # from the start after which the cube must begin again
GRAVITY = -9.8  # [m/s2] along z
MARGIN = 3  # cells of a dense grid that stay empty around the cube


class BenchError(Exception):
    """Something that cannot be measured as it was asked for; one line for the user."""

    exit_code = EXIT_USAGE


class WorkerError(BenchError):
    """A program that was to be measured failed; one line for the user."""

    exit_code = 1


@dataclass(frozen=True)
class Case:
    """One law and one number of particles; `wanted` is rounded to a whole cube of cells."""

    law: str
    wanted: int
    material: Material = field(init=False, compare=False)

    def __post_init__(self):
        object.__setattr__(self, "material", least_material(self.law))

    @property
    def side(self) -> int:
        """Cells along an edge of the cube."""
        return max(2, round((self.wanted / 8) ** (1 / 3)))

    @property
    def particles(self) -> int:
        """Return the number of particles."""
        return 8 * self.side**3

    @property
    def dt(self) -> float:
        """Time step [s]."""
        law = self.material.law()
        at_rest = tuple(v for values in self.material.carries.values() for v in values)
        wave = float(np.sqrt(law_function(law, "wave_speed2")(law, at_rest)))
        viscous = 6.0 * self.material.kinematic_viscosity / DX**2
        return 1.0 / max(wave / (COURANT * DX), viscous / 0.75)

    @property
    def edge_cells(self) -> int:
        """Cells along an edge of a dense grid: the cube and about 40 % for it to move."""
        return max(int(np.ceil(1.4 * self.side)), self.side + 12)

    @property
    def dense_steps(self) -> int:
        """Steps until the cube nears the border of the dense grid."""
        return int((self.edge_cells - self.side - 2 * MARGIN - 1) / PER_STEP)

    def text(self, precision: str) -> str:
        """The scene as a TOML text."""
        low, high = START * DX, (START + self.side) * DX
        size = (self.side + 2 * START + int(STEPS * PER_STEP)) * DX
        keys = {"kind": self.law, **KEYS.get(self.law, {})}
        material = "\n".join(f"{key} = {json.dumps(value)}" for key, value in keys.items())
        return f"""
title = "benchmark: {self.law}"
[domain]
size = [{size:.6g}, {size:.6g}, {size:.6g}]
cell = {DX}
gravity = [0, 0, {GRAVITY}]
[time]
end = {STEPS * self.dt!r}
frames = 2
dt = {self.dt!r}
[accuracy]
transfer = "apic"
volume_correction = "none"
precision = "{precision}"
[material.stuff]
{material}
[[object]]
name = "cube"
material = "stuff"
shape = {{ box = [[{low:.6g}, {low:.6g}, {low:.6g}], [{high:.6g}, {high:.6g}, {high:.6g}]] }}
"""

    def numbers(self) -> dict:
        """Return the numbers that a rival needs besides the particles, in SI units."""
        return {
            "law": self.law,
            "constants": {k: float(v) for k, v in self.material.law()._asdict().items()},
            "density": self.material.bulk_density,
            "volume": DX**3 / 8,
            "dx": DX,
            "dt": self.dt,
            "gravity": GRAVITY,
            "cells": self.edge_cells,
            "steps": self.dense_steps,
        }


def least_material(kind: str) -> Material:
    """The material's table with as few keys as make it valid. Raises BenchError."""
    if kind not in registry:
        raise BenchError(f"there is no material of kind {kind!r}; known: {', '.join(registry)}")
    try:
        return registry[kind].model_validate({"kind": kind, **KEYS.get(kind, {})})
    except ValidationError as error:
        wrong = ", ".join(".".join(map(str, e["loc"])) for e in error.errors())
        raise BenchError(
            f"material {kind!r} is not measured: it needs {wrong};"
            " name a value in KEYS of vgmpi/tools/bench/benchmark_case.py"
        ) from None


def lay_out(case: Case, precisions: list[str], folder: Path) -> None:
    """Write a folder per precision with scene and particles, and dense.npz for the rivals."""
    rows = None
    for precision in precisions:
        inside = folder / precision
        inside.mkdir(parents=True)
        scene = _scene(case, precision, inside)
        if rows is None:
            rows, objects = _particles(case, scene)
            _dense(rows, folder / "dense.npz")
        initial_state.write(
            inside / file_layout.GAUSSIANS,
            SerialCommunicator(),
            rows,
            objects,
            None,
            scene.to_json(),
            preparation_hash(scene),
        )


def _scene(case: Case, precision: str, folder: Path) -> Scene:
    path = folder / "scene.toml"
    path.write_text(case.text(precision))
    return load(path)


def _particles(case: Case, scene: Scene) -> tuple[dict, list]:
    """Rows of gaussians.h5 as a run prepares them, then jittered and set in motion."""
    bodies = build_scene(scene)
    random = np.random.default_rng(7)
    x = bodies.x + DX * random.uniform(-0.2, 0.2, bodies.x.shape)
    rows = {
        "x0": x,
        "v0": velocity(case, x),
        "vol0": bodies.vol0,
        "object": bodies.object,
        "cov0": bodies.cov0,
        "opacity": bodies.opacity,
        "sh": bodies.sh,
    }
    return rows, bodies.objects


def velocity(case: Case, x: np.ndarray) -> np.ndarray:
    """Velocities [m/s] (n, 3) at the start of particles at x (n, 3) [m]."""
    phase = 2 * np.pi * (x / DX - START) / case.side
    wave = 0.5 * (np.sin(phase) + np.sin(np.roll(phase, -1, axis=1)))
    return PER_STEP * DX / case.dt * ((1 - SWIRL) * DIRECTION + SWIRL * wave)


def _dense(rows: dict, path: Path) -> None:
    """Return the particles for a dense grid that begins MARGIN cells before the cube.

    They are in the order of its cells, which is best for the rivals: these do not sort.
    """
    x = rows["x0"] - (START - MARGIN) * DX
    cell = np.floor(x / DX - 0.5).astype(np.int64)
    order = np.lexsort((cell[:, 2], cell[:, 1], cell[:, 0]))
    np.savez(path, x=x[order], v=rows["v0"][order], id=order)


def to_dense(x: np.ndarray) -> np.ndarray:
    """Positions [m] of the scene -> of the dense grid."""
    return x - (START - MARGIN) * DX
