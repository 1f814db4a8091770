"""Phases that share space at one node: what the compiled solve keeps whatever the numbers are.

Over 10,000 random states of 1 to 8 phases, masses from 1e-15 to 1e3 kg (and 0 where the elimination
is called alone), drags from 1e-12 to 1e15, slip times from 0 to infinity: momentum, energy, range
of velocities, numbering of phases, phases cut in two, shares of the pressure.
"""

import functools
from fractions import Fraction

import numpy as np
import pytest

from vgmpi.features.mixtures.kernels import (
    MIN_POROSITY,
    MIN_VOLUME_FRACTION,
    MixtureFields,
    couple_block,
    solve_drag_exchange,
)
from vgmpi.features.mixtures.rules import InteractionRules
from vgmpi.features.mixtures.workspace import mixture_tables, mixture_workspace, to_pointers
from vgmpi.kernels.kernel_arguments import BlockContext, NodalFields
from vgmpi.kernels.simd.vector16 import load, pointer
from vgmpi.runtime.aligned_arrays import aligned_zeros
from vgmpi.runtime.jit import kernel

STATES = 10_000
SLIPS = (0.0, np.inf)


@kernel
def solve(n, phase, grid, forces, offsets, cells, least, room, rules, dt, dx, drift):
    """A block far from walls in which all n phases are."""
    of, rules = to_pointers(room, rules)
    here = BlockContext(0, n, True, False, 9, 9, 9)
    nodes = NodalFields(
        pointer(phase), pointer(least), pointer(cells), pointer(grid), pointer(forces),
        pointer(offsets),
    )  # fmt: skip
    fields = MixtureFields(nodes, pointer(drift), pointer(drift))
    couple_block(here, fields, of, rules, dt, dx)


@kernel
def eliminate(n, grid, room, rules):
    of, _ = to_pointers(room, rules)
    solve_drag_exchange(n, 0, load(of.M, 0) >= 0.0, pointer(grid), of)


@functools.cache
def workspace(n):
    """As for blocks in a run, one for all."""
    return mixture_workspace(n, np.dtype(float))


