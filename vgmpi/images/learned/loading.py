"""Learned models by transformers, from a local folder or from Hugging Face; what is wrong with that
in one line."""

import contextlib
import logging
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

log = logging.getLogger("vgmpi.images")

IMAGENET = ((0.485, 0.456, 0.406), (0.229, 0.224, 0.225))
_GATED = re.compile(r"gated repo|restricted|403|401 Client Error|awaiting a review", re.IGNORECASE)


class LearnedError(ValueError):
    """Why a learned model cannot be asked; one line."""


def tools() -> tuple[Any, Any]:
    """The packages torch and transformers. Raises LearnedError where one is missing."""
    try:
        import torch
        import transformers
    except ImportError as error:
        said = f"learned models need PyTorch and transformers ({error.name or error} is missing)"
        raise LearnedError(f"{said}: pip install 'vgmpi[learned]'") from None
    transformers.logging.set_verbosity_error()
    transformers.logging.disable_progress_bar()
    return torch, transformers


def named(weights: str, usual: str, beside: Path) -> str:
    """The folder with weights, relative to `beside`, or their name at Hugging Face."""
    name = weights or usual
    return str(beside / name) if (beside / name).is_dir() else name


def model(kind: str, weights: str, types: tuple[str, ...]) -> Any:
    """A model of the class `kind` of transformers, ready to be asked, on a card where there is one.

    types: what its configuration may call itself; each may go on behind that. Raises LearnedError.
    """
    torch, transformers = tools()
    made = getattr(transformers, kind, None)
    if made is None:
        said = f"transformers {transformers.__version__} has no {kind}"
        raise LearnedError(f"{said}: pip install -U transformers")
    with told(weights):
        found = transformers.AutoConfig.from_pretrained(weights).model_type
    if not found.startswith(types):
        said = f"are weights of '{found}', not of {' or '.join(types)}"
        raise LearnedError(f"{weights}: {said}")
    with told(weights):
        loaded, info = made.from_pretrained(weights, output_loading_info=True)
    missing = list(info.get("missing_keys", ()))
    if missing:
        log.warning("%s: lacks %d weights of %s, %s ...", weights, len(missing), kind, missing[0])
    device = "cuda" if torch.cuda.is_available() else "cpu"
    return loaded.eval().to(device)


@contextlib.contextmanager
def told(weights: str) -> Iterator[None]:
    """Whatever goes wrong with weights becomes a LearnedError."""
    try:
        yield
    except Exception as error:  # hubs, files and configurations raise all kinds
        raise LearnedError(reason(weights, error)) from None


def reason(weights: str, error: Exception) -> str:
    """One line about what went wrong with weights."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    said = lines[0] if lines else type(error).__name__
    if Path(weights).is_dir():
        return f"{weights}: holds no weights that can be read: {said[:200]}"
    kinds = {type(one).__name__ for one in (error, error.__cause__, error.__context__)}
    if "GatedRepoError" in kinds or _GATED.search(str(error)):
        page = f"https://huggingface.co/{weights}"
        return f"{weights}: is gated: ask for it at {page}, then `hf auth login`"
    return f"{weights}: no such folder, and not to be had from Hugging Face: {said[:200]}"


def pixels(
    rgb: np.ndarray, width: int, height: int, look: tuple, sharp: bool = False
) -> np.ndarray:
    """A picture (h, w, 3) uint8 as models take it: (1, 3, height, width) float32.

    look: means and standard deviations of the channels. sharp: resized by cubics, not linearly.
    """
    from PIL import Image

    how = Image.Resampling.BICUBIC if sharp else Image.Resampling.BILINEAR
    small = np.asarray(Image.fromarray(rgb).resize((width, height), how), dtype=np.float32) / 255
    levels = (small - np.asarray(look[0], np.float32)) / np.asarray(look[1], np.float32)
    return np.ascontiguousarray(levels.transpose(2, 0, 1)[None], dtype=np.float32)


def resized(values: Any, height: int, width: int) -> Any:
    """A tensor (n, h, w) in another size, between its pixels."""
    torch, _ = tools()
    way = {"mode": "bilinear", "align_corners": False}
    return torch.nn.functional.interpolate(values[None].float(), (height, width), **way)[0]
