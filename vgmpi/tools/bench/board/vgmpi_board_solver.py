"""This program as a solver of the board: a scene of scenes/, stepped as a run is, without files."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.preprocess.initial_conditions import initial_velocity_gradient
from vgmpi.preprocess.scene_builder import build_scene
from vgmpi.runtime.versions import versions
from vgmpi.scene.loader import load
from vgmpi.solver.initial_particles import known_of, plan_for
from vgmpi.solver.restart.state_io import by_id
from vgmpi.solver.simulation import Simulation
from vgmpi.solver.step_to_target import next_step

from .board_cases import BEAM_CLAMP

SCENES = Path(__file__).parent / "scenes"
# [m] corner of a body without a tank in its scene's domain; the wall is the clamp of the beam
CORNERS = {"bar": (0.1, 0.1, 0.1), "cantilever": (-BEAM_CLAMP, 0.125, 0.25)}


class Solver:
    """A scene of the board. Options: threads; any other one is a key of the scene."""

    def __init__(self, case_name: str, options: dict[str, Any]):
        words = {key: value for key, value in options.items() if key != "threads"}
        overrides = tuple(f"{key}={json.dumps(value)}" for key, value in words.items())
        self.scene = load(SCENES / f"{case_name}.toml", overrides)
        self.threads = int(options.get("threads", 1))
        self.corner = np.array(CORNERS.get(case_name, (0.0, 0.0, 0.0)))
        self.prepared = build_scene(self.scene)
        self.plan = plan_for(self.scene, known_of(self.scene, self.prepared))
        self.cell = float(self.scene.domain.cell)
        self.volume = np.asarray(self.prepared.vol0, dtype=np.float64)
        if any(feature.moved_colliders for feature in self.plan.features):
            self.volume = np.append(self.volume, 0.0)  # the row of the block's center
        self.versions = {name: str(text) for name, text in versions().items()}

    def restart(self) -> None:
        """Begin the run again."""
        rows = self.prepared
        self.simulation = Simulation(
            self.plan, SerialCommunicator(), rows.colliders, self.threads, "cpu"
        )
        gradient = initial_velocity_gradient(self.scene, rows.x, rows.object)
        self.simulation.put(
            rows.x, rows.v0, rows.vol0, np.arange(len(rows.x)), rows.object, rows.theta0, gradient,
            rows.sh, rows.surface0,
        )  # fmt: skip

    def advance(self, t: float) -> int:
        """Simulate up to a time [s] and return the number of steps."""
        simulation, steps = self.simulation, 0
        while simulation.time < t:
            target = simulation.next_event_time(t)
            dt, lands = next_step(simulation.time, target, simulation.bound())
            simulation.advance(dt, end=target if lands else None)
            steps += 1
        return steps

    def state(self) -> tuple[np.ndarray, np.ndarray]:
        """Return positions from the tank's corner and velocities, (n, 3) each [m], [m/s]."""
        x, v = by_id(self.simulation, "x", "v")
        rigid: Any = self.simulation.features.get("rigid_bodies")
        if rigid is not None:  # the center of the block is the last row
            bodies = rigid.bodies
            x, v = np.concatenate([x, bodies.x[:1]]), np.concatenate([v, bodies.v[:1, :3]])
        return x - self.corner, v