class Node:
    """Phases of one set at a node, with their rules; all arrays have a row per phase."""

    def __init__(self, seed, drag=True, mixing=True, diffusion=True, push=True, printed=True):
        random = self.random = np.random.default_rng(seed)
        n = random.integers(1, 9)
        decades = random.choice([2.0, 18.0])
        self.m = 10.0 ** random.uniform(3.0 - decades, 3.0, n)
        self.V = self.m / 10.0 ** random.uniform(1.0, 4.0, n)
        self.v = random.normal(size=(n, 3)) * 10.0 ** random.uniform(-6, 2)
        self.dt = 10.0 ** random.uniform(-8, -2)
        # a cell that is empty, about full, or far too full
        self.cell = self.V.sum() * 10.0 ** random.uniform(-1, 1)
        self.dx = np.cbrt(self.cell)
        self.X = random.uniform(-1.5, 1.5, (n, 3)) * self.dx * self.V[:, None]
        self.fluid = random.random(n) < 0.6
        self.f = np.zeros((n, 3))
        if push:  # only fluids' impulses are kept apart
            self.f = random.normal(size=(n, 3)) * (self.m * self.fluid)[:, None]
        groups = 3 if mixing else 0
        self.mix = np.where(self.fluid, random.integers(-1, max(groups, 1), n), -1)
        self.slip = 10.0 ** random.uniform(-9, 3, groups)
        for k in np.flatnonzero(random.random(groups) < 0.4):
            self.slip[k] = random.choice(SLIPS)
        self.diffusion = 10.0 ** random.uniform(-9, -1, groups) * (random.random(groups) < 0.7)
        self.diffusion *= diffusion
        self.printed_mix = (random.random(groups) < 0.3) & printed
        self.porosity = np.where(self.fluid, 0.0, random.uniform(0.05, 0.9, n))
        c = 10.0 ** random.uniform(-12, 15, (n, n)) * (random.random((n, n)) < 0.8) * drag
        c = np.triu(c, 1) * (self.fluid[:, None] != self.fluid)
        self.drag = c + c.T
        odd = np.triu(random.random((n, n)) < 0.2, 1) & printed
        self.printed_drag = odd | odd.T

    ROWS = ("m", "V", "v", "X", "f", "fluid", "mix", "porosity")
    PAIRS = ("drag", "printed_drag")

    def taken(self, which):
        """A node with these phases of this one, in this order; one may be there more than once."""
        node = object.__new__(Node)
        node.__dict__.update(self.__dict__)
        for name in self.ROWS:
            setattr(node, name, getattr(self, name)[which].copy())
        for name in self.PAIRS:
            setattr(node, name, getattr(self, name)[np.ix_(which, which)].copy())
        return node

    def rules(self):
        n = len(self.m)
        return InteractionRules(
            pair=np.zeros((n, n), np.int64), mixture_set=np.zeros(n, np.int64), sets=1,
            fluid=self.fluid, mix=self.mix.astype(np.int64), mixing_group_count=len(self.slip),
            diffusion=self.diffusion, slip_relaxation_time=self.slip, drag=self.drag,
            porosity=self.porosity,
            has_drag=bool(self.drag.any()), volume=np.where(self.fluid, 0.0, self.V / self.m),
            printed_mix=self.printed_mix, printed_drag=self.printed_drag,
        )  # fmt: skip

    def exchange(self):
        """Velocities afterwards (n, 3): all nodes of a block are given this state."""
        n = len(self.m)
        grid, forces, offsets, drift = (
            aligned_zeros(256 * n, float).reshape(n, 64, 4) for _ in range(4)
        )
        for field, three, one in (
            (grid, self.v, self.m), (forces, self.f, self.V), (offsets, self.X, self.V)
        ):  # fmt: skip
            field[..., :3], field[..., 3] = three[:, None], one[:, None]
        flat = [field.reshape(-1) for field in (grid, forces, offsets)]
        known = workspace(n), mixture_tables(self.rules())
        solve(n, np.arange(n), *flat, np.ones(3, np.int64), np.zeros(n), *known, self.dt, self.dx,
              drift.reshape(-1))  # fmt: skip
        assert np.isfinite(grid).all() and (grid[:, 1:] == grid[:, :1]).all()
        self.drift = drift[:, 0, :3].copy()
        return grid[:, 0, :3].copy()

    def energy(self, v):
        return 0.5 * (self.m * (v**2).sum(1)).sum()

    def momentum(self, v):
        return (self.m[:, None] * v).sum(0)

    def size(self, v):
        """sum m |v|"""
        return (self.m * np.linalg.norm(v, axis=1)).sum()


def test_momentum_is_kept():
    worst = 0.0
    for seed in range(STATES):
        node = Node(seed)
        after = node.exchange()
        want = node.momentum(node.v) + node.f.sum(0)
        # what drifts carry, both ways, counts as speed
        scale = node.size(node.v) + node.size(after) + np.linalg.norm(node.f, axis=1).sum()
        worst = max(worst, np.abs(node.momentum(after) - want).max() / scale)
        worst = max(worst, np.abs(node.momentum(node.drift)).max() / scale)
    print(f"momentum: {worst:.1e} of sum m |v| at worst")
    assert worst <= 1e-12


def test_drag_takes_energy_and_keeps_the_range_of_velocities():
    rise, worst, fell = 0.0, 0.0, 0
    for seed in range(STATES):
        node = Node(seed, mixing=False, push=False)
        after = node.exchange()
        ratio = node.energy(after) / node.energy(node.v)
        over = np.maximum(after - node.v.max(0), node.v.min(0) - after)
        worst = max(worst, (over / np.abs(node.v).max(0)).max())
        rise, fell = max(rise, ratio - 1.0), fell + (ratio < 0.9)
    print(f"drag: energy rises by {rise:.1e} at most, falls by a tenth in {fell} states")
    print(f"range: left by {worst:.1e} of the largest velocity at worst")
    assert rise <= 1e-13 and worst <= 1e-14 and fell > STATES / 20


