"""How far everything in a photograph is, by Depth Anything."""

from typing import Any

import numpy as np

from vgmpi.images.learned import loading
from vgmpi.images.learned.loading import IMAGENET

USUAL = "depth-anything/Depth-Anything-V2-Small-hf"
SIDE = 518  # pixels


class Depth:
    """model: as transformers has it. side: pixels of the pictures that it was made for."""

    def __init__(self, model: Any, side: int = SIDE):
        self.model = model
        self.patch = int(model.config.patch_size)
        self.side = max(self.patch, side // self.patch * self.patch)
        self.metric = getattr(model.config, "depth_estimation_type", "relative") == "metric"

    def nearness(self, rgb: np.ndarray) -> np.ndarray:
        """1 / depth, up to a factor and an offset, (height, width) float32."""
        torch, _ = loading.tools()
        height, width = rgb.shape[:2]
        rows, columns = self.size(height, width)
        shown = loading.pixels(rgb, columns, rows, IMAGENET, sharp=True)
        device = next(self.model.parameters()).device
        with torch.no_grad():
            told = self.model(pixel_values=torch.from_numpy(shown).to(device)).predicted_depth
        full = loading.resized(told, height, width)[0].cpu().numpy()
        return 1 / np.maximum(full, 1e-6) if self.metric else full

    def size(self, height: int, width: int) -> tuple[int, int]:
        """Rows and columns that the model is given: whole patches, in nearly the same shape, one of
        them the side it was made for, whichever changes the picture less."""
        by = min((self.side / n for n in (height, width)), key=lambda scale: abs(1 - scale))
        rows, columns = (max(1, round(n * by / self.patch)) for n in (height, width))
        return rows * self.patch, columns * self.patch


def load(weights: str) -> Depth:
    """Raises LearnedError."""
    model = loading.model("DepthAnythingForDepthEstimation", weights, ("depth_anything",))
    backbone = getattr(model.config, "backbone_config", None)
    return Depth(model, int(getattr(backbone, "image_size", SIDE) or SIDE))
