"""Impulses between phases at one node, and the distance rule they act by."""

import numpy as np
import pytest

from vgmpi.kernels.contact import (
    TOUCH,
    collider_gap,
    gap,
    outside,
    resolve,
    surface_normal,
)


class Node:
    """Phases with random masses and velocities, and pairs (a, b, outward normal of a, friction)."""

    def __init__(self, seed, phases, pairs, friction=None, spread=3.0):
        random = np.random.default_rng(seed)
        self.v = random.normal(size=(phases, 3))
        self.m = 10.0 ** random.uniform(-spread, spread, phases)
        self.pairs = []
        for a, b in pairs:
            n = random.normal(size=3)
            mu = random.uniform(0, 1.5) if friction is None else friction
            self.pairs.append((a, b, n / np.linalg.norm(n), mu))

    def resolve(self):
        """Velocities afterwards (phases, 3)."""
        k = len(self.pairs)
        v, normals, impulse = self.v.copy(), np.zeros((k, 7)), np.zeros((k, 4))
        normals[:, :3] = [n for _, _, n, _ in self.pairs]
        a, b = (np.array([p[c] for p in self.pairs], np.int64) for c in (0, 1))
        share = np.bincount(np.concatenate([a[a >= 0], b])).max()
        mu = np.array([p[3] for p in self.pairs])
        resolve(v, self.m, len(v), normals, mu, a, b, k, share, impulse)
        return v

    def approach(self, v):
        """Speed at which each pair approaches (pairs,)."""
        still = np.zeros(3)
        return np.array([((v[a] if a >= 0 else still) - v[b]) @ n for a, b, n, _ in self.pairs])

    def energy(self, v):
        return 0.5 * (self.m * (v**2).sum(1)).sum()


ALL3 = [(0, 1), (0, 2), (1, 2)]
ALL4 = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]
SETS = {"pair": (2, [(0, 1)]), "chain": (3, [(0, 1), (1, 2)]), "3": (3, ALL3), "4": (4, ALL4)}


@pytest.mark.parametrize("phases, pairs", SETS.values(), ids=SETS)
def test_momentum_is_exact_and_energy_never_rises(phases, pairs):
    for seed in range(300):
        node = Node(seed, phases, pairs)
        after = node.resolve()
        change = (node.m[:, None] * (after - node.v)).sum(0)
        assert np.abs(change).max() <= 1e-13 * (node.m * np.linalg.norm(node.v, axis=1)).sum()
        assert node.energy(after) <= node.energy(node.v) * (1 + 1e-13)


def test_momentum_whatever_the_masses():
    """Eight phases, each touching all others, of 1e-15 to 1e3 kg."""
    pairs = [(a, b) for a in range(8) for b in range(a + 1, 8)]
    worst = 0.0
    for seed in range(1000):
        node = Node(seed, 8, pairs)
        node.m = 10.0 ** np.random.default_rng(seed).uniform(-15, 3, 8)
        after = node.resolve()
        change = (node.m[:, None] * (after - node.v)).sum(0)
        worst = max(worst, np.abs(change).max() / (node.m * np.linalg.norm(node.v, axis=1)).sum())
        assert node.energy(after) <= node.energy(node.v) * (1 + 1e-13)
    print(f"eighteen decades of mass: momentum {worst:.1e} of sum m |v|")
    assert worst <= 1e-13


def test_one_pair_exactly():
    """It parts, without bouncing, and friction is Coulomb's: at most mu times the normal impulse,
    and it sticks where that is enough.
    """
    stuck = slid = apart = 0
    for seed in range(300):
        node = Node(seed, 2, [(0, 1)])
        (a, b, n, mu), before, after = node.pairs[0], node.v, node.resolve()
        speed = node.approach(before)[0]
        if speed <= 0:
            assert np.array_equal(after, before)
            apart += 1
            continue
        scale = np.abs(before).max()
        assert abs(node.approach(after)[0]) <= 1e-13 * scale
        push = node.m[b] * (after[b] - before[b])
        normal, side = push @ n, push - (push @ n) * n
        slip = after[a] - after[b]
        size = np.linalg.norm(side)
        assert size <= mu * normal * (1 + 1e-9)
        if size < mu * normal * (1 - 1e-9):
            assert np.linalg.norm(slip) <= 1e-12 * scale
            stuck += 1
        else:
            assert side @ slip >= 0 and np.linalg.norm(np.cross(side, slip)) <= 1e-9 * size * scale
            slid += 1
    assert min(stuck, slid, apart) > 20


