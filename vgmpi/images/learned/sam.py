"""Segment Anything 1, 2 and 3 (its tracker): a mask from a box and clicks."""

from typing import Any, NamedTuple

import numpy as np

from vgmpi.images.learned import loading
from vgmpi.images.learned.loading import IMAGENET
from vgmpi.images.masks import Box, MaskError, box_of, iou, largest

GRID = 10  # points across and down that are asked for proposals
SURE = 0.75  # score from which a mask is a proposal
SAME = 0.6  # intersection over union of two masks that are one
LEAST, MOST = 0.003, 0.5  # share of the picture that a proposal has


class Kind(NamedTuple):
    """model: its class in transformers. types: names of its configurations. usual: weights that are
    taken where none are named. look: means and deviations. padded: whether pictures keep their
    shape, filled up to a square on the right and below."""

    model: str
    types: tuple[str, ...]
    usual: str
    look: tuple
    padded: bool


KINDS = {
    "sam": Kind("SamModel", ("sam",), "facebook/sam-vit-base", IMAGENET, True),
    "sam2": Kind("Sam2Model", ("sam2",), "facebook/sam2.1-hiera-small", IMAGENET, False),
    "sam3": Kind("Sam3TrackerModel", ("sam3",), "facebook/sam3", ((0.5,) * 3, (0.5,) * 3), False),
}


class Sam:
    """A Finder by a model. model: as transformers has it. kind: which one it is."""

    def __init__(self, model: Any, kind: Kind):
        self.model, self.kind = model, kind
        size = model.config.prompt_encoder_config.image_size
        self.size = int(size[0] if isinstance(size, list | tuple) else size)

    def __call__(
        self,
        rgb: np.ndarray,
        box: Box | None,
        clicks: list[tuple[float, float, bool]],
        text: str | None = None,
    ) -> np.ndarray:
        """The object (height, width) bool. Raises MaskError."""
        if box is None and not clicks:
            raise MaskError("SAM needs a box or clicks")
        points = [[x, y] for x, y, _ in clicks]
        labels = [int(is_it) for _, _, is_it in clicks]
        found, _ = self.ask(rgb, [box] if box is not None else None, [points], [labels])
        return largest(found[0])

    def ask(
        self,
        rgb: np.ndarray,
        boxes: list[Box] | None,
        points: list[list[list[float]]],
        labels: list[list[int]],
    ) -> tuple[np.ndarray, np.ndarray]:
        """Masks (n, height, width) bool of n objects and their scores (n,).

        boxes: of each, or None. points, labels: of each, x and y [pixels], and 1 where it is, 0
        where it is not; may be empty.
        """
        torch, _ = loading.tools()
        height, width = rgb.shape[:2]
        inner = self._inner(height, width)
        device = next(self.model.parameters()).device
        scale = torch.tensor([inner[1] / width, inner[0] / height], dtype=torch.float32)
        asked = {"pixel_values": torch.from_numpy(self._pixels(rgb, inner)).to(device)}
        if boxes is not None:
            corners = torch.tensor([list(box) for box in boxes], dtype=torch.float32)
            asked["input_boxes"] = (corners * scale.repeat(2))[None].to(device)
        if any(points):
            asked["input_points"] = (torch.tensor(points).float() * scale)[None].to(device)
            asked["input_labels"] = torch.tensor(labels, dtype=torch.int64)[None].to(device)
        with torch.no_grad():
            told = self.model(**asked, multimask_output=True)
        scores = told.iou_scores[0].float()
        best = scores.argmax(dim=-1)
        logits = told.pred_masks[0][torch.arange(len(best)), best]
        if self.kind.padded:
            logits = loading.resized(logits, self.size, self.size)[:, : inner[0], : inner[1]]
        full = loading.resized(logits, height, width)
        return (full > 0).cpu().numpy(), scores.max(dim=-1).values.cpu().numpy()

    def propose(self, rgb: np.ndarray) -> list[Box]:
        """Boxes of what it finds at the points of a grid, the surest first, each once."""
        height, width = rgb.shape[:2]
        steps = (np.arange(GRID) + 0.5) / GRID
        points = [[[float(x * width), float(y * height)]] for y in steps for x in steps]
        found, scores = self.ask(rgb, None, points, [[1]] * len(points))
        kept: list[np.ndarray] = []
        for k in np.argsort(-scores):
            mask = largest(found[k])
            share = mask.mean()
            if scores[k] >= SURE and LEAST <= share <= MOST:
                if all(iou(mask, one) < SAME for one in kept):
                    kept.append(mask)
        return [box_of(mask) for mask in kept]

    def _inner(self, height: int, width: int) -> tuple[int, int]:
        """Rows and columns of the model's square that the picture takes."""
        if not self.kind.padded:
            return self.size, self.size
        by = self.size / max(height, width)
        return int(height * by + 0.5), int(width * by + 0.5)

    def _pixels(self, rgb: np.ndarray, inner: tuple[int, int]) -> np.ndarray:
        levels = loading.pixels(rgb, inner[1], inner[0], self.kind.look)
        rest = [(0, 0), (0, 0), (0, self.size - inner[0]), (0, self.size - inner[1])]
        return np.pad(levels, rest)


def load(kind: str, weights: str) -> Sam:
    """One of KINDS. Raises LearnedError."""
    one = KINDS[kind]
    return Sam(loading.model(one.model, weights, one.types), one)
