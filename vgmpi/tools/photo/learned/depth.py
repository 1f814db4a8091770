"""Monocular depth by Depth Anything."""

from typing import Any

import numpy as np

from . import model_loading
from .model_loading import IMAGENET

DEFAULT_WEIGHTS = "depth-anything/Depth-Anything-V2-Small-hf"
TRAINING_SIDE = 518  # [pixels] side of the pictures that the model was trained on


class Depth:
    """Depth model of transformers; side: pixels of the pictures that it was made for."""

    def __init__(self, model: Any, side: int = TRAINING_SIDE):
        self.model = model
        self.patch = int(model.config.patch_size)
        self.side = max(self.patch, side // self.patch * self.patch)
        self.metric = getattr(model.config, "depth_estimation_type", "relative") == "metric"

    def nearness(self, rgb: np.ndarray) -> np.ndarray:
        """Return 1 / depth up to a factor and an offset, (height, width) float32."""
        torch, _ = model_loading.require_transformers()
        height, width = rgb.shape[:2]
        rows, columns = self.size(height, width)
        image = model_loading.pixels(rgb, columns, rows, IMAGENET, sharp=True)
        device = next(self.model.parameters()).device
        with torch.no_grad():
            depth = self.model(pixel_values=torch.from_numpy(image).to(device)).predicted_depth
        full = model_loading.resized(depth, height, width)[0].cpu().numpy()
        return 1 / np.maximum(full, 1e-6) if self.metric else full

    def size(self, height: int, width: int) -> tuple[int, int]:
        """Return rows and columns of the model's input.

        Both are whole patches in nearly the shape of the picture; one of them equals the training
        side, whichever changes the picture less.
        """
        scale_factor = min(
            (self.side / n for n in (height, width)), key=lambda scale: abs(1 - scale)
        )
        rows, columns = (max(1, round(n * scale_factor / self.patch)) for n in (height, width))
        return rows * self.patch, columns * self.patch


def load(weights: str) -> Depth:
    """Load Depth Anything.

    Raises:
        LearnedError: The weights cannot be loaded.
    """
    model = model_loading.load_model(
        "DepthAnythingForDepthEstimation", weights, ("depth_anything",)
    )
    backbone = getattr(model.config, "backbone_config", None)
    return Depth(model, int(getattr(backbone, "image_size", TRAINING_SIDE) or TRAINING_SIDE))
