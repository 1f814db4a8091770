"""Score distillation (Poole et al. 2023, DreamFusion, eq. 3) for a model that only runs forward.

A video's latent z is noised, z_t = a z + s eps, and the model predicts the noise. The gradient with
respect to z is w (eps_hat - eps); as in the paper, the derivative of the model is left out.
Differences of latents between runs carry it on to the parameters of a scene.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Level:
    """Noise level: z_t = signal z + noise eps.

    time: time step that the model is given.
    """

    signal: float
    noise: float
    time: float

    @property
    def weight(self) -> float:
        """Weight w, the share of the noise in the variance.

        It is DreamFusion's sigma^2 for a model that preserves the variance.
        """
        return self.noise**2 / (self.signal**2 + self.noise**2)


@dataclass(frozen=True)
class NoiseSample:
    """A noise level, and noise eps of the shape of a latent."""

    level: Level
    eps: Any


def stratified_levels(times: tuple[float, float], draws: int) -> list[float]:
    """Return the noise levels of the draws: centers of equal parts of the range."""
    low, high = times
    return [low + (high - low) * (k + 0.5) / draws for k in range(draws)]


def draw(
    level: Level, shape: tuple[int, ...], seed: int, number: int, device: Any = "cpu"
) -> NoiseSample:
    """Return the noise sample of a number, with the same bits at every call.

    Args:
        level: Noise level.
        shape: Shape of the latent.
        seed: Random seed.
        number: Number of the sample.
        device: Device of the result; the noise is drawn on the CPU.
    """
    import torch

    generator = torch.Generator().manual_seed((seed << 16) + number)
    return NoiseSample(
        level, torch.randn(shape, generator=generator, dtype=torch.float32).to(device)
    )


def noised(z: Any, sample: NoiseSample) -> Any:
    """Return the noised latent z_t."""
    return sample.level.signal * z + sample.level.noise * sample.eps


def denoising_loss(model: Any, z: Any, sample: NoiseSample) -> float:
    """Return the denoising loss with the prompt and without guidance.

    It is the mean square of eps_hat - eps, the training loss of the model, which bounds the
    likelihood of a video (Ho et al. 2020, eq. 14).
    """
    return _mean_square_error(
        model.predict(noised(z, sample), sample.level, model.conditions[1]), sample
    )


def sds_gradient(model: Any, z: Any, sample: NoiseSample, guidance: float) -> tuple[Any, float]:
    """Return the score distillation gradient and the denoising loss.

    The prediction is eps_hat = u + guidance (c - u), with u predicted without the prompt and c with
    it (Ho and Salimans 2022).

    Args:
        model: The video model.
        z: Latent.
        sample: Noise.
        guidance: Guidance scale.

    Returns:
        w (eps_hat - eps), of the shape of z, and the loss of `denoising_loss`.
    """
    z_t = noised(z, sample)
    without, with_ = (model.predict(z_t, sample.level, c) for c in model.conditions)
    guided = without + guidance * (with_ - without)
    return sample.level.weight * (guided - sample.eps), _mean_square_error(with_, sample)


def _mean_square_error(guess: Any, sample: NoiseSample) -> float:
    """Return the mean square error of a noise prediction."""
    return float(((guess - sample.eps).double() ** 2).mean())


def directional_derivative(
    gradient: np.ndarray, upper: np.ndarray, lower: np.ndarray, width: float
) -> float:
    """Return the derivative along a parameter per latent entry.

    Args:
        gradient: Gradient with regard to the latent, averaged over the draws, shape (n,).
        upper: Latent of the run at the upper point, shape (n,).
        lower: Latent of the run at the lower point, shape (n,).
        width: Distance of the two points in the parameter.
    """
    change = (np.asarray(upper, float) - np.asarray(lower, float)) / width
    return float(np.mean(np.asarray(gradient, float) * change))
