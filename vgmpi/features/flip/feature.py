"""FLIP and AFLIP: transfer schemes that retain motion too fine for the grid.

See `transfer` in docs/reference/scene.md and docs/explanation/transfer-schemes.md.
"""

from typing import Annotated, Any

from vgmpi.runtime.config.schema import Quantity, StrictModel
from vgmpi.scene.scene_feature import SceneFeature


class AccuracyKeys(StrictModel):
    """Keys that FLIP adds to [accuracy]."""

    flip_decay_time: Annotated[float, Quantity("s", gt=0)] = 0.1
    """aflip, flip: time in which particles lose all but 1/e of the motion the grid does not
    resolve"""
    flip_ratio: Annotated[float, Quantity("", gt=0, le=1)] | None = None
    """aflip, flip: FLIP ratio, the fraction of that motion retained in each step, in place of
    `flip_decay_time`: then losses depend on the step"""


class Flip(SceneFeature):
    """FLIP in the tables of a scene: values of `accuracy.transfer`."""

    name, title = "flip", "FLIP"
    section_keys = {"accuracy": AccuracyKeys}
    precedes_copies = True

    def note_lines(self, scene: Any) -> list[str]:
        """Return a line on a ratio that makes results depend on the step."""
        accuracy = scene.accuracy
        if not accuracy.is_flip or accuracy.flip_ratio is None:
            return []
        return [
            f"accuracy.flip_ratio = {accuracy.flip_ratio:g} is retained in each step: the shorter"
            " the step, the more is lost; accuracy.flip_decay_time is a time"
        ]

    def plan(self, draft: Any, prepared: Any) -> tuple[Any, Any]:
        """Return its plan, or None, and the draft with separate stress impulses.

        Args:
            draft, prepared: See `SceneFeature.plan`.
        """
        if not draft.scene.accuracy.is_flip:
            return None, draft
        from .plan import plan_flip

        return plan_flip(draft)


FEATURE = Flip()
