"""Rigid motion of a collider or of a body with prescribed motion: keyframes and poses over time."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from vgmpi.runtime.config.schema import Point, Quantity, StrictModel

from .keyframes import Time, validate_ascending_times
from .shapes import Axis

Angle = Annotated[float, Quantity("rad")]
Speed = Annotated[float, Quantity("m/s")]
SPEED_SAMPLES = 16  # samples of a segment's speed, in the search for its maximum
MOTION_KEYS = ("keyframes", "velocity", "angular_velocity")


class Keyframe(StrictModel):
    """Displacement and rotation angle at a time, relative to the start."""

    time: Time
    """time of the keyframe; keyframes are in order of time"""
    translation: Point = (0.0, 0.0, 0.0)
    """displacement"""
    angle: Angle = 0.0
    """rotation about `axis`, any number of turns"""


class Motion(StrictModel):
    """Prescribed rigid motion, independent of contact forces: keyframes, or constant velocity and
    angular velocity.
    """

    keyframes: Annotated[tuple[Keyframe, ...], Field(max_length=100_000)] = ()
    """{ time, translation, angle } in order of time; the motion starts from the initial position
    and ends at the last keyframe"""
    interpolation: Literal["cubic", "linear"] = "cubic"
    """interpolation between keyframes. cubic: velocities are continuous, from rest and to rest,
    the motion pauses between two equal keyframes, and never exceeds them (monotone cubics, Fritsch
    and Butland 1984); linear: constant velocity"""
    velocity: tuple[Speed, Speed, Speed] | None = None
    """instead of keyframes: constant"""
    angular_velocity: Annotated[float, Quantity("rad/s")] | None = None
    """instead of keyframes: constant, about `axis`"""
    end_time: Annotated[float, Quantity("s", gt=0)] | None = None
    """time at which velocity and angular_velocity end; default: never"""
    pivot: Point | None = None
    """a point on the axis of rotation, at the start; it moves along. Default: the center of its
    extent"""
    axis: Axis = (0.0, 0.0, 1.0)
    """axis of rotation: "x", "-x", "y", "-y", "z", "-z" or three numbers; right-handed"""

    @property
    def ends(self) -> float:
        """Return the time at which it ends [s]."""
        if self.keyframes:
            return self.keyframes[-1].time
        return math.inf if self.end_time is None else self.end_time


@dataclass(frozen=True)
class Trajectory:
    """Motion about a given point.

    Attributes:
        motion: Keyframes, or velocity and angular velocity.
        about: Point of the rotation axis at the start, shape (3,) [m].
    """

    motion: Motion
    about: tuple[float, float, float]

    def segments(self, end: float) -> list[tuple[float, float, tuple]]:
        """Return (start [s], end [s], key in the scene) of its segments until `end` [s]."""
        if self.motion.keyframes:
            times = [0.0, *(key.time for key in self.motion.keyframes)]
            return [(a, b, ("keyframes", k)) for k, (a, b) in enumerate(pairwise(times))]
        key = "velocity" if self.motion.velocity is not None else "angular_velocity"
        last = min(end, self.motion.end_time) if self.motion.end_time is not None else end
        return [(0.0, last, (key,))]

    @property
    def cubics(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the cubic polynomials of its segments.

        Returns:
            Start times, shape (n,) [s], and coefficients, shape (n, 4, 4): rows are displacement
            x, y, z [m] and angle [rad], columns the powers of the time since the start of a
            segment, from the third down.
        """
        motion = self.motion
        if motion.keyframes:
            keys = motion.keyframes
            times = np.array([0.0, *(key.time for key in keys)])
            rows = np.array([(0.0,) * 4, *((*key.translation, key.angle) for key in keys)])
            segments = (
                _linear_segments(times, rows)
                if motion.interpolation == "linear"
                else _smooth_segments(times, rows)
            )
            return times, np.concatenate([segments, _constant_segment(rows[-1])])
        rate = np.array([*(motion.velocity or (0.0, 0.0, 0.0)), motion.angular_velocity or 0.0])
        constant = np.zeros((1, 4, 4))
        constant[0, :, 2] = rate
        if motion.end_time is None:
            return np.zeros(1), constant
        return np.array([0.0, motion.end_time]), np.concatenate(
            [constant, _constant_segment(motion.end_time * rate)]
        )

    def max_radius(self, low, high) -> float:
        """Return the largest distance [m] from the axis over a box with two corners (3,) [m]."""
        ends = np.array([low, high]) - self.about
        corners = np.stack(np.meshgrid(*ends.T, indexing="ij"), -1).reshape(-1, 3)
        return float(np.sqrt((np.cross(self.motion.axis, corners) ** 2).sum(axis=1)).max())

    def rates(self, time: float) -> tuple[np.ndarray, np.ndarray]:
        """Return velocity (3,) [m/s] of `about` and angular velocity (3,) [rad/s] at a time [s].

        At the end of a segment they are the rates of that segment.
        """
        times, cubics = self.cubics
        part = max(int(np.searchsorted(times, time, "left")) - 1, 0)
        t, c = time - times[part], cubics[part]
        rate = (3.0 * c[:, 0] * t + 2.0 * c[:, 1]) * t + c[:, 2]
        return rate[:3], rate[3] * np.array(self.motion.axis)