@pytest.mark.parametrize("phases, pairs", list(SETS.values())[1:], ids=list(SETS)[1:])
def test_several_pairs_hardly_approach(phases, pairs):
    """Sixteen sweeps leave a small part of the speeds; masses within two decades, as at a node
    that several bodies share.
    """
    left = []
    for seed in range(300):
        node = Node(seed, phases, pairs, spread=1.0)
        before = max(node.approach(node.v).max(), 0.0)
        if before > 0.1:
            left.append(max(node.approach(node.resolve()).max(), 0.0) / before)
    print(f"approach left over: median {np.median(left):.1e}, most {max(left):.2f}")
    assert np.median(left) < 0.02
    assert np.quantile(left, 0.9) < 0.25


def test_names_of_phases_do_not_matter():
    """Phases renumbered and pairs listed in another order: the same velocities to 1e-12."""
    for seed in range(200):
        node = Node(seed, 4, ALL4)
        want = node.resolve()
        random = np.random.default_rng(seed + 1000)
        new, order = random.permutation(4), random.permutation(len(ALL4))
        other = Node(seed, 4, ALL4)
        other.v[new], other.m[new] = node.v, node.m
        other.pairs = []
        for q in order:
            a, b, n, mu = node.pairs[q]
            if random.random() < 0.5:  # the other one's normal
                a, b, n = b, a, -n
            other.pairs.append((new[a], new[b], n, mu))
        assert np.abs(other.resolve()[new] - want).max() <= 1e-12 * np.abs(node.v).max()


def test_collider_does_not_move():
    """A phase that meets a rigid body keeps what lies along it, less friction."""
    for seed in range(100):
        node = Node(seed, 1, [(-1, 0)])
        ((_, _, n, mu),) = node.pairs
        v, after = node.v[0], node.resolve()[0]
        into = -(v @ n)
        if into <= 0:
            assert np.array_equal(after, v)
            continue
        side = v + into * n
        keep = max(0.0, 1.0 - mu * into / np.linalg.norm(side))
        assert np.abs(after - keep * side).max() <= 1e-13


# --- where surfaces are ---


def mean_offset(d, n=200_000):
    """Mean offset [cells] into a half space that begins d cells from a node, weighted with the
    quadratic B-spline, by the midpoint rule; None where the node does not see it.
    """
    u = (np.arange(n) + 0.5) / n * 3.0 - 1.5
    w = np.where(np.abs(u) < 0.5, 0.75 - u**2, 0.5 * (1.5 - np.abs(u)) ** 2)
    w = np.where(u >= d, w, 0.0)
    return (w * u).sum() / w.sum() if w.sum() > 0 else None


def test_outside_is_near_its_definition():
    """Good to .003 where the fit is meant to hold; beyond, the line to the far side."""
    worst = 0.0
    for d in np.linspace(-1.49, 1.2, 200):
        m = mean_offset(d)
        if m < 0.75:
            worst = max(worst, abs(outside(m) - d))
    print(f"largest error of the fit: {worst:.4f} cells")
    assert worst < 0.003


def test_outside_rises():
    m = np.linspace(-0.2, 2.5, 5001)
    d = np.array([outside(v) for v in m])
    assert (np.diff(d) >= -5e-3).all(), "it falls"
    assert d[0] == -1.5 and d[-1] == 1.5
    inner = (m > 1e-3) & (m < 0.749)
    assert (np.diff(d[inner]) > 0).all()
    assert abs(outside(0.75 - 1e-9) - outside(0.75)) < 5e-3, "it jumps where the two parts meet"
    assert abs(outside(1e-12)) - 1.5 == pytest.approx(0.0, abs=2e-4)


def sums(d, normal, dx):
    """Offset sums and volume (4,) of a half space that begins d cells from a node, along normal."""
    volume = 3e-6
    return np.append(mean_offset(d) * dx * volume * np.array(normal), volume)


@pytest.mark.parametrize("a, b", [(-0.2, 0.3), (0.1, 0.1), (0.4, -0.6), (0.3, 0.6)])
def test_gap_of_two_half_spaces(a, b):
    """The master below the node by a, the other above by b: they are a + b apart."""
    dx, up = 0.02, np.array([0.6, 0.0, 0.8])
    n = np.zeros(3)
    pair = sums(a, -up, dx), sums(b, up, dx)
    assert surface_normal(n, *pair, dx)
    assert np.allclose(n, up)
    assert gap(n, *pair, dx) == pytest.approx(a + b, abs=0.006)
    # a node in the midst of the master has no normal of its own: the other's counts
    buried = np.array([0.0, 0.0, 0.0, 1e-6])
    n[:] = 0
    assert surface_normal(n, buried, sums(b, up, dx), dx)
    assert np.allclose(n, up)
    assert gap(n, buried, sums(b, up, dx), dx) < TOUCH
    assert not surface_normal(n, buried, buried, dx)
    assert collider_gap(up, a * dx, sums(b, up, dx), dx) == pytest.approx(a + b, abs=0.004)
