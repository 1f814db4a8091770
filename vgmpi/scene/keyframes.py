"""What all keyframes of a scene have in common: their times."""

from typing import Annotated, Any

from vgmpi.tables import Quantity

Time = Annotated[float, Quantity("s", gt=0)]


def ascending(keys: Any, path: tuple) -> list[tuple[tuple, str]]:
    """(path, text) for every keyframe of a list that is not later than the one before. Looks at raw
    values; those that are no times are complained of by their tables."""
    found: list[tuple[tuple, str]] = []
    before: float | None = None
    for k, key in enumerate(keys if isinstance(keys, list) else []):
        try:
            time = Quantity("s", gt=0).parse(key["time"])
        except (ValueError, TypeError, KeyError):
            before = None
            continue
        if before is not None and time <= before:
            said = f"must be later than the keyframe before, {before:g} s; got {time:g} s"
            found.append(((*path, k, "time"), said))
        before = time
    return found
