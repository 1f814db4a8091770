"""Impulses between phases at one node, and the distance rule they act by."""

import numpy as np
import pytest

from vgmpi.kernels.grid import contact_impulses
from vgmpi.kernels.grid.contact_impulses import (
    LAYER_MAX_OVERLAP,
    LAYER_OFFSET,
    LAYER_STIFFNESS,
    distance,
    distance_from_mean_offset,
    face_fraction,
    half_space_fraction,
    surface_normal,
)
from vgmpi.solver.engines.numpy_reference import contact as plain


def _with_rigid(v):
    """Velocities (phases, 3), and behind them those of what is rigid, at rest."""
    return np.concatenate([v, np.zeros((2, 3))])


class Node:
    """Phases with random masses and velocities, and pairs (a, b, outward normal of a, friction)."""

    def __init__(self, seed, phases, pairs, friction=None, spread=3.0, fraction=1.0):
        random = np.random.default_rng(seed)
        self.v = random.normal(size=(phases, 3))
        self.m = 10.0 ** random.uniform(-spread, spread, phases)
        self.pairs, self.fraction = [], np.full(len(pairs), fraction)
        for a, b in pairs:
            n = random.normal(size=3)
            mu = random.uniform(0, 1.5) if friction is None else friction
            self.pairs.append((a, b, n / np.linalg.norm(n), mu))

    def resolve(self):
        """Velocities afterwards (phases, 3)."""
        k, n = len(self.pairs), len(self.v)
        v, normals, impulse = _with_rigid(self.v), np.zeros((k, 10)), np.zeros((k, 4))
        normals[:, :3] = [n for _, _, n, _ in self.pairs]
        a, b = (np.array([p[c] for p in self.pairs], np.int64) for c in (0, 1))
        share = np.bincount(np.concatenate([a[a >= 0], b])).max()
        mu = np.array([p[3] for p in self.pairs])
        solve = contact_impulses.solve_contact_impulses
        solve(v, self.m, n, normals, mu, self.fraction, a, b, k, share, impulse)
        return v[:n]

    def approach(self, v):
        """Speed at which each pair approaches (pairs,)."""
        still = np.zeros(3)
        return np.array([((v[a] if a >= 0 else still) - v[b]) @ n for a, b, n, _ in self.pairs])

    def energy(self, v):
        return 0.5 * (self.m * (v**2).sum(1)).sum()

    def check(self, after):
        """Momentum is exact and energy does not rise; the change of momentum by sum m |v|."""
        change = np.abs((self.m[:, None] * (after - self.v)).sum(0)).max()
        change /= (self.m * np.linalg.norm(self.v, axis=1)).sum()
        assert change <= 1e-13
        assert self.energy(after) <= self.energy(self.v) * (1 + 1e-13)
        return change


ALL3 = [(0, 1), (0, 2), (1, 2)]
ALL4 = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]
SETS = {"pair": (2, [(0, 1)]), "chain": (3, [(0, 1), (1, 2)]), "3": (3, ALL3), "4": (4, ALL4)}


@pytest.mark.parametrize("phases, pairs", SETS.values(), ids=SETS)
def test_momentum_is_exact_and_energy_never_rises(phases, pairs):
    for seed in range(300):
        node = Node(seed, phases, pairs)
        node.check(node.resolve())


def test_momentum_whatever_the_masses():
    """Eight phases, each touching all others, of 1e-15 to 1e3 kg."""
    pairs = [(a, b) for a in range(8) for b in range(a + 1, 8)]
    worst = 0.0
    for seed in range(1000):
        node = Node(seed, 8, pairs)
        node.m = 10.0 ** np.random.default_rng(seed).uniform(-15, 3, 8)
        worst = max(worst, node.check(node.resolve()))
    print(f"eighteen decades of mass: momentum {worst:.1e} of sum m |v|")


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
            worst = max(worst, abs(distance_from_mean_offset(m) - d))
    print(f"largest error of the fit: {worst:.4f} cells")
    assert worst < 0.003


