"""Gravity that changes: its keyframes in a scene, and its mean over a step."""

import math
from itertools import pairwise
from typing import Annotated, Any

import numpy as np

from vgmpi.scene.keyframes import Time, ascending
from vgmpi.tables import Quantity, Table

Vector = tuple[float, float, float]
Acceleration = Annotated[float, Quantity("m/s2")]
NODES, WEIGHTS = np.polynomial.legendre.leggauss(8)  # of a quadrature: far more than a step asks
LEVEL = 1e-6  # sine of an angle [rad] below which two directions are one, or opposite


class GravityKeyframe(Table):
    """Gravity at a time."""

    time: Time
    """when; keyframes are in order of time"""
    gravity: tuple[Acceleration, Acceleration, Acceleration]
    """acceleration of gravity then"""


Keys = tuple[tuple[float, Vector], ...]  # (time [s], gravity [m/s2]), ascending


def at(keys: Keys, time: float) -> np.ndarray:
    """Gravity (3,) [m/s2] at a time [s]. Between two keyframes its direction turns and its strength
    changes at an even pace; before the first and after the last it stays."""
    if time <= keys[0][0]:
        return np.array(keys[0][1])
    for (t0, first), (t1, last) in pairwise(keys):
        if time < t1:
            return _between(np.array(first), np.array(last), (time - t0) / (t1 - t0))
    return np.array(keys[-1][1])


def _between(a: np.ndarray, b: np.ndarray, s: float) -> np.ndarray:
    long, wide = math.sqrt((a**2).sum()), math.sqrt((b**2).sum())
    cross = np.cross(a, b)
    sine = math.sqrt((cross**2).sum())
    if sine <= LEVEL * long * wide:  # also where one is 0; opposite ones pass through 0
        return (1 - s) * a + s * b
    angle = math.atan2(sine, float((a * b).sum()))
    turned = math.sin((1 - s) * angle) * a / long + math.sin(s * angle) * b / wide
    return ((1 - s) * long + s * wide) / math.sin(angle) * turned


def mean(keys: Keys, t0: float, t1: float) -> np.ndarray:
    """Mean gravity (3,) [m/s2] between two times [s]: its integral, from keyframe to keyframe, so
    that what it gives up to a time does not depend on the steps."""
    if t1 <= t0:
        return at(keys, t0)
    ends = [t0, *(t for t, _ in keys if t0 < t < t1), t1]
    total = np.zeros(3)
    for a, b in pairwise(ends):
        middle, half = 0.5 * (a + b), 0.5 * (b - a)
        for node, weight in zip(NODES, WEIGHTS, strict=True):
            total += half * weight * at(keys, middle + half * node)
    return total / (t1 - t0)


def gravity_complaints(raw: Any) -> list[tuple[tuple, str]]:
    """(path, text) for what is wrong with the gravity of [domain] beside its values."""
    keys = raw.get("gravity_keyframes") if isinstance(raw, dict) else None
    if not isinstance(keys, list) or not keys:
        return []
    found: list[tuple[tuple, str]] = []
    if raw.get("gravity_ramp"):
        said = "gravity_keyframes and gravity_ramp given at once: a ramp is a keyframe too"
        found.append((("gravity_ramp",), said))
    return found + ascending(keys, ("gravity_keyframes",))
