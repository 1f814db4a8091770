"""Score distillation (Poole et al. 2023, DreamFusion, eq. 3), for a model that only runs forwards.

A code z of a video is noised, z_t = a z + s eps, and the model guesses that noise. The gradient of
what it makes of the video is w (eps_hat - eps) with regard to z, the model's own derivative left
out as there; differences of codes between runs carry it on to a scene's parameters.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Level:
    """Of noise: z_t = signal z + noise eps. time: what the model is told of it."""

    signal: float
    noise: float
    time: float

    @property
    def weight(self) -> float:
        """w: the share of the noise in the variance, DreamFusion's sigma^2 of a model that keeps
        the variance."""
        return self.noise**2 / (self.signal**2 + self.noise**2)


@dataclass(frozen=True)
class Draw:
    """A level, and noise eps of the shape of a code."""

    level: Level
    eps: Any


def shares(times: tuple[float, float], draws: int) -> list[float]:
    """Levels of noise of so many draws: the middles of equal parts of the range."""
    low, high = times
    return [low + (high - low) * (k + 0.5) / draws for k in range(draws)]


def draw(level: Level, shape: tuple[int, ...], seed: int, number: int, device: Any = "cpu") -> Draw:
    """The draw of that number: of the same bits whenever it is asked for, made on the processor."""
    import torch

    chance = torch.Generator().manual_seed((seed << 16) + number)
    return Draw(level, torch.randn(shape, generator=chance, dtype=torch.float32).to(device))


def noised(z: Any, one: Draw) -> Any:
    """z_t."""
    return one.level.signal * z + one.level.noise * one.eps


def off(kind: Any, z: Any, one: Draw) -> float:
    """The mean square of eps_hat - eps with the prompt and without guidance: the loss that the
    model was taught by, which bounds how likely a video is (Ho et al. 2020, eq. 14)."""
    return _square(kind.guess(noised(z, one), one.level, kind.conditions[1]), one)


def pull(kind: Any, z: Any, one: Draw, guidance: float) -> tuple[Any, float]:
    """w (eps_hat - eps), of the shape of z, and `off`. eps_hat = u + guidance (c - u): u is guessed
    without the prompt, c with it (Ho and Salimans 2022)."""
    z_t = noised(z, one)
    without, with_ = (kind.guess(z_t, one.level, c) for c in kind.conditions)
    guided = without + guidance * (with_ - without)
    return one.level.weight * (guided - one.eps), _square(with_, one)


def _square(guess: Any, one: Draw) -> float:
    return float(((guess - one.eps).double() ** 2).mean())


def slope(pulled: np.ndarray, ahead: np.ndarray, behind: np.ndarray, width: float) -> float:
    """The gradient along a parameter, per number of a code: of pulls (n,) averaged over the draws,
    and codes (n,) of runs that lie `width` apart in it."""
    change = (np.asarray(ahead, float) - np.asarray(behind, float)) / width
    return float(np.mean(np.asarray(pulled, float) * change))
