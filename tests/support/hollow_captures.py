"""Bodies with gaps as captures have them: flat Gaussians where a camera saw them, with noise.

A chair, a mug and a figure, each about 30 cm high, made of shapes whose inside is known. Nothing
was seen from below: their undersides have no Gaussians.
"""

from dataclasses import dataclass

import numpy as np

from vgmpi.gaussians import shape_distance
from vgmpi.gaussians.cloud import GaussianCloud
from vgmpi.gaussians.spherical_harmonics import dc_from_rgb
from vgmpi.preprocess import shape_sdf
from vgmpi.preprocess.meshes.surface_mesh import poisson_disc_subset, quaternion_to_normal
from vgmpi.scene.shapes import Shape

UNSEEN = -0.6  # a surface whose normal points further down than this was not captured
WOOD, CLAY, SKIN, BLUE, GREY = "#b5793f", "#3f7fb5", "#d8a98a", "#2d4f8f", "#5a5f66"


def _chair() -> dict:
    legs = [(-0.07, -0.07), (0.07, -0.07), (-0.07, 0.07), (0.07, 0.07)]
    posts = [{"box": [[x - 0.012, y - 0.012, 0], [x + 0.012, y + 0.012, 0.15]]} for x, y in legs]
    seat = {"box": [[-0.09, -0.09, 0.14], [0.09, 0.09, 0.165]], "color": CLAY}
    back = [
        {"box": [[-0.085, y - 0.014, 0.15], [-0.06, y + 0.014, 0.3]]} for y in (-0.065, 0, 0.065)
    ]
    rail = {"box": [[-0.088, -0.09, 0.27], [-0.057, 0.09, 0.3]]}
    return {"union": [seat, rail, *posts, *back], "color": WOOD}


def _mug() -> dict:
    outer = {"cylinder": {"endpoints": [[0, 0, 0], [0, 0, 0.26]], "radius": 0.1}}
    room = {"cylinder": {"endpoints": [[0, 0, 0.03], [0, 0, 0.3]], "radius": 0.075}}
    handle = {
        "torus": {
            "center": [0.1, 0, 0.13],
            "axis": "y",
            "major_radius": 0.07,
            "minor_radius": 0.017,
        },
        "color": WOOD,
    }
    cut = [{"union": [outer, handle]}, room]
    return {"difference": cut, "color": CLAY}


def _figure() -> dict:
    def limb(a: tuple, b: tuple, radius: float, color: str) -> dict:
        return {"capsule": {"endpoints": [a, b], "radius": radius}, "color": color}

    parts = [
        limb((0, 0, 0.16), (0, 0, 0.2), 0.038, CLAY),
        {"sphere": {"center": [0, 0, 0.27], "radius": 0.032}, "color": SKIN},
        limb((0, 0, 0.22), (0, 0, 0.25), 0.016, SKIN),
    ]
    for side in (-1, 1):
        parts.append(limb((0, 0.022 * side, 0.13), (0, 0.035 * side, 0.005), 0.02, BLUE))
        parts.append(limb((0, 0.045 * side, 0.215), (0.01, 0.075 * side, 0.12), 0.014, SKIN))
    floor = {"box": [[-1, -1, -1], [1, 1, 0]]}
    return {"difference": [{"union": parts}, floor], "color": GREY}


FORMS = {"chair": _chair, "mug": _mug, "figure": _figure}


@dataclass(frozen=True)
class Body:
    """A capture, and which points (n, 3) [m] are inside what was captured."""

    cloud: GaussianCloud
    shape: Shape

    def solid(self, x: np.ndarray) -> np.ndarray:
        return shape_distance.distance(self.shape, x) < 0

    def volume(self, edge: float = 0.002) -> float:
        """Of what was captured [m3], counted on a lattice of cells with this edge [m]."""
        ends = zip(*_box(self.shape), strict=True)
        axes = [np.arange(low + edge / 2, high, edge) for low, high in ends]
        x = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        return float(self.solid(x).sum()) * edge**3


def body(name: str, count: int = 20_000, seed: int = 1) -> Body:
    """About `count` Gaussians on one of FORMS."""
    shape = Shape.model_validate(FORMS[name]())
    random = np.random.default_rng(seed)
    x = _on_surface(shape, 4 * count, random)
    apart = np.sqrt(_area(shape, x) / count)
    x = x[poisson_disc_subset(x, 0.85 * apart)]
    normal = shape_distance.normals(shape, x, 1e-4)
    x, normal = x[normal[:, 2] > UNSEEN], normal[normal[:, 2] > UNSEEN]
    n = len(x)
    rgb = shape_sdf.colors(shape, x, (0.5, 0.5, 0.5)) * (0.65 + 0.35 * normal[:, 2:])
    rgb *= random.uniform(0.9, 1.1, (n, 1))
    tilted = normal + random.normal(0, 0.15, (n, 3))
    tilted /= np.linalg.norm(tilted, axis=1, keepdims=True)
    disc = apart * np.exp(random.normal(np.log(0.7), 0.2, n))
    thin = np.where(random.random(n) < 0.1, 1.0, 0.1)  # a tenth are balls
    return Body(
        GaussianCloud(
            x + random.normal(0, 0.1 * apart, (n, 3)),
            quaternion_to_normal(tilted),
            np.stack([disc, disc, thin * disc], axis=1),
            random.uniform(0.7, 0.99, n),
            dc_from_rgb(np.clip(rgb, 0, 1))[:, None, :].astype(np.float32),
        ),
        shape,
    )


def _box(shape: Shape) -> tuple[np.ndarray, np.ndarray]:
    axes = np.eye(3)
    high = np.array([shape_sdf.support(shape, d) for d in axes])
    return -np.array([shape_sdf.support(shape, -d) for d in axes]), high


def _on_surface(shape: Shape, count: int, random: np.random.Generator) -> np.ndarray:
    """Points at random on the surface, evenly up to edges: of a thin layer, moved on to it."""
    low, high = _box(shape)
    layer = 0.01 * float((high - low).max())
    found, total = [], 0
    while total < count:
        x = random.uniform(low - layer, high + layer, (200_000, 3))
        x = x[np.abs(shape_distance.distance(shape, x)) < layer]
        for _ in range(2):
            x = x - shape_distance.distance(shape, x)[:, None] * shape_distance.normals(
                shape, x, 1e-5
            )
        x = x[np.abs(shape_distance.distance(shape, x)) < 1e-4]
        found.append(x)
        total += len(x)
    return np.concatenate(found)[:count]


def _area(shape: Shape, x: np.ndarray) -> float:
    """Of the surface [m2]: how many cells of a fine lattice its points (n, 3) meet, about."""
    low, high = _box(shape)
    layer = 0.003
    points = np.random.default_rng(0).uniform(low - layer, high + layer, (400_000, 3))
    share = (np.abs(shape_distance.distance(shape, points)) < layer).mean()
    return float(share * np.prod(high - low + 2 * layer) / (2 * layer))
