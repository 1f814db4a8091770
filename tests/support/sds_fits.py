"""What the tests of a video model's taste share: fit files with [sds], runs that are pictures of a
formula, and a model that knows the answer."""

from pathlib import Path

import numpy as np

from vgmpi.tools.fit.run_pool import CompletedRun
from vgmpi.tools.fit.video_prior.model_base import VideoModel
from vgmpi.tools.fit.video_prior.score_distillation import Level

KEYS = ("material.rubber.youngs_modulus", "material.rubber.density")
PARAMETERS = """
[[parameter]]
key = "material.rubber.youngs_modulus"
range = ["4 kPa", "400 kPa"]
initial = "200 kPa"
"""
SECOND = """
[[parameter]]
key = "material.rubber.density"
range = [200, 5000]
"""
PROMPT = 'prompt = "a soft ball bounces"'
RENDER = """
[camera]
kind = "fixed"
eye = [0.05, -0.5, 0.1]
target = [0.05, 0.05, 0.1]
fov = 24
[picture]
width = {size}
height = {size}
background = "#808080"
"""


def sds(model="model", wish=PROMPT, more="", method="", parameters=PARAMETERS):
    """The text of a fit file."""
    head = f'[sds]\nmodel = "{model}"\nrender = "render.toml"\n'
    return f"{parameters}{head}{wish}\n{more}\n[method]\n{method}\n"


def rendered(folder: Path, size: int) -> None:
    """A render.toml of square pictures."""
    (folder / "render.toml").write_text(RENDER.format(size=size))


class Formula:
    """In place of runs: each is a folder, and its picture is worked out from its parameters."""

    def __init__(self, folder: Path):
        self.folder, self.jobs, self.calls = folder, 1, []

    def all(self, settings):
        found = []
        for one in settings:
            self.calls.append(one)
            folder = self.folder / "_".join(v for _, v in one.knobs)
            folder.mkdir(parents=True, exist_ok=True)
            (folder / "values.txt").write_text(" ".join(v for _, v in one.knobs))
            found.append(CompletedRun(folder, 0.0, True))
        return found


def blob(values, count: int, size: int):
    """A video (count, size, size, 3) of 0..1, a tensor: a blob that is as bright as the first of
    the values says, and as fast as the second."""
    import torch

    at = (torch.arange(size, dtype=torch.float64) + 0.5) / size
    y, x = torch.meshgrid(at, at, indexing="ij")
    bright = 0.5 + 0.15 * torch.log(values[0] / 4e4)
    speed = 0.15 * (values[1] / 1000) ** 0.5
    frames = [
        bright * torch.exp(-((x - 0.25 - speed * k / count) ** 2 + (y - 0.5) ** 2) / 0.03)
        for k in range(count)
    ]
    tint = torch.tensor([1.0, 0.8, 0.6], dtype=torch.float64)
    return torch.stack(frames)[..., None] * tint


class Shown:
    """In place of the renderer, for runs of a Formula."""

    def __init__(self, count: int, size: int):
        self.count, self.size = count, size

    def render_run(self, folder: Path, frames) -> np.ndarray:
        import torch

        words = (folder / "values.txt").read_text().split()
        values = torch.tensor([float(w) for w in words], dtype=torch.float64)
        return blob(values, self.count, self.size).numpy()


class Knows(VideoModel):
    """A model that knows a set of videos and no others: its guess is the exact mean of what they
    may have been, x0_hat = sum_i softmax_i(-|z_t - a z_i|^2 / 2 s^2) z_i. Its code is the picture.

    sets: codes (videos, numbers) that it knows without and with the prompt.
    """

    def __init__(self, sets):
        self.conditions, self.device, self.calls = sets, "cpu", 0

    def level(self, share: float) -> Level:
        return Level(1 - share, share, share)

    def encode(self, film):
        import torch

        return torch.nn.functional.avg_pool3d(film, (1, 2, 2))

    def predict(self, z_t, level: Level, condition):
        import torch

        self.calls += 1
        flat = z_t.reshape(1, -1).double()
        far = ((flat - level.signal * condition) ** 2).sum(1)
        shares = torch.softmax(-far / (2 * level.noise**2), 0)
        clean = (shares[:, None] * condition).sum(0)
        return ((flat[0] - level.signal * clean) / level.noise).reshape(z_t.shape).to(z_t.dtype)
