"""What kinds of video models have in common. A new kind is a file in kinds/ with a class of its
own; nothing else names it."""

import importlib
import pkgutil
from pathlib import Path
from typing import Any

from . import kinds
from .distilled import Level
from .folder import Folder, ModelError, Part
from .settings import Sds

FLOAT = 4  # bytes
BYTES = {"float32": 4, "bfloat16": 2, "float16": 2}


class Kind:
    """A kind of model. A film is (1, 3, frames, height, width) of -1..1, a code (1, channels,
    frames, height, width). conditions: what the model goes by, without and with the prompt."""

    part = "unet"
    """the name of the part that guesses noise"""
    denoiser = ""
    """its class; the model's folder tells its kind by it"""
    coders: tuple[str, ...] = ()
    """classes of the part that codes pictures"""
    by = "prompt"
    """or "image": what it goes by"""
    usual = 7.5
    """its guidance"""

    conditions: tuple[Any, Any]

    def __init__(self, folder: Folder, asked: Sds):
        """Looks at its folder, and loads nothing. Raises ModelError."""
        self.folder, self.asked = folder, asked
        self.denoises = folder.part(self.part, (self.denoiser,))
        self.codes = folder.part("vae", self.coders)
        self.reads = self.reader()
        self.model: Any = None
        self.vae: Any = None

    def reader(self) -> Part:
        """The part that reads the prompt. Raises ModelError."""
        raise NotImplementedError

    def step(self) -> int:
        """Pixels of which width and height are multiples."""
        raise NotImplementedError

    def wrong_count(self, count: int) -> str:
        """Why so many frames cannot be shown; nothing where they can."""
        return ""

    def busy(self, count: int, width: int, height: int) -> float:
        """Bytes that it takes beside its weights, about, for so many frames."""
        raise NotImplementedError

    def needs(self, count: int, width: int, height: int) -> float:
        """Bytes that it takes at most, about: what reads the prompt is gone before what guesses
        noise is loaded."""
        each, busy = BYTES[self.asked.precision], self.busy(count, width, height)
        numbers = max(self.reads.numbers, self.denoises.numbers)
        return each * numbers + FLOAT * self.codes.numbers + busy

    def load(self, device: str, image: Any) -> None:
        """Weights and conditions. image: (1, 3, height, width) of -1..1 where it goes by one.
        Raises whatever diffusers and transformers do."""
        import diffusers
        import torch

        self.device, self.dtype = device, getattr(torch, self.asked.precision)
        self.vae = _loaded(getattr(diffusers, self.codes.kind), self.codes, torch.float32, device)
        self.conditions = self.read(image)
        self.model = _loaded(
            getattr(diffusers, self.denoises.kind), self.denoises, self.dtype, device
        )

    def reading(self) -> Any:
        """The part that reads the prompt, loaded."""
        import transformers

        made = getattr(transformers, self.reads.kind)
        found = made.from_pretrained(
            self.reads.folder, dtype=self.dtype, local_files_only=True, use_safetensors=True,
            variant=self.reads.variant,
        )  # fmt: skip
        return found.eval().requires_grad_(False).to(self.device)

    def read(self, image: Any) -> tuple[Any, Any]:
        """The conditions without and with the prompt."""
        raise NotImplementedError

    def level(self, share: float) -> Level:
        """Of noise, for 0 .. 1."""
        raise NotImplementedError

    def encode(self, film: Any) -> Any:
        """The code of a film: the most likely one, which is the same every time."""
        raise NotImplementedError

    def guess(self, z_t: Any, level: Level, condition: Any) -> Any:
        """eps_hat of a noised code."""
        raise NotImplementedError


def _loaded(made: Any, part: Part, dtype: Any, device: str) -> Any:
    found = made.from_pretrained(
        part.folder, torch_dtype=dtype, local_files_only=True, use_safetensors=True,
        variant=part.variant,
    )  # fmt: skip
    return found.eval().requires_grad_(False).to(device)


def by_picture(vae: Any, film: Any) -> Any:
    """The code of a film by a coder of single pictures, one after the other."""
    import torch

    codes = [vae.encode(film[:, :, k]).latent_dist.mode() for k in range(film.shape[2])]
    return torch.stack(codes, dim=2) * vae.config.scaling_factor


def coarser(part: Part) -> int:
    """Pixels per number of a code of a coder of single pictures, along an edge."""
    return 2 ** (len(part.config.get("block_out_channels", [0])) - 1)


def known() -> dict[str, type[Kind]]:
    """All kinds by the class of the part that guesses noise."""
    for found in pkgutil.iter_modules([str(Path(list(kinds.__path__)[0]))]):
        importlib.import_module(f"{kinds.__name__}.{found.name}")
    return {kind.denoiser: kind for kind in Kind.__subclasses__() if kind.denoiser}


def kind_of(path: Path, asked: Sds) -> Kind:
    """The model in a folder, not loaded. Raises ModelError."""
    folder, there = Folder(path), known()
    for name in {kind.part for kind in there.values()}:
        if folder.parts.get(name) in there:
            return there[folder.parts[name]](folder, asked)
    parts = ", ".join(folder.parts.values()) or "nothing"
    raise ModelError(f"is of no kind that is known ({', '.join(sorted(there))}): it has {parts}")
