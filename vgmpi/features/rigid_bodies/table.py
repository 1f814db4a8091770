"""Joints of free rigid bodies: hinges, balls, sliders, fixed joints and springs."""

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field

from vgmpi.runtime.config.schema import Length, Point, Positive, Quantity, StrictModel, as_names
from vgmpi.runtime.message_text import did_you_mean
from vgmpi.scene.objects import Object, checked_name
from vgmpi.scene.scene_feature import Errors, SceneTables
from vgmpi.scene.shapes import Axis

Angle = Annotated[float, Quantity("rad")]
RANK_TOLERANCE = 1e-6  # [-] part of the domain's size below which two points are the same


def _ordered(value: tuple[float, float]) -> tuple[float, float]:
    """Refuse limits that are reversed, or that the position at the start violates."""
    low, high = value
    if not low < high:
        raise ValueError("must be [low, high] with low < high")
    if low > 0.0 or high < 0.0:
        raise ValueError("must contain 0, the position at the start")
    return value


class HingeMotor(StrictModel):
    """Motor of a hinge."""

    speed: Annotated[float, Quantity("rad/s")]
    """angular velocity that it keeps, of the first body against the other one, right-handed about
    the axis; 0: a brake"""
    torque: Annotated[float, Quantity("N m", gt=0)]
    """largest torque"""


class SliderMotor(StrictModel):
    """Motor of a slider."""

    speed: Annotated[float, Quantity("m/s")]
    """speed that it keeps, of the first body against the other one along the axis; 0: a brake"""
    force: Annotated[float, Quantity("N", gt=0)]
    """largest force"""


class Joint(StrictModel):
    """Keys of every joint."""

    name: Annotated[str, BeforeValidator(checked_name)] | None = None
    """unique name, for probes and messages"""
    between: Annotated[
        tuple[str, ...], BeforeValidator(as_names), Field(min_length=1, max_length=2)
    ]
    """one or two names of objects with rigid = true. With one name, the other side is the world.
    One of two may be scenery with collider = true, moving or at rest. Bodies that a joint connects
    do not collide with each other, unless it is a spring"""
    at: Point
    """point of the joint at the start"""
    kind: str
    """kind of the joint"""

    def rows(self, size: float) -> np.ndarray:
        """Return what it prevents, as rows (n, 6) on relative velocity and angular velocity.

        The velocity is that at the domain's origin; lengths are in units of `size` [m].
        """
        return np.zeros((0, 6))


def _point_rows(point: Point, directions: np.ndarray, size: float) -> np.ndarray:
    """Return rows (n, 6) on the velocity of a point along directions (n, 3)."""
    return np.concatenate([directions, np.cross(np.array(point) / size, directions)], 1)


def _turn_rows(directions: np.ndarray) -> np.ndarray:
    """Return rows (n, 6) on the angular velocity along directions (n, 3)."""
    return np.concatenate([np.zeros_like(directions), directions], 1)


def tangents(axis: tuple[float, float, float]) -> np.ndarray:
    """Return two unit vectors at right angles to a unit vector and to each other, shape (2, 3)."""
    n = np.array(axis)
    first = np.cross(n, np.eye(3)[int(np.argmin(np.abs(n)))])
    first /= np.sqrt((first**2).sum())
    return np.array([first, np.cross(n, first)])


class Hinge(Joint):
    """Joint about whose axis a body turns."""

    kind: Literal["hinge"]
    axis: Axis
    """axis at the start: "x", "-x", "y", "-y", "z", "-z" or three numbers"""
    limits: Annotated[tuple[Angle, Angle], AfterValidator(_ordered)] | None = None
    """[low, high]: smallest and largest angle; it is 0 at the start, and may exceed a turn"""
    motor: HingeMotor | None = None
    """{ speed, torque }"""

    def rows(self, size: float) -> np.ndarray:
        """Return what it prevents."""
        point, turn = _point_rows(self.at, np.eye(3), size), _turn_rows(tangents(self.axis))
        return np.concatenate([point, turn])


class Ball(Joint):
    """Joint about whose point a body turns in all directions."""

    kind: Literal["ball"]

    def rows(self, size: float) -> np.ndarray:
        """Return what it prevents."""
        return _point_rows(self.at, np.eye(3), size)


class Slider(Joint):
    """Joint along whose axis a body moves without turning."""

    kind: Literal["slider"]
    axis: Axis
    """axis at the start: "x", "-x", "y", "-y", "z", "-z" or three numbers; it turns with the second
    body"""
    limits: Annotated[tuple[Length, Length], AfterValidator(_ordered)] | None = None
    """[low, high]: smallest and largest displacement; it is 0 at the start"""
    motor: SliderMotor | None = None
    """{ speed, force }"""

    def rows(self, size: float) -> np.ndarray:
        """Return what it prevents."""
        point = _point_rows(self.at, tangents(self.axis), size)
        return np.concatenate([point, _turn_rows(np.eye(3))])


