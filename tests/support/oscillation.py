"""Of something that swings to and fro about 0: its period, and what lasts of it."""

import numpy as np


def crossings(times, values) -> np.ndarray:
    """When the values (n,) at some times (n,) pass 0, in a straight line between two of them."""
    times, values = np.array(times), np.array(values)
    at = np.flatnonzero(np.sign(values[1:]) != np.sign(values[:-1]))
    before, after = values[at], values[at + 1]
    return times[at] + (times[at + 1] - times[at]) * before / (before - after)


def period(times, values) -> float:
    """Mean of the periods between the first and the last crossing."""
    found = crossings(times, values)
    return 2 * (found[-1] - found[0]) / (len(found) - 1)


def keeps(times, values) -> float:
    """Share of the amplitude that is left after a period: of the exponential through the extremes
    between crossings."""
    times, values = np.array(times), np.array(values)
    found = crossings(times, values)
    between = np.searchsorted(times, found)
    size = [np.abs(values[a:b]).max() for a, b in zip(between[:-1], between[1:], strict=True)]
    middle = 0.5 * (found[1:] + found[:-1])
    return float(np.exp(np.polyfit(middle, np.log(size), 1)[0] * period(times, values)))
