"""Models of transformers from a local folder or from Hugging Face, with one-line errors."""

import contextlib
import logging
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

log = logging.getLogger("vgmpi.tools.photo")

IMAGENET = ((0.485, 0.456, 0.406), (0.229, 0.224, 0.225))
_GATED = re.compile(r"gated repo|restricted|403|401 Client Error|awaiting a review", re.IGNORECASE)


class LearnedError(ValueError):
    """Error of an unusable learned model; one line."""


def require_transformers() -> tuple[Any, Any]:
    """Return the packages torch and transformers.

    Raises:
        LearnedError: One of them is missing.
    """
    try:
        import torch
        import transformers
    except ImportError as error:
        message = f"learned models need PyTorch and transformers ({error.name or error} is missing)"
        raise LearnedError(f"{message}: pip install 'vgmpi[learned]'") from None
    transformers.logging.set_verbosity_error()
    transformers.logging.disable_progress_bar()
    return torch, transformers


def resolve_weights(weights: str, default: str, folder: Path) -> str:
    """Return the folder with weights, relative to `folder`, or their name at Hugging Face."""
    name = weights or default
    return str(folder / name) if (folder / name).is_dir() else name


def load_model(kind: str, weights: str, types: tuple[str, ...]) -> Any:
    """Load a model of the class `kind` of transformers, on a GPU if there is one.

    Args:
        kind: Name of the class.
        weights: Folder or name at Hugging Face.
        types: Allowed beginnings of the configuration's model_type.

    Raises:
        LearnedError: The weights are missing or belong to another model.
    """
    torch, transformers = require_transformers()
    model_class = getattr(transformers, kind, None)
    if model_class is None:
        message = f"transformers {transformers.__version__} has no {kind}"
        raise LearnedError(f"{message}: pip install -U transformers")
    with as_learned_error(weights):
        model_type = transformers.AutoConfig.from_pretrained(weights).model_type
    if not model_type.startswith(types):
        message = f"are weights of '{model_type}', not of {' or '.join(types)}"
        raise LearnedError(f"{weights}: {message}")
    with as_learned_error(weights):
        module, info = model_class.from_pretrained(weights, output_loading_info=True)
    missing = list(info.get("missing_keys", ()))
    if missing:
        log.warning("%s: lacks %d weights of %s, %s ...", weights, len(missing), kind, missing[0])
    device = "cuda" if torch.cuda.is_available() else "cpu"
    return module.eval().to(device)


@contextlib.contextmanager
def as_learned_error(weights: str) -> Iterator[None]:
    """Turn any error about weights into a LearnedError."""
    try:
        yield
    except Exception as error:  # hubs, files and configurations raise many kinds of errors
        raise LearnedError(error_line(weights, error)) from None


def error_line(weights: str, error: Exception) -> str:
    """Return one line about an error with weights."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    message = lines[0] if lines else type(error).__name__
    if Path(weights).is_dir():
        return f"{weights}: holds no weights that can be read: {message[:200]}"
    kinds = {type(cause).__name__ for cause in (error, error.__cause__, error.__context__)}
    if "GatedRepoError" in kinds or _GATED.search(str(error)):
        page = f"https://huggingface.co/{weights}"
        return f"{weights}: is gated: ask for it at {page}, then `hf auth login`"
    return f"{weights}: no such folder, and not to be had from Hugging Face: {message[:200]}"


def pixels(
    rgb: np.ndarray, width: int, height: int, look: tuple, sharp: bool = False
) -> np.ndarray:
    """Return a picture as models take it, (1, 3, height, width) float32.

    Args:
        rgb: Picture, shape (h, w, 3) uint8.
        width: Width of the result [pixels].
        height: Height of the result [pixels].
        look: Means and standard deviations of the channels.
        sharp: Whether to resize by cubic instead of linear interpolation.
    """
    from PIL import Image

    how = Image.Resampling.BICUBIC if sharp else Image.Resampling.BILINEAR
    small = np.asarray(Image.fromarray(rgb).resize((width, height), how), dtype=np.float32) / 255
    levels = (small - np.asarray(look[0], np.float32)) / np.asarray(look[1], np.float32)
    return np.ascontiguousarray(levels.transpose(2, 0, 1)[None], dtype=np.float32)


def resized(values: Any, height: int, width: int) -> Any:
    """Resize a tensor (n, h, w) by linear interpolation."""
    torch, _ = require_transformers()
    options = {"mode": "bilinear", "align_corners": False}
    return torch.nn.functional.interpolate(values[None].float(), (height, width), **options)[0]