def test_outside_rises():
    m = np.linspace(-0.2, 2.5, 5001)
    d = np.array([distance_from_mean_offset(v) for v in m])
    assert (np.diff(d) >= -5e-3).all(), "it falls"
    assert d[0] == -1.5 and d[-1] == 1.5
    inner = (m > 1e-3) & (m < 0.749)
    assert (np.diff(d[inner]) > 0).all()
    jump = distance_from_mean_offset(0.75 - 1e-9) - distance_from_mean_offset(0.75)
    assert abs(jump) < 5e-3, "it jumps where the two parts meet"
    assert abs(distance_from_mean_offset(1e-12)) - 1.5 == pytest.approx(0.0, abs=2e-4)


def sums(d, normal, dx):
    """Offset sums and volume (4,) of a half space that begins d cells from a node, along normal."""
    volume = 3e-6
    return np.append(mean_offset(d) * dx * volume * np.array(normal), volume)


def gap(n, a, b, dx):
    """Distance [cells] between two phases whose surfaces are not known."""
    return distance(n, 1.0, a, 1.0, False, dx) + distance(n, -1.0, b, 1.0, False, dx)


@pytest.mark.parametrize("a, b", [(-0.2, 0.3), (0.1, 0.1), (0.4, -0.6), (0.3, 0.6)])
def test_gap_of_two_half_spaces(a, b):
    """The master below the node by a, the other above by b: they are a + b apart."""
    dx, up = 0.02, np.array([0.6, 0.0, 0.8])
    n, flows = np.zeros(3), (1.0, 1.0, False, False, dx)
    pair = sums(a, -up, dx), sums(b, up, dx)
    assert surface_normal(n, *pair, *flows)
    assert np.allclose(n, up)
    assert gap(n, *pair, dx) == pytest.approx(a + b, abs=0.006)
    # a node in the midst of the master has no normal of its own: the other's counts
    buried = np.array([0.0, 0.0, 0.0, 1e-6])
    n[:] = 0
    assert surface_normal(n, buried, sums(b, up, dx), *flows)
    assert np.allclose(n, up)
    assert gap(n, buried, sums(b, up, dx), dx) < contact_impulses.GAP_UNRESOLVED
    assert not surface_normal(n, buried, buried, *flows)


def known(normal, away, mass, dx):
    """What a node knows (4,) of a surface whose mean normal (3,) is this, `away` [cells] off."""
    return np.append(mass * np.array(normal), mass * away * dx)


def test_normal_and_distance_of_known_surfaces():
    dx, up, n = 0.02, np.array([0.6, 0.0, 0.8]), np.zeros(3)
    face, light = known(up, 0.3, 5.0, dx), known(-up, -0.2, 1e-3, dx)
    assert surface_normal(n, face, light, 5.0, 1e-3, True, True, dx)
    assert n == pytest.approx(up)
    assert distance(n, 1.0, face, 5.0, True, dx) == pytest.approx(0.3)
    assert distance(n, -1.0, light, 1e-3, True, dx) == pytest.approx(-0.2)
    # each counts alike whatever its mass: between two faces that are not parallel, the mean
    assert surface_normal(n, face, known([0, 0, -1], 0, 1e-3, dx), 5.0, 1e-3, True, True, dx)
    assert n == pytest.approx((up + [0, 0, 1]) / np.linalg.norm(up + [0, 0, 1]))
    # an edge, of which the particles disagree, hardly turns a face's
    edge = known([-0.7, 0, 0], 0, 5.0, dx)
    assert surface_normal(n, edge, known([0, 0, -1], 0, 5.0, dx), 5.0, 5.0, True, True, dx)
    assert n @ [0, 0, 1] > 0.9999
    # with what flows the known one's counts, whichever is first
    pool = sums(0.1, [1, 0, 0], dx)
    assert surface_normal(n, face, pool, 5.0, 1.0, True, False, dx)
    assert n == pytest.approx(up)
    assert surface_normal(n, pool, face, 1.0, 5.0, False, True, dx)
    assert n == pytest.approx(-up)
    still = np.zeros(4)
    assert not surface_normal(n, still, still, 1.0, 1.0, True, True, dx)