def test_mixing_without_diffusion_takes_energy():
    rise, fell = 0.0, 0
    for seed in range(STATES):
        node = Node(seed, drag=False, diffusion=False, push=False)
        ratio = node.energy(node.exchange()) / node.energy(node.v)
        rise, fell = max(rise, ratio - 1.0), fell + (ratio < 0.9)
    print(f"mixing: energy rises by {rise:.1e} at most, falls by a tenth in {fell} states")
    assert rise <= 1e-13 and fell > STATES / 20


def scale(node, after):
    """Largest velocity [m/s] there is at any time of the exchange: rounding is relative to it."""
    fluid, grains = node.V[node.fluid].sum(), node.V[~node.fluid].sum()
    part = node.V / np.where(node.fluid, fluid, grains)
    push = (part / node.m).max() * np.abs(node.f.sum(0)).max()
    drift = 0.0
    if node.diffusion.any():
        drift = min(
            node.dx / (2 * node.dt), 12.0 * node.diffusion.max() / node.dx / MIN_VOLUME_FRACTION
        )
    return max(np.abs(node.v).max(), np.abs(after).max()) + push + drift


def test_numbers_of_phases_do_not_matter():
    worst = 0.0
    for seed in range(STATES):
        node = Node(seed)
        want = node.exchange()
        order = node.random.permutation(len(node.m))
        got = node.taken(order).exchange()
        worst = max(worst, np.abs(got - want[order]).max() / scale(node, want))
    print(f"renumbered: {worst:.1e} of the largest velocity at worst")
    assert worst <= 1e-12


def test_a_phase_may_be_cut_in_two():
    """Two halves of a phase behave as the whole: no rule depends on how many phases there are. Not
    the printed drag, whose formula is not of that kind."""
    worst, tried = 0.0, 0
    for seed in range(STATES):
        node = Node(seed)
        if node.printed_drag.any():
            node.printed_drag[:] = False
        n = len(node.m)
        cut = node.random.integers(n)
        mixed = node.mix == node.mix[cut]
        part = node.V / node.V[mixed].sum()
        if node.mix[cut] >= 0 and node.diffusion.any() and part[cut] < 2 * MIN_VOLUME_FRACTION:
            continue
        halves = node.taken(np.append(np.arange(n), cut))
        for name in ("m", "V", "X", "f"):
            getattr(halves, name)[[cut, n]] *= 0.5
        want, got = node.exchange(), halves.exchange()
        error = max(np.abs(got[:n] - want).max(), np.abs(got[n] - want[cut]).max())
        worst, tried = max(worst, error / scale(node, want)), tried + 1
    print(f"cut in two: {worst:.1e} of the largest velocity at worst, {tried} states")
    assert worst <= 1e-12 and tried > STATES / 2


def test_pressure_by_shares_of_the_space():
    """Each phase gets the fluids' impulse by its share of the space, and all of it is given."""
    wet, worst = 0, 0.0
    for seed in range(STATES):
        node = Node(seed, drag=False, mixing=False)
        got = node.m[:, None] * (node.exchange() - node.v)
        fluid, grains = node.V[node.fluid].sum(), node.V[~node.fluid].sum()
        pores = 1.0
        if fluid > 0 and grains > 0:
            pores = max(MIN_POROSITY, 1.0 - grains / max(grains + fluid, node.cell))
            wet += 1
        share = np.where(node.fluid, pores / (fluid or 1.0), (1.0 - pores) / (grains or 1.0))
        want = (share * node.V)[:, None] * node.f.sum(0)
        size = np.linalg.norm(node.f, axis=1).sum() + node.size(node.v)
        worst = max(worst, np.abs(got - want).max() / size)
        assert fluid == 0 or (share * node.V).sum() == pytest.approx(1.0, abs=1e-14)
    print(f"shares of the pressure: {worst:.1e} of the momenta at worst, {wet} states with sand")
    assert worst <= 1e-14 and wet > STATES / 3