class Fixed(Joint):
    """Joint that makes one rigid body of two."""

    kind: Literal["fixed"]

    def rows(self, size: float) -> np.ndarray:
        """Return what it prevents."""
        return np.concatenate([_point_rows(self.at, np.eye(3), size), _turn_rows(np.eye(3))])


class Spring(Joint):
    """Spring from `at` on the first body to `to` on the other side."""

    kind: Literal["spring"]
    to: Point
    """its other end at the start"""
    stiffness: Annotated[float, Quantity("N/m", gt=0)]
    """force per elongation"""
    damping: Annotated[float, Quantity("N s/m", ge=0)] = 0.0
    """force per rate of elongation"""
    rest: Positive | None = None
    """length without force; default: that at the start"""


JOINTS: dict[str, type[Joint]] = {
    "hinge": Hinge,
    "ball": Ball,
    "slider": Slider,
    "fixed": Fixed,
    "spring": Spring,
}


def validate_joints(tables: SceneTables) -> Errors:
    """Return the errors of the joints of a scene, besides the values of their keys.

    Args:
        tables: Tables of the scene, with the joints.
    """
    errors: Errors = []
    joints, objects = tables.lists["joint"], tables.objects
    by_name = {obj.name: obj for obj in objects if obj is not None}
    for k, joint in enumerate(joints):
        if joint is not None and None not in objects:
            errors += [
                (("joint", k, *path), text) for path, text in _validate_joint(joint, by_name)
            ]
    for k, first in _redundant_joints(joints):
        place, name = tables.place(("joint", first)), joints[first].name
        which = f"joint {name!r} ({place})" if name else f"the joint at {place}"
        message = f"{which} holds the same bodies in the same way: leave one out"
        errors.append((("joint", k), message))
    return errors


def validate_joint_probes(probes: list, joints: list) -> Errors:
    """Return the errors of probes that name no joint.

    Args:
        probes: Probes of the scene, None in place of invalid ones.
        joints: Joints of the scene, likewise.
    """
    if None in joints:
        return []
    errors: Errors = []
    names = [joint.name for joint in joints if joint.name]
    hint = f"known: {', '.join(names)}" if names else "none has a name"
    for k, probe in enumerate(probes):
        if probe is not None and probe.joint is not None and probe.joint not in names:
            message = f"there is no joint '{probe.joint}'{did_you_mean(probe.joint, names)}; {hint}"
            errors.append((("probe", k, "joint"), message))
    return errors


def _validate_joint(joint: Joint, objects: dict[str, Object]) -> list[tuple[tuple, str]]:
    """Return (path, message) for names of a joint that it cannot connect.

    Args:
        joint: The joint.
        objects: Objects of the scene by name.
    """
    errors: list[tuple[tuple, str]] = []
    for k, name in enumerate(joint.between):
        obj = objects.get(name)
        if obj is None:
            hint = f"{did_you_mean(name, objects)}; known: {', '.join(objects)}"
            errors.append((("between", k), f"there is no object '{name}'{hint}"))
        elif not obj.rigid and not obj.collider:
            message = "is no rigid body: give it rigid = true"
            errors.append((("between", k), f"'{name}' {message}"))
    if errors:
        return errors
    if len(set(joint.between)) < len(joint.between):
        return [(("between",), f"names '{joint.between[0]}' twice: give two bodies, or one")]
    if not any(objects[name].rigid for name in joint.between):
        return [(("between",), "names no free body: one of them must have rigid = true")]
    if isinstance(joint, Spring) and joint.rest is None and joint.at == joint.to:
        return [(("to",), "is the same point as at: a spring without length needs rest")]
    return []


def _redundant_joints(joints: list[Any]) -> list[tuple[int, int]]:
    """Return pairs (number, earlier number) of joints of which one adds nothing to the other."""
    pairs = []
    for k, joint in enumerate(joints):
        for first in range(k):
            other = joints[first]
            if joint is None or other is None or set(joint.between) != set(other.between):
                continue
            size = float(np.abs([joint.at, other.at]).max()) or 1.0
            own, others = joint.rows(size), other.rows(size)
            if min(len(own), len(others)) == 0:
                continue
            both = np.concatenate([own, others])
            rank = int(np.linalg.matrix_rank(both, RANK_TOLERANCE))
            if rank == max(len(own), len(others)):
                pairs.append((k, first))
                break
    return pairs
