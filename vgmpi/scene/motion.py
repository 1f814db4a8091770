"""How a rigid collider moves: its keyframes in a scene, and where it is at a time."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from vgmpi.scene.forms import Axis
from vgmpi.scene.keyframes import Time, ascending
from vgmpi.tables import Point, Quantity, Table

Angle = Annotated[float, Quantity("rad")]
Speed = Annotated[float, Quantity("m/s")]
LOOKS = 16  # at a leg of a motion, for where it is fastest
WAYS = ("keyframes", "velocity", "spin")


class Keyframe(Table):
    """Where a collider is at a time, from where it stands at the start."""

    time: Time
    """when; keyframes are in order of time"""
    move: Point = (0.0, 0.0, 0.0)
    """how far it has moved"""
    angle: Angle = 0.0
    """by how much it has turned about `axis`, any number of turns"""


class Motion(Table):
    """A motion that nothing stops: keyframes, or a constant velocity and spin."""

    keyframes: Annotated[tuple[Keyframe, ...], Field(max_length=100_000)] = ()
    """{ time, move, angle } in order of time; it begins where it stands, and stays where the last
    one leaves it"""
    pace: Literal["smooth", "linear"] = "smooth"
    """between keyframes. smooth: velocities change without a jump, from rest and to rest, it stays
    where two keyframes are alike, and goes no farther than they say (monotone cubics, Fritsch and
    Butland 1984); linear: at an even pace"""
    velocity: tuple[Speed, Speed, Speed] | None = None
    """instead of keyframes: constant"""
    spin: Annotated[float, Quantity("rad/s")] | None = None
    """instead of keyframes: constant, about `axis`"""
    until: Annotated[float, Quantity("s", gt=0)] | None = None
    """when velocity and spin end; default: never"""
    about: Point | None = None
    """a point of the axis it turns about, at the start; it moves along. Default: the middle of its
    extent"""
    axis: Axis = (0.0, 0.0, 1.0)
    """the axis it turns about: "x", "y", "z" or three numbers; right-handed"""


@dataclass(frozen=True)
class Pose:
    """x = rotation (x0 - about) + about + move, of points at x0 at the start."""

    rotation: np.ndarray  # (3, 3)
    move: np.ndarray  # (3,) [m]


@dataclass(frozen=True)
class Course:
    """A motion about a point that is known. about: (3,) [m]."""

    motion: Motion
    about: tuple[float, float, float]

    def at(self, time: float) -> tuple[np.ndarray, float]:
        """(move (3,) [m], angle [rad]) at a time [s]."""
        motion = self.motion
        if not motion.keyframes:
            passed = min(time, motion.until) if motion.until is not None else time
            return passed * np.array(motion.velocity or (0.0, 0.0, 0.0)), passed * (
                motion.spin or 0
            )
        times, rows = self._rows
        inside = min(time, times[-1])
        if self._smooth is not None:
            found = self._smooth(inside)
        else:
            found = np.array([np.interp(inside, times, row) for row in rows.T])
        return found[:3], float(found[3])

    @cached_property
    def _rows(self) -> tuple[np.ndarray, np.ndarray]:
        keys = self.motion.keyframes
        times = np.array([0.0, *(key.time for key in keys)])
        return times, np.array([(0.0,) * 4, *((*key.move, key.angle) for key in keys)])

    @cached_property
    def _smooth(self) -> Any:
        if self.motion.pace == "linear":
            return None
        from scipy.interpolate import PchipInterpolator  # no scene without motion waits for it

        times, rows = self._rows
        # a keyframe more at either end, alike: so it begins and ends at rest
        before, after = times[0] - (times[1] - times[0]), 2 * times[-1] - times[-2]
        return PchipInterpolator(
            np.array([before, *times, after]), np.array([rows[0], *rows, rows[-1]])
        )

    def legs(self, end: float) -> list[tuple[float, float, tuple]]:
        """(from, to [s], key in the scene) of its parts until `end` [s]."""
        if self.motion.keyframes:
            times = self._rows[0]
            rows = list(zip(times[:-1], times[1:], strict=True))
            return [(float(a), float(b), ("keyframes", k)) for k, (a, b) in enumerate(rows)]
        key = "velocity" if self.motion.velocity is not None else "spin"
        last = min(end, self.motion.until) if self.motion.until is not None else end
        return [(0.0, last, (key,))]

    def fastest(self, t0: float, t1: float, far: float) -> float:
        """Largest speed [m/s] of its points between two times [s]; far: see `travels`."""
        times = np.linspace(t0, t1, LOOKS + 1)
        parts = zip(times[:-1], times[1:], strict=True)
        return LOOKS / (t1 - t0) * max(self.travels(a, b, far) for a, b in parts)

    def pose(self, time: float) -> Pose:
        """Where it is at a time [s]."""
        move, angle = self.at(time)
        return Pose(_rotation(self.motion.axis, angle), move)

    def matrix(self, time: float) -> np.ndarray:
        """Place at the start -> place at a time [s]: (4, 4) [m]."""
        pose, about = self.pose(time), np.array(self.about)
        out = np.eye(4)
        out[:3, :3] = pose.rotation
        # written out: all ranks must agree, and a matrix product's rounding may differ
        out[:3, 3] = about + pose.move - (pose.rotation * about).sum(axis=1)
        return out

    def travels(self, t0: float, t1: float, far: float) -> float:
        """How far its points go between two times [s], at the most [m]; far: the largest distance
        of one from the axis [m]."""
        (first, a0), (last, a1) = self.at(t0), self.at(t1)
        return math.sqrt(((last - first) ** 2).sum()) + abs(a1 - a0) * far


def _rotation(axis: tuple, angle: float) -> np.ndarray:
    """(3, 3) about a unit axis, right-handed (Rodrigues)."""
    x, y, z = axis
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + math.sin(angle) * k + (1.0 - math.cos(angle)) * (k @ k)


def motion_complaints(raw: Any, path: tuple) -> list[tuple[tuple, str]]:
    """(path, text) for what is wrong with a motion beside its values."""
    if not isinstance(raw, dict):
        return []
    found: list[tuple[tuple, str]] = []
    given = [key for key in WAYS if key in raw]
    if not given:
        found.append((path, f"has no motion: give {', '.join(WAYS[:-1])} or {WAYS[-1]}"))
    elif "keyframes" in given and len(given) > 1:
        said = f"{' and '.join(given)} given at once: give keyframes, or velocity and spin"
        found.append(((*path, given[1]), said))
    for key, other in (("until", "keyframes"), ("pace", "velocity"), ("pace", "spin")):
        if key in raw and other in given:
            wanted = "velocity and spin" if key == "until" else "keyframes"
            found.append(((*path, key), f"is for {wanted} only"))
    keys = raw.get("keyframes")
    found += ascending(keys, (*path, "keyframes"))
    if isinstance(keys, list) and not keys:
        found.append(((*path, "keyframes"), "has no keyframe"))
    return found
