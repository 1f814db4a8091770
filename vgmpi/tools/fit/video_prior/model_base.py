"""Base class of the video models.

A new kind is a file in kinds/ with a subclass; nothing else names it.
"""

import importlib
import pkgutil
from pathlib import Path
from typing import Any

from . import models
from .model_folder import Folder, ModelError, Part
from .score_distillation import Level
from .sds_config import Sds

FLOAT_BYTES = 4  # [bytes] size of a float32
BYTES_BY_PRECISION = {"float32": 4, "bfloat16": 2, "float16": 2}


class VideoModel:
    """A kind of video model.

    A film is (1, 3, frames, height, width) in [-1, 1], a latent (1, channels, frames, height,
    width). conditions: what the prediction depends on, without and with the prompt.
    """

    part = "unet"
    """name of the component that predicts noise"""
    denoiser = ""
    """class of that component; it identifies the kind of a model folder"""
    coders: tuple[str, ...] = ()
    """accepted classes of the component that encodes pictures"""
    by = "prompt"
    """condition of the model: prompt or image"""
    default_guidance = 7.5
    """default guidance scale"""

    conditions: tuple[Any, Any]

    def __init__(self, folder: Folder, options: Sds):
        """Inspect the folder without loading weights. Raises ModelError."""
        self.folder, self.options = folder, options
        self.denoises = folder.part(self.part, (self.denoiser,))
        self.codes = folder.part("vae", self.coders)
        self.reads = self.reader()
        self.model: Any = None
        self.vae: Any = None

    def reader(self) -> Part:
        """Return the component that reads the prompt. Raises ModelError."""
        raise NotImplementedError

    def step(self) -> int:
        """Return the number of pixels of which width and height must be multiples."""
        raise NotImplementedError

    def wrong_count(self, count: int) -> str:
        """Return why so many frames cannot be processed, or ''."""
        return ""

    def activation_bytes(self, count: int, width: int, height: int) -> float:
        """Estimate the memory of activations [bytes].

        Args:
            count: Number of frames.
            width: Width of the frames [pixels].
            height: Height of the frames [pixels].
        """
        raise NotImplementedError

    def required_bytes(self, count: int, width: int, height: int) -> float:
        """Estimate the peak memory [bytes].

        The component that reads the prompt is released before the one that predicts noise is
        loaded.

        Args:
            count: Number of frames.
            width: Width of the frames [pixels].
            height: Height of the frames [pixels].
        """
        bytes_per_weight, activations = (
            BYTES_BY_PRECISION[self.options.precision],
            self.activation_bytes(count, width, height),
        )
        numbers = max(self.reads.numbers, self.denoises.numbers)
        return bytes_per_weight * numbers + FLOAT_BYTES * self.codes.numbers + activations

    def load(self, device: str, image: Any) -> None:
        """Load the weights and compute the conditions.

        Exceptions of diffusers and transformers pass through.

        Args:
            device: Device of the model.
            image: First picture, shape (1, 3, height, width) in [-1, 1], if the model depends on
                one.
        """
        import diffusers
        import torch

        self.device, self.dtype = device, getattr(torch, self.options.precision)
        self.vae = _load_part(
            getattr(diffusers, self.codes.kind), self.codes, torch.float32, device
        )
        self.conditions = self.read(image)
        self.model = _load_part(
            getattr(diffusers, self.denoises.kind), self.denoises, self.dtype, device
        )

    def load_reader(self) -> Any:
        """Load the component that reads the prompt."""
        import transformers

        reader_class = getattr(transformers, self.reads.kind)
        reader = reader_class.from_pretrained(
            self.reads.folder, dtype=self.dtype, local_files_only=True, use_safetensors=True,
            variant=self.reads.variant,
        )  # fmt: skip
        return reader.eval().requires_grad_(False).to(self.device)

    def read(self, image: Any) -> tuple[Any, Any]:
        """Return the conditions without and with the prompt."""
        raise NotImplementedError

    def level(self, share: float) -> Level:
        """Return the noise level for a share in [0, 1]."""
        raise NotImplementedError

    def encode(self, film: Any) -> Any:
        """Return the latent of a film, the mode of the encoder and hence deterministic."""
        raise NotImplementedError

    def predict(self, z_t: Any, level: Level, condition: Any) -> Any:
        """Return eps_hat, the noise predicted in a noised latent.

        Args:
            z_t: Noised latent.
            level: Its noise level.
            condition: Condition, one of `conditions`.
        """
        raise NotImplementedError


def _load_part(part_class: Any, part: Part, dtype: Any, device: str) -> Any:
    """Load a component for inference."""
    loaded = part_class.from_pretrained(
        part.folder, torch_dtype=dtype, local_files_only=True, use_safetensors=True,
        variant=part.variant,
    )  # fmt: skip
    return loaded.eval().requires_grad_(False).to(device)


def encode_by_picture(vae: Any, film: Any) -> Any:
    """Encode a film with an encoder of single pictures, one after the other."""
    import torch

    codes = [vae.encode(film[:, :, k]).latent_dist.mode() for k in range(film.shape[2])]
    return torch.stack(codes, dim=2) * vae.config.scaling_factor


def latent_downsampling(part: Part) -> int:
    """Return the pixels per latent entry along an edge, for an encoder of single pictures."""
    return 2 ** (len(part.config.get("block_out_channels", [0])) - 1)


def registered_models() -> dict[str, type[VideoModel]]:
    """Return all kinds by the class of the component that predicts noise."""
    for module in pkgutil.iter_modules([str(Path(list(models.__path__)[0]))]):
        importlib.import_module(f"{models.__name__}.{module.name}")
    return {kind.denoiser: kind for kind in VideoModel.__subclasses__() if kind.denoiser}


def kind_of(path: Path, options: Sds) -> VideoModel:
    """Return the model in a folder without loading it. Raises ModelError."""
    folder, registered = Folder(path), registered_models()
    for name in {kind.part for kind in registered.values()}:
        if folder.parts.get(name) in registered:
            return registered[folder.parts[name]](folder, options)
    parts = ", ".join(folder.parts.values()) or "nothing"
    raise ModelError(
        f"is of no kind that is known ({', '.join(sorted(registered))}): it has {parts}"
    )