def test_filled_is_what_a_half_space_gives():
    """The quadratic B-spline's integral from D on, by the midpoint rule."""
    n = 300_000
    u = (np.arange(n) + 0.5) / n * 3.0 - 1.5
    w = np.where(np.abs(u) < 0.5, 0.75 - u**2, 0.5 * (1.5 - np.abs(u)) ** 2)
    beyond = np.append(np.cumsum(w[::-1])[::-1], 0.0) * 3.0 / n
    edges = np.linspace(-1.5, 1.5, n + 1)
    for D in np.linspace(-1.7, 1.7, 171):
        assert half_space_fraction(D) == pytest.approx(np.interp(D, edges, beyond), abs=1e-9)
        assert plain.filled(D) == pytest.approx(half_space_fraction(D), abs=1e-14)


def test_share_of_a_face():
    """All of it where the node has what a half space gives, less at an edge, never much more."""
    for D in (-1.0, -0.3, 0.0, 0.4, 1.0):
        assert face_fraction(3.0 * half_space_fraction(D), 3.0, D) == pytest.approx(1.0)
        assert face_fraction(1.5 * half_space_fraction(D), 3.0, D) == pytest.approx(0.5)
        assert face_fraction(30.0, 3.0, D) == 1.5


def meeting(
    one=-0.05, other=-0.05, a=0, sure=True, known=True, stiff=1e5, friction=0.0, faces=False
):
    return contact_impulses.ContactPair(
        a, 1 if a == 0 else 0, one, other, known, True, sure, 1.0, stiff, friction, faces
    )


def pushed(v, mass, m, n, dt, dx, slope=None):
    """Changes (count, 3) of velocities by an elastic layer. slope (count, 3): of these, per cell
    along the normal of each."""
    change = np.zeros_like(v)
    slope = np.zeros_like(v) if slope is None else slope
    contact_impulses.apply_penalty_layer(change, _with_rigid(v), slope, mass, m, n, dt, dx)
    return change


def layers(count, bodies):
    """Arguments of `pushed` at random, deep and shallow, fast and slow, heavy and light, of
    `bodies` that move."""
    for seed in range(count):
        random = np.random.default_rng(seed)
        one, other = random.uniform(-0.4, 0.3, 2)
        friction = random.choice([0.0, random.uniform(0, 1.5)])
        stiff = 10.0 ** random.uniform(2, 8)
        m = meeting(one, other, bodies - 2, stiff=stiff, friction=friction)
        m = m._replace(share=random.uniform(0, 1.5))
        n = random.normal(size=3)
        v = random.normal(size=(bodies, 3)) * random.choice([0.0, 0.01, 10.0])
        slope = random.normal(size=(bodies, 3)) * random.choice([0.0, 0.01, 10.0])
        mass = 10.0 ** random.uniform(-9, 1, bodies)
        yield v, slope, mass, m, n / np.linalg.norm(n), 10.0 ** random.uniform(-6, -3), 0.02


