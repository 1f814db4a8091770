"""Segment Anything 1, 2 and 3 (its tracker): a mask from a box and points."""

from typing import Any, NamedTuple

import numpy as np

from vgmpi.tools.photo.grabcut import Box, MaskError, box_of, iou, largest_component, marked_parts

from . import model_loading
from .model_loading import IMAGENET

GRID_POINTS = 10  # query points across and down for proposals
MIN_SCORE = 0.75  # [-] smallest score of a proposal
MAX_OVERLAP = 0.6  # [-] masks count as one from this intersection over union on
MIN_AREA, MAX_AREA = 0.003, 0.5  # [-] area of a proposal relative to the picture


class Kind(NamedTuple):
    """Variant of Segment Anything."""

    model: str  # class in transformers
    types: tuple[str, ...]  # allowed beginnings of the configuration's model_type
    default_weights: str  # default weights
    look: tuple  # means and standard deviations of the channels
    padded: bool  # True if pictures keep their shape, padded to a square on the right and below


KINDS = {
    "sam": Kind("SamModel", ("sam",), "facebook/sam-vit-base", IMAGENET, True),
    "sam2": Kind("Sam2Model", ("sam2",), "facebook/sam2.1-hiera-small", IMAGENET, False),
    "sam3": Kind("Sam3TrackerModel", ("sam3",), "facebook/sam3", ((0.5,) * 3, (0.5,) * 3), False),
}


class Sam:
    """Segmenter (a Finder) by a Segment Anything model of transformers."""

    def __init__(self, model: Any, kind: Kind):
        self.model, self.kind = model, kind
        size = model.config.prompt_encoder_config.image_size
        self.size = int(size[0] if isinstance(size, list | tuple) else size)

    def __call__(
        self,
        rgb: np.ndarray,
        box: Box | None,
        points: list[tuple[float, float, bool]],
        text: str | None = None,
    ) -> np.ndarray:
        """Segment one object, (height, width) bool.

        Args:
            rgb: Photograph, shape (height, width, 3) uint8.
            box: Box of the object [pixels], or None.
            points: x, y [pixels] and whether the object is there.
            text: Ignored.

        Raises:
            MaskError: There is neither a box nor a point.
        """
        if box is None and not points:
            raise MaskError("SAM needs a box or point_prompts")
        places = [[x, y] for x, y, _ in points]
        labels = [int(is_object) for _, _, is_object in points]
        masks, _ = self.ask(rgb, [box] if box is not None else None, [places], [labels])
        return marked_parts(masks[0], points)

    def ask(
        self,
        rgb: np.ndarray,
        boxes: list[Box] | None,
        points: list[list[list[float]]],
        labels: list[list[int]],
    ) -> tuple[np.ndarray, np.ndarray]:
        """Segment n objects.

        Args:
            rgb: Photograph, shape (height, width, 3) uint8.
            boxes: Box of each object, or None.
            points: Points of each object, x and y [pixels]; may be empty.
            labels: One label for each point: 1 on the object, 0 off it.

        Returns:
            Masks (n, height, width) bool and their scores (n,).
        """
        torch, _ = model_loading.require_transformers()
        height, width = rgb.shape[:2]
        inner = self._inner(height, width)
        device = next(self.model.parameters()).device
        scale = torch.tensor([inner[1] / width, inner[0] / height], dtype=torch.float32)
        inputs = {"pixel_values": torch.from_numpy(self._pixels(rgb, inner)).to(device)}
        if boxes is not None:
            corners = torch.tensor([list(box) for box in boxes], dtype=torch.float32)
            inputs["input_boxes"] = (corners * scale.repeat(2))[None].to(device)
        if any(points):
            inputs["input_points"] = (torch.tensor(points).float() * scale)[None].to(device)
            inputs["input_labels"] = torch.tensor(labels, dtype=torch.int64)[None].to(device)
        with torch.no_grad():
            output = self.model(**inputs, multimask_output=True)
        scores = output.iou_scores[0].float()
        best = scores.argmax(dim=-1)
        logits = output.pred_masks[0][torch.arange(len(best)), best]
        if self.kind.padded:
            logits = model_loading.resized(logits, self.size, self.size)[:, : inner[0], : inner[1]]
        full = model_loading.resized(logits, height, width)
        return (full > 0).cpu().numpy(), scores.max(dim=-1).values.cpu().numpy()

    def propose(self, rgb: np.ndarray) -> list[Box]:
        """Return boxes of the objects at the points of a grid, the best scores first, each once."""
        height, width = rgb.shape[:2]
        steps = (np.arange(GRID_POINTS) + 0.5) / GRID_POINTS
        points = [[[float(x * width), float(y * height)]] for y in steps for x in steps]
        masks, scores = self.ask(rgb, None, points, [[1]] * len(points))
        distinct: list[np.ndarray] = []
        for k in np.argsort(-scores):
            mask = largest_component(masks[k])
            area = mask.mean()
            if scores[k] >= MIN_SCORE and MIN_AREA <= area <= MAX_AREA:
                if all(iou(mask, previous) < MAX_OVERLAP for previous in distinct):
                    distinct.append(mask)
        return [box_of(mask) for mask in distinct]

    def _inner(self, height: int, width: int) -> tuple[int, int]:
        """Return the rows and columns of the model's square that the picture fills."""
        if not self.kind.padded:
            return self.size, self.size
        scale = self.size / max(height, width)
        return int(height * scale + 0.5), int(width * scale + 0.5)

    def _pixels(self, rgb: np.ndarray, inner: tuple[int, int]) -> np.ndarray:
        """Return the picture as the model takes it, padded to its square."""
        levels = model_loading.pixels(rgb, inner[1], inner[0], self.kind.look)
        padding = [(0, 0), (0, 0), (0, self.size - inner[0]), (0, self.size - inner[1])]
        return np.pad(levels, padding)


def load(kind: str, weights: str) -> Sam:
    """Load one of KINDS.

    Raises:
        LearnedError: The weights cannot be loaded.
    """
    variant = KINDS[kind]
    return Sam(model_loading.load_model(variant.model, weights, variant.types), variant)
