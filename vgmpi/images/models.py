"""The learned models that a layout asks for, loaded before anything is done."""

from pathlib import Path
from typing import Any, NamedTuple

from vgmpi.images import found, proposed
from vgmpi.images.found import Finder
from vgmpi.images.layout import Empty, LayoutError, Told
from vgmpi.images.proposed import Proposer


class Models(NamedTuple):
    """finder: of masks. depth, clip: None where they are not asked for."""

    finder: Finder
    depth: Any = None
    clip: Any = None


def load(told: Told) -> Models:
    """Raises LayoutError where a model cannot be loaded."""
    asked, beside = told.layout, told.source.folder
    finder: Finder = found.grabcut
    depth, clip = None, None
    if asked.masks.by != "grabcut" and any(thing.mask is None for thing in asked.object):
        finder = _asked(told, "masks", lambda: _sam(asked, beside))
    if asked.depth.by != "floor" and any(thing.support is None for thing in asked.object):
        depth = _asked(told, "depth", lambda: _depth(asked, beside))
    if asked.materials.by != "names" and any(thing.material is None for thing in asked.object):
        clip = _asked(told, "materials", lambda: _clip(asked, beside))
    return Models(finder, depth, clip)


def proposer(asked: Empty, beside: Path) -> Proposer:
    """Who proposes boxes. Raises LayoutError."""
    if asked.masks.by == "grabcut":
        return proposed.standing_out
    from vgmpi.images.learned.loading import LearnedError

    try:
        return _sam(asked, beside).propose
    except LearnedError as error:
        raise LayoutError([f"masks: {error}"]) from None


def _asked(told: Told, table: str, load_it: Any) -> Any:
    from vgmpi.images.learned.loading import LearnedError

    try:
        return load_it()
    except LearnedError as error:
        raise told.wrong(((table,), str(error))) from None


def _sam(asked: Empty, beside: Path) -> Any:
    from vgmpi.images.learned import loading, sam

    one = sam.KINDS[asked.masks.by]
    return sam.load(asked.masks.by, loading.named(asked.masks.weights, one.usual, beside))


def _depth(asked: Empty, beside: Path) -> Any:
    from vgmpi.images.learned import depth, loading

    return depth.load(loading.named(asked.depth.weights, depth.USUAL, beside))


def _clip(asked: Empty, beside: Path) -> Any:
    from vgmpi.images.learned import clip, loading

    return clip.load(loading.named(asked.materials.weights, clip.USUAL, beside))