def _constant_segment(row: np.ndarray) -> np.ndarray:
    """Return a segment (1, 4, 4) that stays at `row` (4,)."""
    out = np.zeros((1, 4, 4))
    out[0, :, 3] = row
    return out


def _linear_segments(times: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Return the segments (n - 1, 4, 4) between keyframes `rows` (n, 4) at constant rates."""
    out = np.zeros((len(times) - 1, 4, 4))
    out[:, :, 2] = np.diff(rows, axis=0) / np.diff(times)[:, None]
    out[:, :, 3] = rows[:-1]
    return out


def _smooth_segments(times: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Return monotone cubic segments (n - 1, 4, 4) between keyframes (n, 4)."""
    from scipy.interpolate import (
        PchipInterpolator,
    )  # imported here, since it is slow and only motions need it

    # One equal keyframe is added at either end, so that the motion begins and ends at rest.
    before, after = times[0] - (times[1] - times[0]), 2 * times[-1] - times[-2]
    spline = PchipInterpolator([before, *times, after], [rows[0], *rows, rows[-1]])
    return spline.c[:, 1:-1].transpose(1, 2, 0)


class Trajectories:
    """Poses over time of m moving bodies together."""

    def __init__(self, courses: Sequence[Trajectory]):
        self.about = np.array([course.about for course in courses]).reshape(-1, 3)  # [m]
        self._parts = [course.cubics for course in courses]
        self._since, self._until = np.full((2, len(courses)), np.inf)
        self._now = np.zeros((len(courses), 4, 4))  # the segments at the time of the last call
        k = np.zeros((len(courses), 3, 3))  # cross-product matrices of the axes: k x = axis x x
        x, y, z = np.array([course.motion.axis for course in courses]).reshape(-1, 3).T
        k[:, 0, 1], k[:, 0, 2], k[:, 1, 2], k[:, 1, 0], k[:, 2, 0], k[:, 2, 1] = -z, y, -x, z, -y, x
        self._turns = k, (k[:, :, :, None] * k[:, None, :, :]).sum(axis=2)

    def displacements(self, time: float) -> np.ndarray:
        """Return displacement [m] and angle [rad] at a time [s], shape (m, 4)."""
        for m in np.flatnonzero((time < self._since) | (time >= self._until)):
            times, cubics = self._parts[m]
            part = max(int(np.searchsorted(times, time, "right")) - 1, 0)
            self._since[m], self._now[m] = times[part], cubics[part]
            self._until[m] = times[part + 1] if part + 1 < len(times) else np.inf
        t, c = (time - self._since)[:, None], self._now
        return ((c[:, :, 0] * t + c[:, :, 1]) * t + c[:, :, 2]) * t + c[:, :, 3]

    def poses(self, time: float) -> tuple[np.ndarray, np.ndarray]:
        """Return rotations (m, 3, 3) and displacements (m, 3) [m] at a time [s].

        A point at x at the start is at rotation (x - about) + about + displacement. Right-handed
        (Rodrigues).
        """
        state, (k, k2) = self.displacements(time), self._turns
        angle = state[:, 3, None, None]
        return np.eye(3) + np.sin(angle) * k + (1.0 - np.cos(angle)) * k2, state[:, :3]

    def matrices(self, time: float) -> np.ndarray:
        """Return matrices (m, 4, 4) from positions at the start to positions at a time [s]."""
        rotation, move = self.poses(time)
        out = np.tile(np.eye(4), (len(move), 1, 1))
        out[:, :3, :3] = rotation
        # Written out: all ranks must agree, and the rounding of a matrix product may differ.
        out[:, :3, 3] = self.about + move - (rotation * self.about[:, None, :]).sum(axis=2)
        return out

    def travels(self, t0: float, t1: float, radius: np.ndarray) -> np.ndarray:
        """Return upper bounds (m,) [m] of the displacement of points between two times.

        Args:
            t0: First time [s].
            t1: Second time [s].
            radius: Largest distance of a point from the axis, shape (m,) [m].
        """
        change = self.displacements(t1) - self.displacements(t0)
        return np.sqrt((change[:, :3] ** 2).sum(axis=1)) + np.abs(change[:, 3]) * radius

    def fastest(self, t0: float, t1: float, radius: np.ndarray) -> np.ndarray:
        """Return the largest speeds (m,) [m/s] between two times.

        Args:
            t0: First time [s].
            t1: Second time [s].
            radius: Largest distance of a point from the axis, shape (m,) [m].
        """
        times = np.linspace(t0, t1, SPEED_SAMPLES + 1)
        parts = [self.travels(a, b, radius) for a, b in pairwise(times)]
        return SPEED_SAMPLES / (t1 - t0) * np.max(parts, axis=0)


def spin_tensor(spin: Sequence[float] | np.ndarray) -> list[float]:
    """Return the velocity gradient (9,) [1/s], by rows, of an angular velocity (3,) [rad/s]."""
    x, y, z = spin
    return [0.0, -z, y, z, 0.0, -x, -y, x, 0.0]


def course_of(motion: Motion, low, high) -> Trajectory:
    """Return the motion of a body whose particles lie between two corners, shape (3,) [m].

    The body rotates about the center of that box unless its motion says otherwise.
    """
    x, y, z = (float(a + b) / 2 for a, b in zip(low, high, strict=True))
    return Trajectory(motion, motion.pivot or (x, y, z))


def validate_motion(raw: Any, path: tuple) -> list[tuple[tuple, str]]:
    """Return (path, message) for errors of a motion besides its values."""
    if not isinstance(raw, dict):
        return []
    errors: list[tuple[tuple, str]] = []
    present = [key for key in MOTION_KEYS if key in raw]
    if not present:
        errors.append(
            (path, f"has no motion: give {', '.join(MOTION_KEYS[:-1])} or {MOTION_KEYS[-1]}")
        )
    elif "keyframes" in present and len(present) > 1:
        message = (
            f"{' and '.join(present)} given at once: give keyframes, or velocity and"
            " angular_velocity"
        )
        errors.append(((*path, present[1]), message))
    for key, other in (
        ("end_time", "keyframes"),
        ("interpolation", "velocity"),
        ("interpolation", "angular_velocity"),
    ):
        if key in raw and other in present:
            required = "velocity and angular_velocity" if key == "end_time" else "keyframes"
            errors.append(((*path, key), f"is for {required} only"))
    keys = raw.get("keyframes")
    errors += validate_ascending_times(keys, (*path, "keyframes"))
    if isinstance(keys, list) and not keys:
        errors.append(((*path, "keyframes"), "has no keyframe"))
    return errors
