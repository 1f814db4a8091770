"""Wave zones of a run: velocities of liquids relax to those of waves before each step."""

import math
from typing import NamedTuple

import numpy as np

from vgmpi.features.active_feature import ActiveFeature, StartContext
from vgmpi.kernels.step_records import StepSpan
from vgmpi.parallel.block_lattice import BITS, BLOCK_CENTER, BLOCK_EDGE
from vgmpi.runtime.jit import device_function, kernel

from .plan import ZonePlan

# [cells] from a particle to the farthest node that its velocity gradient reaches: sqrt(3) 1.5, and
# the square root of 2 of the gradient's two equal entries
GRADIENT_REACH = 3.7
MARGIN_CELLS = 3.0  # [cells] by which particles may leave their block between two sorts, and more


class ZoneConstants(NamedTuple):
    """Zone and wave of a step, as the kernel takes them."""

    axis: int
    direction: float
    outer: float  # [m]
    length: float  # [m]
    low: np.ndarray  # (3,) [m] corners
    high: np.ndarray  # (3,)
    level: float  # [m] z of the surface at rest
    number: float  # [rad/m]
    speed: float  # [m/s] amplitude times frequency over 1 - exp(-2 k h)
    depth: float  # [m]
    crest: float  # [m] height over the level up to which the wave is continued
    phase: float  # [rad] frequency times time
    decay: float  # [-] rate times length of the step
    channel: int  # first channel of the velocity gradient, -1: none
    dx: float  # [m] cell size
    resolution: float  # [m] of the fixed-point positions


class WaveZones(ActiveFeature):
    """Wave zones that act on the particles of one rank, each on its own."""

    def __init__(self, zones: tuple[ZonePlan, ...], context: StartContext):
        """Hold the zones; `find_particles` finds the segments near them."""
        self.zones, self.plan, self.groups = zones, context.plan, context.groups
        self.segments: list[list[np.ndarray]] = [[] for _ in zones]  # by zone and group

    def compile_kernels(self) -> None:
        """Compile the kernel by calls without particles."""
        span = StepSpan(1, 0.0, 1.0, 1.0)
        for group in self.groups:
            if group.plan.is_liquid:
                self._relax(group, np.zeros(0, np.int64), self.zones[0], span)

    def find_particles(self, time: float) -> None:
        """Find the segments of liquids that reach into each zone."""
        dx = self.plan.dx
        self.segments = []
        for each in self.zones:
            low, high = (np.array(corner) / dx for corner in each.zone.corners)
            rows = []
            for group in self.groups:
                first = BLOCK_EDGE * group.block - MARGIN_CELLS
                last = BLOCK_EDGE * (group.block + 1) + MARGIN_CELLS
                is_near = ((first < high) & (last > low)).all(1) & (group.count > 0)
                acts = group.plan.is_liquid and not group.plan.is_carried
                rows.append(np.flatnonzero(is_near & acts))
            self.segments.append(rows)

    def push_particles(self, span: StepSpan) -> float:
        """Relax the velocities over one step.

        Args:
            span: The step.

        Returns:
            Bound of the speed that is added [m/s]: a mean of two velocities exceeds the first by
            no more than its part of the second.
        """
        bound = 0.0
        for each, rows in zip(self.zones, self.segments, strict=True):
            for group, segments in zip(self.groups, rows, strict=True):
                if len(segments):
                    self._relax(group, segments, each, span)
            share = -math.expm1(-each.zone.relaxation_rate * span.dt)
            turn = GRADIENT_REACH * each.number * self.plan.dx
            bound += share * each.max_speed * (1.0 + turn)
        return bound

    def _relax(self, group, segments: np.ndarray, each: ZonePlan, span: StepSpan) -> None:
        """Relax the velocities of some segments of a group (in/out)."""
        zone, real = each.zone, self.plan.real
        speed = each.amplitude(span.end) * each.frequency / -math.expm1(-2.0 * each.reach)
        constants = ZoneConstants(
            zone.axis, float(zone.direction), zone.outer_place, zone.length,
            np.array(zone.corners[0]), np.array(zone.corners[1]), zone.level, each.number, speed,
            zone.depth, zone.height, each.frequency * span.end, zone.relaxation_rate * span.dt,
            group.plan.channels.first("C") if self.plan.affine else -1,
            self.plan.dx, self.plan.dx / 2.0 ** BITS[real],
        )  # fmt: skip
        relax_to_wave(segments, group.start, group.count, group.block, group.xi, group.f, constants)