def eliminated(m, v, K):
    """(diag(m) + L(K))^-1 m v in exact arithmetic: (n, 3)."""
    n = len(m)
    A = [[Fraction(float(-K[a, b])) for b in range(n)] for a in range(n)]
    b = [[Fraction(float(m[a])) * Fraction(float(c)) for c in v[a]] for a in range(n)]
    for a in range(n):
        A[a][a] = Fraction(float(m[a])) - sum(A[a][b] for b in range(n) if b != a)
    for k in range(n):
        for i in range(n):
            if i != k:
                part = A[i][k] / A[k][k]
                A[i] = [x - part * y for x, y in zip(A[i], A[k], strict=True)]
                b[i] = [x - part * y for x, y in zip(b[i], b[k], strict=True)]
    return np.array([[float(x / A[k][k]) for x in b[k]] for k in range(n)])


def exchanges(seed, empty):
    """(masses, velocities, exchanges) of 2 to 8 phases; with `empty` some have no mass."""
    random = np.random.default_rng(seed)
    n = random.integers(2, 9)
    m = 10.0 ** random.uniform(-15, 3, n)
    if empty:
        m[random.random(n) < 0.3] = 0.0
    K = np.triu(10.0 ** random.uniform(-12, 15, (n, n)) * (random.random((n, n)) < 0.7), 1)
    return m, random.normal(size=(n, 3)), K + K.T


def relaxed(m, v, K):
    n = len(m)
    space, grid = (
        mixture_workspace(n, np.dtype(float)),
        aligned_zeros((n, 64, 4), float),
    )
    grid[..., :3], grid[..., 3] = v[:, None], m[:, None]
    space.block[:] = np.arange(n)
    space.M[:] = np.repeat(m, 16)
    space.K[:] = np.repeat(K.ravel(), 16)
    eliminate(n, grid.reshape(-1), space, mixture_tables(Node(0).rules()))
    return grid[:, 0, :3].copy()


def test_elimination_against_exact_arithmetic():
    """Where a general linear solver loses all digits."""
    worst, solver = 0.0, 0.0
    for seed in range(300):
        m, v, K = exchanges(seed, empty=False)
        want = eliminated(m, v, K)
        worst = max(worst, np.abs(relaxed(m, v, K) - want).max() / np.abs(v).max())
        try:
            plain = np.linalg.solve(np.diag(m + K.sum(1)) - K, m[:, None] * v)
            solver = max(solver, np.abs(plain - want).max() / np.abs(v).max())
        except np.linalg.LinAlgError:
            solver = np.inf
    print(f"elimination: {worst:.1e} of the largest velocity; numpy.linalg.solve: {solver:.1e}")
    assert worst <= 1e-13 and solver > 0.1


def test_elimination_with_phases_without_mass():
    worst = 0.0
    for seed in range(STATES):
        m, v, K = exchanges(seed, empty=True)
        if not m.any():
            continue
        after = relaxed(m, v, K)
        assert np.isfinite(after).all()
        change = (m[:, None] * (after - v)).sum(0)
        worst = max(worst, np.abs(change).max() / (m * np.linalg.norm(v, axis=1)).sum())
        assert (m * (after**2).sum(1)).sum() <= (m * (v**2).sum(1)).sum() * (1 + 1e-13)
        # a phase without mass that meets none keeps its velocity
        assert (after <= v.max(0) + 1e-14).all() and (after >= v.min(0) - 1e-14).all()
    print(f"momentum with empty phases: {worst:.1e}")
    assert worst <= 1e-12


@pytest.mark.parametrize("slip", SLIPS)
def test_ends_of_the_slip_time(slip):
    """0: fluids that mix move alike at once; infinite: nothing slows their slip."""
    node = Node(1, diffusion=False, push=False, drag=False)
    node = node.taken([0, 0, 0])
    node.fluid[:], node.mix[:] = True, 0
    node.m[:], node.V[:], node.v = [1, 2, 3], [1e-3, 3e-3, 2e-3], np.arange(9.0).reshape(3, 3)
    node.slip, node.diffusion = np.array([slip]), np.zeros(1)
    node.printed_mix = np.zeros(1, bool)
    want = node.v if slip else np.tile(node.momentum(node.v) / 6.0, (3, 1))
    assert np.abs(node.exchange() - want).max() <= 1e-14
