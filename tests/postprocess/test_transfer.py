"""Color through the grid: the smoothing S and its exponential, beside a slow numpy twin."""

import numpy as np
import pytest
from scipy.linalg import expm

from tests.support.bsplines import quadratic_bspline
from vgmpi.gaussians.color_diffusion import MAX_RELAXATION, Transfer

DX = 0.05


def cloud(n=80, m=3, seed=0):
    rng = np.random.default_rng(seed)
    x = rng.uniform(-0.1, 0.3, (n, 3))  # some beyond a wall
    return x, rng.uniform(0.2, 2.0, n) * 1e-6, rng.uniform(-2, 2, (n, m))


def weights(x, dx):
    """Dense (particles, nodes)."""
    nodes = {}
    rows = []
    for p in x / dx:
        low = np.floor(p).astype(int) - 1
        row = {}
        for step in np.ndindex(4, 4, 4):
            node = tuple(low + step)
            w = np.prod(quadratic_bspline(p - node))
            if w > 0:
                row[nodes.setdefault(node, len(nodes))] = w
        rows.append(row)
    out = np.zeros((len(x), len(nodes)))
    for k, row in enumerate(rows):
        out[k, list(row)] = list(row.values())
    return out


def dense(x, volume, dx):
    """S as a matrix."""
    w = weights(x, dx)
    mass = w.T @ volume
    return w @ ((w * volume[:, None]).T / mass[:, None])


def test_the_transfer_is_that_of_a_slow_twin():
    x, volume, c = cloud()
    got = Transfer(x, volume, DX).smoothed(c)
    np.testing.assert_allclose(got, dense(x, volume, DX) @ c, rtol=0, atol=1e-13)


@pytest.mark.parametrize("age", [0.0, 0.01, 0.8, 7.0, MAX_RELAXATION])
def test_relaxation_is_the_exponential(age):
    x, volume, c = cloud()
    got = Transfer(x, volume, DX).relax(c, age)
    want = expm(age * (dense(x, volume, DX) - np.eye(len(x)))) @ c
    np.testing.assert_allclose(got, want, rtol=0, atol=1e-6)


def test_relaxation_does_not_see_how_a_time_is_cut_into_frames():
    transfer, c = Transfer(*cloud()[:2], DX), cloud()[2]
    halves = transfer.relax(transfer.relax(c, 0.4), 0.4)
    np.testing.assert_allclose(halves, transfer.relax(c, 0.8), rtol=0, atol=1e-6)


@pytest.mark.parametrize("m", [3, 12, 27, 48])
def test_the_sum_of_volume_times_color_is_kept(m):
    """To rounding: a relative 1e-14 of the sum of absolute values."""
    x, volume, c = cloud(20_000, m)
    transfer = Transfer(x, volume, DX)
    total = volume @ c
    for new in (transfer.smoothed(c), transfer.relax(c, 0.8), transfer.relax(c, 20.0)):
        assert (np.abs(volume @ new - total) <= 1e-14 * (volume @ np.abs(c))).all()
        assert np.abs(new - c).max() > 0.1


def test_constant_colors_stay_to_a_few_ulp():
    x, volume, _ = cloud(20_000)
    for value in (0.3, -1.7, 1e-3):
        c = np.full((len(x), 3), value)
        transfer = Transfer(x, volume, DX)
        for new in (transfer.smoothed(c), transfer.relax(c, 0.8), transfer.relax(c, 50.0)):
            assert (np.abs(new - c) <= 4 * np.spacing(np.abs(c))).all()


def test_two_bodies_apart_keep_their_colors_to_a_few_ulp():
    x, volume, _ = cloud(2000)
    x[1000:] += 1.0
    c = np.repeat([[0.3], [-1.7]], 1000, axis=0)
    new = Transfer(x, volume, DX).relax(c, 0.8)
    assert (np.abs(new - c) <= 8 * np.spacing(np.abs(c).max())).all()


def test_no_color_leaves_the_range_of_the_others():
    x, volume, c = cloud(2000)
    transfer = Transfer(x, volume, DX)
    for new in (transfer.smoothed(c), transfer.relax(c, 3.0)):
        assert new.min() >= c.min() - 1e-14 and new.max() <= c.max() + 1e-14


def test_colors_spread_by_a_quarter_of_a_squared_cell_per_time():
    """On an even lattice S adds dx2 / 2 to the variance along each axis: D = 0.25 dx2 per step if
    done every step, and 0.25 dx2 / T if relaxed."""
    axis = (np.arange(40) + 0.5) * DX / 2
    x = np.stack(np.meshgrid(axis, axis[:8], axis[:8], indexing="ij"), -1).reshape(-1, 3)
    c = x[:, :1] ** 2
    transfer = Transfer(x, np.full(len(x), (DX / 2) ** 3), DX)
    inside = np.abs(x[:, 0] - 0.5) < 0.2
    grown = (transfer.smoothed(c) - c)[inside] / DX**2
    np.testing.assert_allclose(grown, 2 * 0.25, rtol=1e-2)
    grown = (transfer.relax(c, 0.6) - c)[inside] / DX**2
    np.testing.assert_allclose(grown, 2 * 0.25 * 0.6, rtol=1e-2)


def test_particles_without_volume_take_what_is_there_and_give_nothing():
    x, volume, c = cloud()
    volume[:10] = 0
    x[0] += 5.0  # alone: it keeps its own
    new = Transfer(x, volume, DX).smoothed(c)
    np.testing.assert_allclose(new[0], c[0], atol=1e-14)
    with_others = Transfer(x[10:], volume[10:], DX).smoothed(c[10:])
    np.testing.assert_allclose(new[10:], with_others, atol=1e-14)
    assert np.isfinite(new).all()


def test_an_age_too_long_is_refused():
    x, volume, c = cloud(5)
    with pytest.raises(ValueError, match="age"):
        Transfer(x, volume, DX).relax(c, 2 * MAX_RELAXATION)


def test_no_particles():
    assert Transfer(np.empty((0, 3)), np.empty(0), DX).smoothed(np.empty((0, 3))).shape == (0, 3)