@kernel
def relax_to_wave(segments, start, count, block, xi, f, zone):
    """Relax velocities, and their gradients, to those of a wave of small amplitude.

    The share of a step is 1 - exp(-rate dt w) with w = s^2 (3 - 2 s), where s is 1 at the outer
    face and 0 at the inner one. The wave is continued above the level at rest up to its height.

    Args:
        segments: Segments to process, shape (n,).
        start, count, block: First particle, number of particles and block of each segment.
        xi: Fixed-point positions in the blocks, shape (3, cap).
        f: Particle channels (in/out), shape (channels, cap).
        zone: `ZoneConstants`.

    References:
        Jacobsen, Fuhrman and Fredsoe (2012). A wave generation toolbox for the open-source CFD
        library OpenFoam. Int. J. Numer. Meth. Fluids 70.
    """
    k, axis, direction, first = zone.number, zone.axis, zone.direction, zone.channel
    longest = 1
    for s in segments:
        longest = max(longest, count[s])
    terms = np.zeros((5, longest))
    for s in segments:
        begin, n = start[s], count[s]
        corner = (BLOCK_EDGE * block[s] + BLOCK_CENTER) * zone.dx
        compute_terms(xi[:, begin : begin + n], corner, zone, terms)
        retained, wide, tall, narrowing, turning = terms
        for a in range(3):
            relax(f[a, begin : begin + n], retained)
        if first >= 0:
            for row in range(first, first + 9):
                relax(f[row, begin : begin + n], retained)
        if zone.speed == 0.0:
            continue
        add(f[axis, begin : begin + n], direction, wide)
        add(f[2, begin : begin + n], 1.0, tall)
        if first >= 0:
            add(f[first + 4 * axis, begin : begin + n], -k, narrowing)
            add(f[first + 8, begin : begin + n], k, narrowing)
            add(f[first + 3 * axis + 2, begin : begin + n], direction * k, turning)
            add(f[first + 6 + axis, begin : begin + n], direction * k, turning)


@device_function
def relax(row, retained):
    """Leave a part of each number of a row (in/out)."""
    for n in range(len(row)):
        row[n] *= retained[n]


@device_function
def add(row, factor, term):
    """Add a factor times a term to each number of a row (in/out)."""
    for n in range(len(row)):
        row[n] += factor * term[n]


@device_function
def compute_terms(xi, corner, zone, terms):
    """Compute what is left of velocities, and the wave's part of them.

    Args:
        xi: Fixed-point positions of a segment, shape (3, n).
        corner: Position [m] of zero.
        zone: `ZoneConstants`.
        terms: The part that is left; of the wave's share, the velocities along and up, and the same
            with sine and cosine exchanged, which the gradients have (out), shape (5, n).
    """
    low, high, axis, other = zone.low, zone.high, zone.axis, 1 - zone.axis
    scale = zone.resolution
    for n in range(xi.shape[1]):
        x = xi[axis, n] * scale + corner[axis]
        y = xi[other, n] * scale + corner[other]
        z = xi[2, n] * scale + corner[2]
        inside = low[axis] <= x <= high[axis] and low[other] <= y <= high[other]
        share = wide = tall = cosine = sine = 0.0
        if inside and low[2] <= z <= high[2]:
            along = zone.direction * (x - zone.outer)
            place = 1.0 - along / zone.length
            share = -math.expm1(-zone.decay * place * place * (3.0 - 2.0 * place))
            if zone.speed > 0.0:
                height = min(max(z - zone.level, -zone.depth), zone.crest)
                strength = share * zone.speed * math.exp(zone.number * height)
                bottom = math.exp(-2.0 * zone.number * (height + zone.depth))
                wide, tall = strength * (1.0 + bottom), strength * (1.0 - bottom)
                angle = zone.number * along - zone.phase
                cosine, sine = math.cos(angle), math.sin(angle)
        terms[0, n] = 1.0 - share
        terms[1, n], terms[2, n] = wide * cosine, tall * sine
        terms[3, n], terms[4, n] = wide * sine, tall * cosine
