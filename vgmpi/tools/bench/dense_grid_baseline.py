"""Base class of the rivals: particles on a dense grid, rounds and checks.

It uses numpy only, so that a rival's process loads nothing of this program but its own tool.
"""

import os
import time

import numpy as np

CARD = os.environ.get("VGMPI_BENCH_DEVICE") == "cuda"  # the rivals compute on a card


class Dense:
    """A rival. A subclass sets `versions` and defines load, step, finish, state and grid_mass.

    Quadratic B-splines, APIC, stress by MLS-MPM (Hu 2018), single precision. Particles are given
    in the order of their cells and not sorted again: that favours the rival. Node i lies at i dx.
    """

    versions: dict[str, str] = {}
    clock = staticmethod(time.process_time)  # includes the threads of the rival's own pool

    def __init__(self, config: dict):
        self.numbers = config["numbers"]
        self.threads = config["threads"]
        if self.threads > 1 or CARD:
            self.clock = time.perf_counter
        with np.load(config["particles"]) as file:
            self.id, self.x0, self.v0 = file["id"], file["x"], file["v"]
        self.count = len(self.id)
        self.mass = self.numbers["density"] * self.numbers["volume"]
        law = self.numbers["constants"]
        if self.numbers["law"] == "fluid" and (law["gamma"] != 7 or law["mu"] != 0):
            raise ValueError("the rivals' fluid has the exponent 7 and no viscosity")
        self.build()

    def build(self) -> None:
        """Allocate and compile."""
        raise NotImplementedError

    def load(self, x: np.ndarray, v: np.ndarray) -> None:
        """Take particles at rest: x (n, 3) [m], v (n, 3) [m/s], float32."""
        raise NotImplementedError

    def step(self) -> None:
        """Compute one step."""
        raise NotImplementedError

    def finish(self) -> None:
        """Wait until all steps are done."""

    def state(self) -> tuple[np.ndarray, np.ndarray]:
        """X and v of all particles."""
        raise NotImplementedError

    def grid_mass(self) -> float:
        """Sum of the mass [kg] on the grid of the last step."""
        raise NotImplementedError

    def restart(self) -> None:
        """Put the particles back to the start."""
        self.load(self.x0.astype(np.float32), self.v0.astype(np.float32))

    def round(self, units: int) -> dict:
        """Time `units` steps; the cube begins again, unmeasured, before it reaches the border."""
        done, seconds, wall = 0, 0.0, 0.0
        while done < units:
            self.restart()
            self.step()  # memory and code are warm when the clock starts
            self.finish()
            n = min(units - done, self.numbers["steps"] - 1)
            began, wall_began = self.clock(), time.perf_counter()
            for _ in range(n):
                self.step()
            self.finish()
            seconds += self.clock() - began
            wall += time.perf_counter() - wall_began
            done += n
        return {"steps": done, "seconds": seconds, "wall": wall, "stages": {}}

    def check(self, steps: int, path: str) -> dict:
        """Write ids, positions and velocities after `steps` steps from the start."""
        self.restart()
        for _ in range(steps):
            self.step()
        self.finish()
        x, v = self.state()
        np.savez(path, id=self.id, x=x, v=v)
        return {"mass": self.grid_mass()}
