"""How a collider or a driven body moves: its keyframes in a scene, and where it is at a time."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
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
    """Where something is at a time, from where it stands at the start."""

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

    @property
    def ends(self) -> float:
        """When it ends [s]."""
        if self.keyframes:
            return self.keyframes[-1].time
        return math.inf if self.until is None else self.until


@dataclass(frozen=True)
class Course:
    """A motion about a point that is known. about: (3,) [m]."""

    motion: Motion
    about: tuple[float, float, float]

    def legs(self, end: float) -> list[tuple[float, float, tuple]]:
        """(from, to [s], key in the scene) of its parts until `end` [s]."""
        if self.motion.keyframes:
            times = [0.0, *(key.time for key in self.motion.keyframes)]
            return [(a, b, ("keyframes", k)) for k, (a, b) in enumerate(pairwise(times))]
        key = "velocity" if self.motion.velocity is not None else "spin"
        last = min(end, self.motion.until) if self.motion.until is not None else end
        return [(0.0, last, (key,))]

    @property
    def cubics(self) -> tuple[np.ndarray, np.ndarray]:
        """Its parts: when each begins (n,) [s], and of each the coefficients (n, 4, 4) of move x,
        y, z [m] and angle [rad], powers of the time since from the third down."""
        motion = self.motion
        if motion.keyframes:
            keys = motion.keyframes
            times = np.array([0.0, *(key.time for key in keys)])
            rows = np.array([(0.0,) * 4, *((*key.move, key.angle) for key in keys)])
            found = _linear(times, rows) if motion.pace == "linear" else _smooth(times, rows)
            return times, np.concatenate([found, _resting(rows[-1])])
        rate = np.array([*(motion.velocity or (0.0, 0.0, 0.0)), motion.spin or 0.0])
        going = np.zeros((1, 4, 4))
        going[0, :, 2] = rate
        if motion.until is None:
            return np.zeros(1), going
        return np.array([0.0, motion.until]), np.concatenate([going, _resting(motion.until * rate)])

    def far(self, low, high) -> float:
        """Largest distance [m] from the axis it turns about of a point between two corners (3,)
        [m]."""
        ends = np.array([low, high]) - self.about
        corners = np.stack(np.meshgrid(*ends.T, indexing="ij"), -1).reshape(-1, 3)
        return float(np.sqrt((np.cross(self.motion.axis, corners) ** 2).sum(axis=1)).max())

    def rates(self, time: float) -> tuple[np.ndarray, np.ndarray]:
        """Velocity (3,) [m/s] of its point `about`, and angular velocity (3,) [rad/s], at a time
        [s]; at the end of a part those of that part."""
        times, cubics = self.cubics
        part = max(int(np.searchsorted(times, time, "left")) - 1, 0)
        t, c = time - times[part], cubics[part]
        found = (3.0 * c[:, 0] * t + 2.0 * c[:, 1]) * t + c[:, 2]
        return found[:3], found[3] * np.array(self.motion.axis)


def _resting(row: np.ndarray) -> np.ndarray:
    out = np.zeros((1, 4, 4))
    out[0, :, 3] = row
    return out


def _linear(times: np.ndarray, rows: np.ndarray) -> np.ndarray:
    out = np.zeros((len(times) - 1, 4, 4))
    out[:, :, 2] = np.diff(rows, axis=0) / np.diff(times)[:, None]
    out[:, :, 3] = rows[:-1]
    return out


def _smooth(times: np.ndarray, rows: np.ndarray) -> np.ndarray:
    from scipy.interpolate import PchipInterpolator  # no scene without motion waits for it

    # a keyframe more at either end, alike: so it begins and ends at rest
    before, after = times[0] - (times[1] - times[0]), 2 * times[-1] - times[-2]
    found = PchipInterpolator([before, *times, after], [rows[0], *rows, rows[-1]])
    return found.c[:, 1:-1].transpose(1, 2, 0)


class Courses:
    """Where bodies that move are, all together: m of them."""

    def __init__(self, courses: Sequence[Course]):
        self.about = np.array([course.about for course in courses])  # (m, 3) [m]
        self._parts = [course.cubics for course in courses]
        self._since, self._until = np.full((2, len(courses)), np.inf)
        self._now = np.zeros((len(courses), 4, 4))  # of the parts that are in force
        k = np.zeros((len(courses), 3, 3))  # of their axes: k x = axis x x
        x, y, z = np.array([course.motion.axis for course in courses]).T
        k[:, 0, 1], k[:, 0, 2], k[:, 1, 2], k[:, 1, 0], k[:, 2, 0], k[:, 2, 1] = -z, y, -x, z, -y, x
        self._turns = k, (k[:, :, :, None] * k[:, None, :, :]).sum(axis=2)

    def at(self, time: float) -> np.ndarray:
        """Move [m] and angle [rad] at a time [s]: (m, 4)."""
        for m in np.flatnonzero((time < self._since) | (time >= self._until)):
            times, cubics = self._parts[m]
            part = max(int(np.searchsorted(times, time, "right")) - 1, 0)
            self._since[m], self._now[m] = times[part], cubics[part]
            self._until[m] = times[part + 1] if part + 1 < len(times) else np.inf
        t, c = (time - self._since)[:, None], self._now
        return ((c[:, :, 0] * t + c[:, :, 1]) * t + c[:, :, 2]) * t + c[:, :, 3]

    def poses(self, time: float) -> tuple[np.ndarray, np.ndarray]:
        """Rotations (m, 3, 3) and moves (m, 3) [m] at a time [s]: what was at x at the start is at
        rotation (x - about) + about + move. Right-handed (Rodrigues)."""
        found, (k, k2) = self.at(time), self._turns
        angle = found[:, 3, None, None]
        return np.eye(3) + np.sin(angle) * k + (1.0 - np.cos(angle)) * k2, found[:, :3]

    def matrices(self, time: float) -> np.ndarray:
        """Place at the start -> place at a time [s]: (m, 4, 4) [m]."""
        rotation, move = self.poses(time)
        out = np.tile(np.eye(4), (len(move), 1, 1))
        out[:, :3, :3] = rotation
        # written out: all ranks must agree, and a matrix product's rounding may differ
        out[:, :3, 3] = self.about + move - (rotation * self.about[:, None, :]).sum(axis=2)
        return out

    def travels(self, t0: float, t1: float, far: np.ndarray) -> np.ndarray:
        """How far points of each go between two times [s], at the most (m,) [m]; far (m,): the
        largest distance of one from the axis [m]."""
        gone = self.at(t1) - self.at(t0)
        return np.sqrt((gone[:, :3] ** 2).sum(axis=1)) + np.abs(gone[:, 3]) * far

    def fastest(self, t0: float, t1: float, far: np.ndarray) -> np.ndarray:
        """Largest speed [m/s] of points of each between two times [s]; far: see `travels`."""
        times = np.linspace(t0, t1, LOOKS + 1)
        parts = [self.travels(a, b, far) for a, b in pairwise(times)]
        return LOOKS / (t1 - t0) * np.max(parts, axis=0)


def turning(spin: Sequence[float] | np.ndarray) -> list[float]:
    """The gradient (9,) [1/s], row by row, of the velocity of what turns with an angular velocity
    (3,) [rad/s]."""
    x, y, z = spin
    return [0.0, -z, y, z, 0.0, -x, -y, x, 0.0]


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
