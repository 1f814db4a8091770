"""The studio's light: shadows, ambient light, energy and tone, against geometry and formulas.

Theory: the share of the sky that walls leave of a hemisphere, weighted by the cosine, by counting
rays; the shadow of a ball of radius r under a light at elevation e is an ellipse of half axes r and
r / sin(e); a white body in an even sky of 1 shines with 1.
"""

import numpy as np
import pytest

from tests.render import stages
from vgmpi.studio import deferred, ground, tone

H, THICK = 0.0125, 0.1  # m: of walls in a box of 1 m


def block(low, high):
    """Particles that fill a box."""
    low = np.array(low)
    return stages.grid_points(np.round((high - low) / H).astype(int), H, low)


FLOOR = block((0, 0, 0), (1, 1, THICK))
WALLS = [block((0, 0, THICK), (THICK, 1, 1)), block((THICK, 0, THICK), (1, THICK, 1))]


def open_share(distance, walls, rays=200):
    """Cosine-weighted share of the sky at a point of the floor so far from each of the walls, which
    are as high as the box: by counting rays."""
    r = np.sqrt((np.arange(rays) + 0.5) / rays)
    angle = 2 * np.pi * (np.arange(4 * rays) + 0.5) / (4 * rays)
    r, angle = np.meshgrid(r, angle, indexing="ij")
    d = np.stack([r * np.cos(angle), r * np.sin(angle), np.sqrt(1 - r * r)], axis=-1)
    p = np.array([distance, distance if walls == 2 else 0.5 - THICK, 0.0])
    hidden = np.zeros(r.shape, bool)
    for a in range(walls):
        towards = d[..., a] < -1e-9
        t = np.where(towards, -p[a] / np.where(towards, d[..., a], 1.0), 0.0)
        beside = p[1 - a] + t * d[..., 1 - a]
        within = (beside > -THICK) & (beside < 1 - THICK) & (t * d[..., 2] < 1 - THICK)
        hidden |= towards & within
    return 1 - hidden.mean()


def lit(stage, p, n):
    """Ambient light and what is open at a point."""
    key, sky, work = np.empty(3), np.empty(3), np.empty(11)
    p, n = np.array(p, dtype=float), np.array(n, dtype=float)
    return deferred.light_at(stage, p, n, 0.0, False, key, sky, work), sky, key


@pytest.fixture(scope="module")
def drop():
    """A medium far away from everything."""
    return stages.water(stages.grid_points((6, 6, 6), 0.01) + 5, 0.01, (5, 5, 5, 6, 6, 6))


def even_stage(drop, x, volume, cells):
    """Things in a sky of 1 from everywhere."""
    rig = stages.dark_rig(horizon=1.0, zenith=1.0, bounce=1.0)
    shadows = stages.pyramid(x, volume, cells=cells, albedo=0.0)
    return stages.stage_of(drop, stages.oblique(45, (0.5, 0.5, 0.5)), rig, shadows=shadows)


@pytest.mark.parametrize("cells", [100, 150])
@pytest.mark.parametrize("walls", [1, 2])
def test_ambient_light_in_a_corner(drop, walls, cells):
    stage = even_stage(drop, np.concatenate([FLOOR, *WALLS[:walls]]), H**3, cells)
    for distance in (0.1, 0.15, 0.2, 0.3, 0.4, 0.55, 0.7):
        p = (THICK + distance, THICK + distance if walls == 2 else 0.5, THICK)
        free, sky, _ = lit(stage, p, (0, 0, 1))
        assert free == pytest.approx(open_share(distance, walls), rel=0.10), distance
        np.testing.assert_allclose(sky, free, rtol=1e-6)
