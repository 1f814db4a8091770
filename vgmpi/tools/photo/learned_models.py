"""Learned models that a layout requests, loaded before anything else is done."""

from pathlib import Path
from typing import Any, NamedTuple

from . import box_proposals, object_masks
from .box_proposals import Proposer
from .layout_config import Empty, LayoutError, LoadedLayout
from .object_masks import Finder


class Models(NamedTuple):
    """Segmenter and optional learned models."""

    finder: Finder
    depth: Any = None  # depth model, None if it is not requested
    clip: Any = None  # material model, None if it is not requested


def load(loaded: LoadedLayout) -> Models:
    """Load the models of a layout.

    Raises:
        LayoutError: A model cannot be loaded.
    """
    layout, folder = loaded.layout, loaded.source.folder
    finder: Finder = object_masks.grabcut
    depth, clip = None, None
    if layout.masks.method != "grabcut" and any(obj.mask is None for obj in layout.object):
        finder = _load_or_raise(loaded, "masks", lambda: _sam(layout, folder))
    if layout.depth.method != "floor" and any(obj.support is None for obj in layout.object):
        depth = _load_or_raise(loaded, "depth", lambda: _depth(layout, folder))
    if layout.materials.method != "names" and any(obj.material is None for obj in layout.object):
        clip = _load_or_raise(loaded, "materials", lambda: _clip(layout, folder))
    return Models(finder, depth, clip)


def proposer(layout: Empty, folder: Path) -> Proposer:
    """Return the function that proposes boxes.

    Raises:
        LayoutError: A model cannot be loaded.
    """
    if layout.masks.method == "grabcut":
        return box_proposals.propose_boxes
    return _loaded_sam(layout, folder).propose


def finder(layout: Empty, folder: Path) -> Finder:
    """Return the segmenter.

    Raises:
        LayoutError: A model cannot be loaded.
    """
    if layout.masks.method == "grabcut":
        return object_masks.grabcut
    return _loaded_sam(layout, folder)


def _loaded_sam(layout: Empty, folder: Path) -> Any:
    """Return SAM; raise a LayoutError if it cannot be loaded."""
    from vgmpi.tools.photo.learned.model_loading import LearnedError

    try:
        return _sam(layout, folder)
    except LearnedError as error:
        raise LayoutError([f"masks: {error}"]) from None


def _load_or_raise(loaded: LoadedLayout, table: str, load_model: Any) -> Any:
    """Call a loader; turn a LearnedError into a LayoutError about `table`."""
    from vgmpi.tools.photo.learned.model_loading import LearnedError

    try:
        return load_model()
    except LearnedError as error:
        raise loaded.wrong(((table,), str(error))) from None


def _sam(layout: Empty, folder: Path) -> Any:
    from .learned import model_loading, sam

    kind = sam.KINDS[layout.masks.method]
    return sam.load(
        layout.masks.method,
        model_loading.resolve_weights(layout.masks.weights, kind.default_weights, folder),
    )


def _depth(layout: Empty, folder: Path) -> Any:
    from .learned import depth, model_loading

    return depth.load(
        model_loading.resolve_weights(layout.depth.weights, depth.DEFAULT_WEIGHTS, folder)
    )


def _clip(layout: Empty, folder: Path) -> Any:
    from .learned import clip, model_loading

    return clip.load(
        model_loading.resolve_weights(layout.materials.weights, clip.DEFAULT_WEIGHTS, folder)
    )
