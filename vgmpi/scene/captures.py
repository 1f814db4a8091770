"""Keys of objects made of Gaussian files: the axes of the file and the part of it to take."""

from typing import Annotated, Any

from pydantic import BeforeValidator

from vgmpi.gaussians.capture_conventions import validate_frame
from vgmpi.runtime.config.schema import Quantity, Share, StrictModel, Switch

from .shapes import Corners, Sphere

Frame = Annotated[str, BeforeValidator(validate_frame)]


def _integers(value: Any) -> Any:
    """Return a list of integers for one or several; raise ValueError for others."""
    values = value if isinstance(value, list | tuple) else [value]
    if not values or any(isinstance(v, bool) or not isinstance(v, int) for v in values):
        raise ValueError("must be an integer or a list of integers, such as [3, 5]")
    return values


class Select(StrictModel):
    """Selection of Gaussians of a capture; lengths are in the file's own units, axes those of a
    .ply, after `frame`.
    """

    box: Corners | None = None
    """keep the Gaussians inside: lower and upper corner"""
    sphere: Sphere | None = None
    """keep the Gaussians inside: { center, radius }"""
    property: str | None = None
    """name of a column of integers in the file, such as "label" or "object_id" (vgmpi inspect lists
    them); keep the Gaussians whose number is one of `values`"""
    values: Annotated[tuple[int, ...], BeforeValidator(_integers)] = ()
    """with `property`: the numbers to keep, one or a list"""
    min_opacity: Share = 0.0
    """drop Gaussians with less opacity than this"""
    outlier_sigma: Annotated[float, Quantity("", ge=0)] = 0.0
    """drop Gaussians whose mean distance to 8 neighbors is this many standard deviations above the
    cloud's mean (2 .. 4 removes lone ones); 0: keep all"""
    keep_floaters: Switch = False
    """let the few Gaussians that lie apart from all that is seen count, too: for the size and place
    of the object, and as particles. By default they do not, and a line says so"""


def validate_select(raw: Any) -> list[tuple[tuple, str]]:
    """Return (path, message) for keys of an object's `select` that do not go together.

    Args:
        raw: The table as read.
    """
    if not isinstance(raw, dict) or ("property" in raw) == ("values" in raw):
        return []
    key, other = ("property", "values") if "property" in raw else ("values", "property")
    return [(("select", key), f"needs {other}: the column and its numbers belong together")]
