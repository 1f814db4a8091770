"""Times of keyframes, and ramps."""

import math
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


def mean_ramp_factor(
    t0: float, t1: float, ramp: float, after: float = 0.0, until: float | None = None
) -> float:
    """Return the mean over a step of a factor that grows from 0 to 1 as half a cosine.

    The integral is exact, so that the impulse up to a time does not depend on the steps.

    Args:
        t0: Start of the step [s].
        t1: End of the step [s].
        ramp: Duration of the growth [s].
        after: Time at which it begins [s].
        until: Time at which the factor drops to 0 [s], or None for never.
    """
    first, last = max(t0, after), t1 if until is None else min(t1, until)
    if last <= first:
        return 0.0
    if first - after >= ramp:
        return (last - first) / (t1 - t0)
    return (_ramp_integral(last - after, ramp) - _ramp_integral(first - after, ramp)) / (t1 - t0)


def _ramp_integral(s: float, ramp: float) -> float:
    """Return the integral of (1 - cos(pi t / ramp)) / 2 from 0 to s, of 1 beyond the ramp."""
    if s >= ramp:
        return s - 0.5 * ramp
    return 0.5 * s - 0.5 * ramp / math.pi * math.sin(math.pi * s / ramp)
