"""Pictures of a thing from all around, with cameras that are known."""

import json
from typing import NamedTuple

import numpy as np
from PIL import Image

from tests.support.drawn_photograph import drawing
from vgmpi.gaussians.camera import Camera, look_at
from vgmpi.tools.photo import visual_hull

TOY = [
    drawing.Can((0.0, 0.0, 0.0), 0.045, 0.07, (0.16, 0.34, 0.62), (0.30, 0.42, 0.70)),
    drawing.Ball((0.0, 0.0, 0.09), 0.040, (0.85, 0.55, 0.15)),
]
DOME = [  # without a neck, into which no outline looks
    drawing.Can((0.0, 0.0, 0.0), 0.045, 0.07, (0.16, 0.34, 0.62), (0.30, 0.42, 0.70)),
    drawing.Ball((0.0, 0.0, 0.07), 0.045, (0.85, 0.55, 0.15)),
]
MIDDLE, FAR, SIDE = np.array([0.0, 0.0, 0.06]), 0.5, 280
RINGS = ((12, 7, 0.0), (50, 4, 0.4), (88, 1, 0.0))  # elevation [deg], how many, the first [rad]


class Around(NamedTuple):
    """A camera that `draw` takes in place of a view."""

    camera: Camera

    @property
    def width(self):
        return self.camera.width

    @property
    def height(self):
        return self.camera.height

    def rays(self, at):
        c = self.camera
        flat = (np.asarray(at) - (c.cx, c.cy)) / (c.fx, c.fy)
        ahead = np.concatenate([flat, np.ones((*flat.shape[:-1], 1))], -1)
        return ahead @ c.world_to_camera[:3, :3]


def camera(elevation, azimuth):
    """Degrees and radians."""
    up = np.radians(elevation)
    way = np.array([np.cos(up) * np.sin(azimuth), -np.cos(up) * np.cos(azimuth), np.sin(up)])
    return look_at(MIDDLE + FAR * way, MIDDLE, np.array([0.0, 0.0, 1.0]), 22, SIDE, SIDE)


def shot(one, things=TOY):
    """What a camera sees of the toy."""
    drawn = drawing.draw(things, Around(one), one.eye)
    return visual_hull.Shot(one, drawn.rgb, np.logical_or.reduce(drawn.masks))


def cameras():
    return [
        camera(up, first + 2 * np.pi * k / count)
        for up, count, first in RINGS
        for k in range(count)
    ]


def inside(x, things=TOY):
    """Whether places (n, 3) are the toy's."""
    can, ball = things
    off = x - can.base
    held = (off[:, :2] ** 2).sum(1) < can.radius**2
    held &= (off[:, 2] > 0) & (off[:, 2] < can.height)
    return held | (((x - ball.middle) ** 2).sum(1) < ball.radius**2)


def put(folder, shots):
    """Pictures with alpha and their transforms.json; returns its path."""
    folder.mkdir(parents=True, exist_ok=True)
    frames = []
    for k, one in enumerate(shots):
        alpha = np.where(one.mask, 255, 0).astype(np.uint8)
        Image.fromarray(np.dstack([one.rgb, alpha])).save(folder / f"shot_{k}.png")
        pose = np.linalg.inv(one.camera.world_to_camera)
        pose[:3, 1:3] *= -1  # OpenGL
        frames.append({"file_path": f"shot_{k}.png", "transform_matrix": pose.tolist()})
    c = shots[0].camera
    told = {"fl_x": c.fx, "fl_y": c.fy, "cx": c.cx, "cy": c.cy, "w": c.width, "h": c.height}
    (folder / "transforms.json").write_text(json.dumps(told | {"frames": frames}))
    return folder / "transforms.json"
