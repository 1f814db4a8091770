"""Times of keyframes."""

from typing import Annotated, Any

from vgmpi.runtime.config.schema import Quantity

Time = Annotated[float, Quantity("s", gt=0)]


def validate_ascending_times(keys: Any, path: tuple) -> list[tuple[tuple, str]]:
    """Return (path, message) for every keyframe of a list that is not later than the one before.

    Raw values are compared; values that are no times are reported by their own tables.
    """
    errors: list[tuple[tuple, str]] = []
    before: float | None = None
    for k, key in enumerate(keys if isinstance(keys, list) else []):
        try:
            time = Quantity("s", gt=0).parse(key["time"])
        except (ValueError, TypeError, KeyError):
            before = None
            continue
        if before is not None and time <= before:
            message = f"must be later than the keyframe before, {before:g} s; got {time:g} s"
            errors.append(((*path, k, "time"), message))
        before = time
    return errors