@pytest.mark.parametrize("bodies", [1, 2])
def test_a_layer_pushes_apart_and_rubs_no_more_than_that(bodies):
    """Momentum to rounding; no pull; Coulomb's friction, which never turns how the surfaces slide;
    what is light is not thrown further than half the overlap in a step. As in plain numpy."""
    acted = stuck = slid = held = 0
    for v, slope, mass, m, n, dt, dx in layers(2000, bodies):
        change = pushed(v, mass, m, n, dt, dx, slope)
        if m.distance_a + m.distance_b >= -LAYER_OFFSET:
            assert not change.any()
            continue
        acted += 1
        impulse = mass[m.b] * change[m.b]
        size = np.linalg.norm(impulse)
        if bodies == 2:
            assert np.abs(mass[0] * change[0] + impulse).max() <= 1e-14 * size
        before = (v[0] if bodies == 2 else 0.0) - v[m.b]
        after = before + (change[0] if bodies == 2 else 0.0) - change[m.b]
        push = impulse @ n
        rub = impulse - push * n
        assert push >= 0
        assert np.linalg.norm(rub) <= m.friction * push * (1 + 1e-9) + 1e-14 * size
        slides = before + m.distance_b * slope[m.b]
        if bodies == 2:
            slides -= m.distance_a * slope[0]
        slip = slides - (slides @ n) * n
        left = slip + (after - before) - ((after - before) @ n) * n
        scale = np.linalg.norm(slides) + np.linalg.norm(after - before)
        assert slip @ left >= -1e-12 * scale**2, "friction turns it"
        assert np.linalg.norm(left) <= np.linalg.norm(slip) + 1e-12 * scale
        stuck += m.friction > 0 and slip.any() and np.linalg.norm(left) < 1e-9 * scale
        slid += np.linalg.norm(left) > 1e-9 * scale and bool(np.linalg.norm(rub) > 0)
        deep = min(-m.distance_a - m.distance_b - LAYER_OFFSET, LAYER_MAX_OVERLAP)
        assert -(after @ n) <= max(-(before @ n), 0) + 0.5 * deep * dx / dt * (1 + 1e-9)
        full = (
            LAYER_STIFFNESS
            * dt
            * m.stiff
            * m.share
            * deep
            * (1 - abs(m.distance_a - m.distance_b) / 2)
            * dx**2
        )
        assert push <= full * (1 + 1e-9)
        held += push < 0.99 * full
        a = None if m.a < 0 else m.a
        gap, lean = m.distance_a + m.distance_b + LAYER_OFFSET, m.distance_a - m.distance_b
        twin = plain._push(before, slides, mass, a, m.b, n, gap, lean, m.stiff * m.share,
                           m.friction, dt, dx)  # fmt: skip
        assert impulse == pytest.approx(twin, rel=1e-9, abs=1e-12 * size)
    assert min(stuck, slid, held, acted - held) > 20, (acted, stuck, slid, held)


def test_a_layer_gives_back_what_it_takes():
    """Two bodies run into each other and part at the speeds of an elastic collision."""
    dx, n, mass = 0.02, np.array([0.0, 0.6, 0.8]), np.array([0.01, 0.03])
    v = np.array([0.4 * n + [1.0, 0, 0], -0.1 * n])
    start, gap, dt, deepest, steps = v.copy(), 0.01, 1e-6, 0.0, 0
    while gap <= 0.01:
        v += pushed(v, mass, meeting(gap / 2, gap / 2, stiff=1e6), n, dt, dx)
        gap += dt * (v[1] - v[0]) @ n / dx
        deepest, steps = min(deepest, gap), steps + 1
    assert -LAYER_MAX_OVERLAP < deepest < -0.01, "it uses no more of the layer than that has"
    assert steps > 100
    mean = (mass[:, None] * start).sum(0) / mass.sum()
    along = 2 * ((mean - start) @ n)[:, None] * n
    assert v == pytest.approx(start + along, abs=1e-3)
    assert v[:, 0] == pytest.approx([1.0, 0.0], abs=1e-12), "nothing rubs"


def test_no_layer_far_from_the_middle():
    """A node a cell and more from the middle between two surfaces pushes nothing, at it most."""
    v, mass, n = np.zeros((2, 3)), np.ones(2), np.array([0.0, 0.0, 1.0])
    push = [
        pushed(v, mass, meeting(-0.05 + s, -0.05 - s), n, 1e-4, 0.02)[1, 2]
        for s in (0.0, 0.25, 0.5, 0.75, 1.0, 1.2)
    ]
    assert push == pytest.approx(push[0] * np.array([1, 0.75, 0.5, 0.25, 0, 0]))
    assert push[0] > 0
