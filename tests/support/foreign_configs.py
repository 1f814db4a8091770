"""Configurations of other programs, and the scenes that become of them."""

import json

import numpy as np

from vgmpi.commands.cli import main as vgmpi
from vgmpi.gaussians.cloud import GaussianCloud
from vgmpi.gaussians.formats import registry
from vgmpi.scene.loader import load
from vgmpi.tools.convert.scene_converter import convert_scene

CELL = 2 / 20  # of ONE
ONE = {
    "material": "jelly",
    "E": 3e4,
    "nu": 0.35,
    "density": 120,
    "g": [0, 0, -4.0],
    "n_grid": 20,
    "frame_dt": 2e-2,
    "frame_num": 30,
    "substep_dt": 1e-4,
    "opacity_threshold": 0.02,
}
LONG = {"start_time": 0, "end_time": 1e3}
BOX = {"type": "bounding_box"}
HOLD = {
    "type": "enforce_particle_translation", "point": [1, 1, 1], "size": [0.9, 0.9, 0.9],
    "velocity": [0, 0, 0], "start_time": 0, "end_time": 0.2,
}  # fmt: skip
TURN = {
    "type": "enforce_particle_velocity_rotation", "point": [1, 1, 1.1], "normal": [0, 0, 2],
    "half_height_and_radius": [0.9, 0.9], "rotation_scale": 1.5, "translation_scale": 0.2,
    "start_time": 0, "end_time": 0.3,
}  # fmt: skip


def several(*bodies, **more):
    """A configuration of VersaGauss; bodies: (material, how it stands)."""
    stands = [{"model_path": f"none/{chr(97 + k)}.ply"} | s for k, (_, s) in enumerate(bodies)]
    return {
        "object_num": len(bodies), "n_grid": 40, "grid_lim": 4, "frame_dt": 0.04, "frame_num": 5,
        "material_params": [material for material, _ in bodies], "preprocess_params": stands,
    } | more  # fmt: skip


def scene_of(folder, config, *gaussians):
    """(scene as read, lines) of a configuration; --check takes the scene, which ends with them."""
    path, scene = folder / "config.json", folder / "scene.toml"
    path.write_text(json.dumps(config))
    text, lines = convert_scene(path, list(gaussians), folder)
    scene.write_text(text)
    for line in lines:
        assert line.startswith(f"{path}: ") and "\n" not in line
        assert f"# {line.removeprefix(f'{path}: ')}\n" in text
    assert vgmpi([str(scene), "--check", "-q"]) == 0
    return load(scene), [line.removeprefix(f"{path}: ") for line in lines]


def egg(folder):
    """A file with 900 Gaussians on an egg, a tenth of them too faint to count."""
    rng = np.random.default_rng(3)
    x = rng.normal(size=(900, 3))
    x *= np.array([0.5, 0.4, 1.2]) / np.linalg.norm(x, axis=1)[:, None]
    opacity = np.where(np.arange(900) % 10 == 0, 0.01, 0.9)
    quat, size = np.tile([1.0, 0, 0, 0], (900, 1)), np.full((900, 3), 0.05)
    cloud = GaussianCloud(x + [3, 1, -2], quat, size, opacity, np.zeros((900, 1, 3)))
    registry.write(folder / "egg.ply", cloud)
    return folder / "egg.ply"


def named(lines, key):
    """The lines about a key."""
    return [line for line in lines if line.startswith(f"{key}:")]
