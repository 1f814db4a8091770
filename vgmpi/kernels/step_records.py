"""What a time step is given and what it reports: its span, results and maxima."""

from typing import NamedTuple

import numpy as np

from vgmpi.planning.plan import Plan

# Columns of the running maxima of a thread, which the kernels of a step fill: 1/dt [1/s], distance
# of a particle from the center of its block [cells], lowest id of the failed particles plus 1 and
# the reason, speed along an axis [cells/s], squared norm of the velocity gradient [1/s2].
RATE, STRAY, FAILED_ID, FAILURE, SPEED, GRADIENT2 = range(6)
MAXIMA = 6
# Generators of a low-discrepancy sequence in the unit cube (Roberts 2018)
DITHER = (0.8191725133961645, 0.6710436067037893, 0.5497004779019703)


def dither_of_step(step: int) -> tuple[float, float, float]:
    """Return what a step adds to positions before they are rounded down, equal on all ranks."""
    x, y, z = (d * step % 1.0 for d in DITHER)
    return x, y, z


class StepSpan(NamedTuple):
    """Time step from time level n to n + 1."""

    number: int  # of the step, 1 for the first one of a run
    start: float  # [s] time n
    end: float  # [s] time n + 1
    dt: float  # [s] length


class AccumulatorOverflow(NamedTuple):
    """Node block in which a sum left its range; the lowest block is reported."""

    block: tuple[int, ...]  # (3,) block coordinates
    phase: int  # velocity field
    field: str  # name of the nodal field


class StepReport(NamedTuple):
    """Result of a step on this rank."""

    rate: float  # [1/s] lower bound of 1/dt from the particles
    stray: float  # [cells] largest distance of a particle from the center of its block
    bounds: tuple[float, float, float]  # speed, velocity gradient, stress: see `ParticleMaxima`
    failures: list[tuple[int, int]]  # failed particles: id and reason (g2p.INVALID_VOLUME ...)
    overflows: list[AccumulatorOverflow]  # sums that left their range


class ParticleMaxima(NamedTuple):
    """Maxima over all particles in the previous step, which bound the sums of the next step."""

    speed: float  # [m/s] largest velocity component
    turn: float  # [1/s] norm of the velocity gradient
    stress: float  # [m^2/s^2] stress divided by density
    rate: float  # [1/s] lower bound of 1/dt, see `StepReport`
    dt: float  # [s] length of that step

    def fastest(self, plan: Plan, dt: float, load_speed: float) -> float:
        """Return the speed above which the sums of a step hold no momentum per mass [m/s].

        The quanta of the sums follow from it. A particle gives a node at most its own speed, its
        velocity gradient over the distance 1.5 sqrt(3) dx, and the action of its stress. The stress
        has grown by at most the stiffness, rho c^2, times the strain of a step; 3 times that is
        allowed for.

        Args:
            plan: Plan of the run.
            dt: Length of the step [s].
            load_speed: Speed added by loads [m/s].
        """
        waves = (self.rate * plan.time_step.cfl * plan.dx) ** 2
        stress = 2.0 * self.stress + 3.0 * waves * self.turn * self.dt
        speed = self.speed + load_speed + 2.6 * plan.dx * self.turn + 4.0 * dt / plan.dx * stress
        speed *= 1.0 + 4.0 * plan.correction_interval  # exceeds what transfers can have lost
        return float(min(plan.dx / dt, speed))


UNKNOWN_MAXIMA = ParticleMaxima(np.inf, np.inf, np.inf, np.inf, 0.0)


class ParticleBounds(NamedTuple):
    """Bounds of the time step and of the nodal sums for some particles."""

    rate: float = 0.0  # [1/s] least 1/dt
    speed: float = 0.0  # [m/s] largest speed
    turn: float = 0.0  # [1/s] norm of the velocity gradient
    stress: float = 0.0  # [m^2/s^2] stress divided by density

    def merge(self, other: "ParticleBounds") -> "ParticleBounds":
        """Return bounds that hold for both."""
        return ParticleBounds(*np.maximum(self, other).tolist())

    def maxima(self, dt: float) -> ParticleMaxima:
        """Return what bounds the sums of the step after one of length dt [s]."""
        return ParticleMaxima(self.speed, self.turn, self.stress, self.rate, dt)


class StepMaxima(NamedTuple):
    """Results of a step over all ranks."""

    bounds: ParticleBounds
    stray: float  # [cells] see `StepReport`
    has_failed: bool  # a particle or a sum of any rank failed
    requests: np.ndarray  # maxima of what the caller asked for
    requests_of_features: dict[str, float]  # of each feature that has one, see `ActiveFeature`
