"""Time-dependent gravity: keyframes of a scene, and the mean over a step."""

import math
from itertools import pairwise
from typing import Annotated, Any

import numpy as np

from vgmpi.runtime.config.schema import Quantity, StrictModel

from .keyframes import Time, validate_ascending_times

Vector = tuple[float, float, float]
Acceleration = Annotated[float, Quantity("m/s2")]
NODES, WEIGHTS = np.polynomial.legendre.leggauss(
    8
)  # Gauss-Legendre rule, much finer than a time step needs
ANGLE_TOLERANCE = 1e-6  # [-] sine of the angle below which two directions count as parallel


class GravityKeyframe(StrictModel):
    """Gravity at a time."""

    time: Time
    """time of the keyframe; keyframes are in order of time"""
    gravity: tuple[Acceleration, Acceleration, Acceleration]
    """acceleration of gravity at that time"""


Keys = tuple[tuple[float, Vector], ...]  # (time [s], gravity [m/s2]), ascending


def gravity_keys(domain) -> Keys:
    """Return the keyframes of gravity of a domain, the first at time 0; empty without any."""
    keys = domain.gravity_keyframes
    return ((0.0, domain.gravity), *((k.time, k.gravity) for k in keys)) if keys else ()


def gravity_at(keys: Keys, time: float) -> np.ndarray:
    """Return gravity (3,) [m/s2] at a time [s].

    Between two keyframes its direction turns and its magnitude changes at a constant rate; it is
    constant before the first and after the last.
    """
    if time <= keys[0][0]:
        return np.array(keys[0][1])
    for (t0, first), (t1, last) in pairwise(keys):
        if time < t1:
            return _between(np.array(first), np.array(last), (time - t0) / (t1 - t0))
    return np.array(keys[-1][1])


def _between(a: np.ndarray, b: np.ndarray, s: float) -> np.ndarray:
    """Return the gravity at fraction `s` of the interval between `a` and `b`."""
    size_a, size_b = math.sqrt((a**2).sum()), math.sqrt((b**2).sum())
    cross = np.cross(a, b)
    sine = math.sqrt((cross**2).sum())
    if (
        sine <= ANGLE_TOLERANCE * size_a * size_b
    ):  # this includes zero vectors; opposite vectors pass through 0
        return (1 - s) * a + s * b
    angle = math.atan2(sine, float((a * b).sum()))
    turned = math.sin((1 - s) * angle) * a / size_a + math.sin(s * angle) * b / size_b
    return ((1 - s) * size_a + s * size_b) / math.sin(angle) * turned


def mean_gravity(keys: Keys, t0: float, t1: float) -> np.ndarray:
    """Return the mean gravity (3,) [m/s2] between two times [s].

    The integral is taken from keyframe to keyframe, so that the momentum added up to a time does
    not depend on the steps.
    """
    if t1 <= t0:
        return gravity_at(keys, t0)
    ends = [t0, *(t for t, _ in keys if t0 < t < t1), t1]
    total = np.zeros(3)
    for a, b in pairwise(ends):
        middle, half = 0.5 * (a + b), 0.5 * (b - a)
        for node, weight in zip(NODES, WEIGHTS, strict=True):
            total += half * weight * gravity_at(keys, middle + half * node)
    return total / (t1 - t0)


def validate_gravity(raw: Any) -> list[tuple[tuple, str]]:
    """Return (path, message) for errors of the gravity of [domain] besides its values."""
    keys = raw.get("gravity_keyframes") if isinstance(raw, dict) else None
    if not isinstance(keys, list) or not keys:
        return []
    errors: list[tuple[tuple, str]] = []
    if raw.get("gravity_ramp_time"):
        message = "gravity_keyframes and gravity_ramp_time given at once: a ramp is a keyframe too"
        errors.append((("gravity_ramp_time",), message))
    return errors + validate_ascending_times(keys, ("gravity_keyframes",))
