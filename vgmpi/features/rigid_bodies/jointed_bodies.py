"""Joints between the free rigid bodies of a scene, step by step; all ranks hold the same."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from vgmpi.features.active_feature import AdheringNodes, NodeState
from vgmpi.kernels.colliders.moving_colliders import MovingColliders
from vgmpi.kernels.colliders.sdf_sampling import SampledSdf

from . import joint_impulses, joint_rows
from .free_bodies import FreeBodies, advance_poses, rotation_matrices
from .joint_rows import Frames, JointTable
from .table import Hinge, Joint, Slider, Spring, tangents

KINDS = {
    "hinge": joint_rows.HINGE,
    "ball": joint_rows.BALL,
    "slider": joint_rows.SLIDER,
    "fixed": joint_rows.FIXED,
    "spring": joint_rows.SPRING,
}


class JointState(NamedTuple):
    """State of a joint after a step."""

    coordinate: float  # [rad] angle of a hinge; [m] displacement of a slider, length of a spring
    force: np.ndarray  # (3,) [N] on the first body
    torque: np.ndarray  # (3,) [N m] on the first body about the joint's point
    power: float  # [W] of the motor


class JointedBodies:
    """Joints of a scene with the bodies that they connect.

    Attributes:
        table: The joints, in the order of the groups of bodies that hang together.
        coordinate: Their angles, displacements and lengths, shape (n,).
        ignored: Pairs of a free body and a collider that a joint keeps from contact, shape
            (m, colliders).
        rows: Their rows in this step.
    """

    def __init__(self, joints: Sequence[Joint], movers: MovingColliders):
        """Attach the joints to their bodies as they are at the start."""
        assert movers.free is not None
        self.bodies: FreeBodies = movers.free
        names = [collider.name for collider in movers.colliders]
        numbers = {names[m]: k for k, m in enumerate(self.bodies.rows)}
        free = len(numbers)
        sides = {name for joint in joints for name in joint.between if name not in numbers}
        self.others = np.array([m for m, name in enumerate(names) if name in sides], np.int64)
        numbers |= {names[m]: free + k for k, m in enumerate(self.others)}
        world = len(numbers)
        ends = [[*(numbers[name] for name in joint.between), world][:2] for joint in joints]
        self.groups, self.order = _groups(ends, free)
        about = movers.table.about[self.others]
        origins = np.concatenate([self.bodies.start, about, np.zeros((1, 3))])
        ordered = [joints[k] for k in self.order]
        self.table = _joint_table(ordered, np.array([ends[k] for k in self.order]), origins)
        self.rows = joint_rows.joint_rows(int(self.table.first[-1]))
        self.groups = self.table.first[self.groups]
        self.errors, self.errors_after = np.zeros((2, len(self.rows.target)))
        self.coordinate, self.dt = np.zeros(len(joints)), 0.0
        self.now = self.after = _frames(
            self.bodies.x, self.bodies.q, movers.table.about, movers.table.rotation, self.others
        )
        self.inverse = np.zeros((free, 6, 6))
        self.ignored = np.zeros((free, len(names)), bool)
        collider_of = [*self.bodies.rows, *self.others]
        for joint, (a, b) in zip(joints, ends, strict=True):
            if not isinstance(joint, Spring) and b < world:
                for k, other in ((a, b), (b, a)):
                    if k < free:
                        self.ignored[k, collider_of[other]] = True

    def begin_step(self, table: SampledSdf, dt: float) -> None:
        """Set the rows of a step, before forces change the bodies' velocities.

        Args:
            table: Colliders as they are placed in the step.
            dt: Time step [s].
        """
        bodies, others = self.bodies, self.others
        x, q = bodies.x.copy(), bodies.q.copy()
        now = _frames(x, q, table.about + table.move, table.rotation, others)
        self.now, self.dt = now, dt
        advance_poses(x, q, bodies.inertia, bodies.momentum, bodies.mass, bodies.spin, dt)
        after = _frames(x, q, table.about + table.move_end, table.rotation_end, others)
        self.after = after
        turn = after.rotations[len(x) :, :, None, :] * now.rotations[len(x) :, None, :, :]
        turn = turn.sum(axis=3) / dt
        v = np.zeros((len(now.x), 6))
        v[: len(x)] = bodies.v
        v[len(x) :, :3] = (after.x[len(x) :] - now.x[len(x) :]) / dt
        for c, (i, k) in enumerate(((2, 1), (0, 2), (1, 0))):
            v[len(x) :, 3 + c] = 0.5 * (turn[:, i, k] - turn[:, k, i])
        self._coordinates(after, self.errors_after)
        self.coordinate = self._coordinates(now, self.errors)
        joint_rows.set_rows(
            self.table,
            now,
            self.errors,
            self.errors_after,
            self.coordinate,
            v,
            len(x),
            dt,
            self.rows,
        )

    def _coordinates(self, frames: Frames, errors: np.ndarray) -> np.ndarray:
        """Return the coordinates of the joints in some frames, shape (n,), and set their errors."""
        coordinate = np.zeros(len(self.coordinate))
        joint_rows.find_errors(self.table, frames, errors, coordinate)
        turns = np.rint((coordinate - self.coordinate) / (2.0 * np.pi))
        turns[self.table.kind != joint_rows.HINGE] = 0.0
        return coordinate - 2.0 * np.pi * turns

    def constrain(self, sums: np.ndarray, quanta: np.ndarray, inertia: np.ndarray) -> None:
        """Change the bodies' velocities, which nodes share, so that the joints hold.

        Args:
            sums, quanta, inertia: See `free_coupling.solve_velocities`.
        """
        bodies = self.bodies
        joint_impulses.invert_condensed(sums, quanta, bodies.mass, inertia, self.inverse)
        self.rows.impulse[:] = 0.0
        joint_impulses.solve_joints(self.rows, self.groups, self.inverse, bodies.v)

    def enforce(self, mass: np.ndarray, inertia: np.ndarray, v: np.ndarray) -> None:
        """Change velocities of the bodies so that the joints hold; nothing else acts.

        Args:
            mass, inertia: See `joint_impulses.invert_inertia`.
            v: Velocities and angular velocities, shape (m, 6) (in/out).
        """
        joint_impulses.invert_inertia(mass, inertia, self.inverse)
        self.rows.impulse[:] = 0.0
        joint_impulses.solve_joints(self.rows, self.groups, self.inverse, v)

    def mobility(self, mass: np.ndarray, inertia: np.ndarray) -> np.ndarray:
        """Return the changes of the velocities per impulse on the bodies, with the joints' answer.

        Rows at a bound of their impulses, as `enforce` has left them, do not answer.

        Args:
            mass, inertia: See `joint_impulses.invert_inertia`.

        Returns:
            Matrix, shape (6 m, 6 m).
        """
        joint_impulses.invert_inertia(mass, inertia, self.inverse)
        matrix = joint_impulses.join_blocks(self.inverse)
        joint_impulses.reduce_mobility(self.rows, self.groups, self.inverse, matrix)
        return matrix

    def add_impulses(self) -> None:
        """Give the bodies the impulses of the joints."""
        joint_impulses.add_impulses(self.rows, self.bodies.momentum, self.bodies.spin)

    def solve_contacts(
        self, count, points, before_count, points_before, spacing, x, v, mass, inertia,
        restitution, dt,
    ):  # fmt: skip
        """Find the impulses at points in contact and of the joints, and change the velocities.

        Args:
            count, points, before_count, points_before, spacing, x, v, mass, inertia, restitution,
                dt: See `contact_sweeps.solve_contacts`.
        """
        joint_impulses.invert_inertia(mass, inertia, self.inverse)
        joint_impulses.solve_contacts_and_joints(
            count, points, before_count, points_before, spacing, x, v, mass, inertia, restitution,
            dt, (self.rows, self.groups, self.inverse),
        )  # fmt: skip

    def state(self, number: int) -> JointState:
        """Return the state of a joint of the scene after the last step."""
        j = int(np.flatnonzero(self.order == number)[0])
        moved, free = Frames(self.after.x.copy(), self.after.rotations.copy()), len(self.bodies.x)
        moved.x[:free] = self.bodies.x
        moved.rotations[:free] = self.bodies.rotations()
        coordinate = float(self._coordinates(moved, np.zeros_like(self.errors))[j])
        if not self.dt:
            return JointState(coordinate, np.full(3, np.nan), np.full(3, np.nan), 0.0)
        rows = slice(self.table.first[j], self.table.first[j + 1])
        force = self.rows.impulse[rows] / self.dt
        total = (force[:, None] * self.rows.jacobian[rows, 0]).sum(0)
        anchor = self.now.rotations[self.table.frames[j, 0]] * self.table.anchors[j, 0]
        power, motor = 0.0, bool(self.table.motor[j, 1])
        if motor:  # its row comes before that of the limits
            last = len(force) - 1 - bool(self.table.limits[j, 0] > -np.inf)
            power = float(force[last]) * (coordinate - float(self.coordinate[j])) / self.dt
        torque = total[3:] - np.cross(anchor.sum(1), total[:3])
        return JointState(coordinate, total[:3], torque, power)

    def saved(self) -> dict:
        """Return the state that a checkpoint stores."""
        return {"coordinate": self.coordinate.tolist()}

    def restore(self, saved: dict) -> None:
        """Restore a saved state."""
        self.coordinate = np.array(saved["coordinate"])


class JointedPushedBodies:
    """Free bodies as what pushes them sees them: a `PushedBodies` of vgmpi/features.

    Attributes:
        number_of: Number of the free body of each collider, -1 if it is not free, (colliders,).
        contact: Accelerations by contact in the last step, shape (m, 6) [m/s2], [rad/s2].
    """

    def __init__(
        self, bodies: FreeBodies, joints: JointedBodies | None, number_of: np.ndarray, coupling: Any
    ):  # fmt: skip
        """Take the bodies, their joints, the numbers of the bodies by collider, and RigidBodies."""
        self.bodies, self.joints, self.number_of = bodies, joints, number_of
        self.coupling = coupling
        self.contact = np.zeros_like(bodies.v)

    def centers(self) -> np.ndarray:
        """Return the centers of the bodies, see `PushedBodies`."""
        return self.bodies.x

    def note_contact(self, change: np.ndarray, dt: float, gravity: np.ndarray) -> None:
        """Note what contact has changed in a step, but for impacts, which do not last.

        Args:
            change: Change of the velocities, shape (m, 6) [m/s], [rad/s].
            dt: Length of the step [s].
            gravity: Acceleration, shape (3,) [m/s2].
        """
        weight, push = (np.sqrt((a**2).sum(-1)) for a in (dt * gravity, change[:, :3]))
        share = np.minimum(1.0, weight / np.maximum(push, 1e-300))
        self.contact[:] = share[:, None] * change / dt

    def predict_velocities(self, dt: float, gravity: np.ndarray) -> np.ndarray:
        """Return the velocities of the bodies after a step without flow.

        What they lie on holds them as in the step before.

        Args:
            dt, gravity: See `PushedBodies`.
        """
        v = self.bodies.v + dt * self.contact
        v[:, :3] += dt * gravity
        if self.joints is not None:
            self.joints.enforce(self.bodies.mass, self.bodies.turned_inertia(), v)
        return v

    def mobility(self) -> np.ndarray:
        """Return the changes of the velocities per impulse, see `PushedBodies`."""
        mass, inertia = self.bodies.mass, self.bodies.turned_inertia()
        if self.joints is not None:
            return self.joints.mobility(mass, inertia)
        inverse = np.zeros((len(mass), 6, 6))
        joint_impulses.invert_inertia(mass, inertia, inverse)
        return joint_impulses.join_blocks(inverse)

    def add_impulses(self, impulses: np.ndarray) -> None:
        """Give the bodies impulses, see `PushedBodies`.

        Args:
            impulses: See `PushedBodies`.
        """
        self.bodies.momentum += impulses[:, :3]
        self.bodies.spin += impulses[:, 3:]

    def sum_adhesion(self, nodes: NodeState, dt: float) -> AdheringNodes | None:
        """Return the nodes that stick to the bodies, see `PushedBodies`."""
        result: AdheringNodes | None = self.coupling.sum_adhesion(nodes, dt)
        return result

    def apply_adhesion(
        self, nodes: NodeState, dt: float, adhering: AdheringNodes, v: np.ndarray
    ) -> None:
        """Give the nodes that stick to the bodies their impulses, see `PushedBodies`.

        Args:
            nodes, dt, adhering, v: See `PushedBodies`.
        """
        self.coupling.apply_adhesion(nodes, dt, adhering, v)


def jointed_bodies(joints: Sequence[Joint], movers: MovingColliders) -> JointedBodies | None:
    """Return the joints of a scene with their bodies, or None if it has none."""
    return JointedBodies(joints, movers) if joints else None


def _groups(ends: list[list[int]], free: int) -> tuple[np.ndarray, np.ndarray]:
    """Return where groups of joints begin, and the order of the joints by groups.

    Joints are in one group if free bodies, the first `free` frames, connect them.
    """
    group = np.arange(free)
    for pair in ends:
        both = [group[f] for f in pair if f < free]
        group[np.isin(group, both)] = min(both)
    own = np.array([group[min(pair)] for pair in ends])
    order = np.argsort(own, kind="stable")
    starts = np.flatnonzero(np.diff(own[order], prepend=-1))
    return np.append(starts, len(ends)), order


def _joint_table(joints: list[Joint], ends: np.ndarray, origins: np.ndarray) -> JointTable:
    """Return the table of joints.

    Args:
        joints: Joints in the table's order.
        ends: Frames of their two sides, shape (n, 2).
        origins: Origins of all frames at the start, shape (f, 3) [m].
    """
    n = len(joints)
    kind = np.array([KINDS[joint.kind] for joint in joints])
    axes, anchors = np.tile(np.eye(3), (n, 1, 1)), np.zeros((n, 2, 3))
    motor, spring = np.zeros((n, 2)), np.zeros((n, 3))
    limits, counts = np.tile([-np.inf, np.inf], (n, 1)), np.zeros(n, np.int64)
    for j, joint in enumerate(joints):
        counts[j] = joint_rows.POINT_ROWS[kind[j]] + joint_rows.TURN_ROWS[kind[j]]
        anchors[j] = np.array(joint.at) - origins[ends[j]]
        if isinstance(joint, Spring):
            anchors[j, 1] = np.array(joint.to) - origins[ends[j, 1]]
            length = float(np.sqrt(((np.array(joint.at) - joint.to) ** 2).sum()))
            spring[j] = joint.stiffness, joint.damping, joint.rest or length
            counts[j] = 1
        if isinstance(joint, Hinge | Slider):
            axes[j, 0], axes[j, 1:] = joint.axis, tangents(joint.axis)
            counts[j] += (joint.motor is not None) + (joint.limits is not None)
            if joint.motor is not None:
                motor[j] = tuple(joint.motor.model_dump().values())
            if joint.limits is not None:
                limits[j] = joint.limits
    first = np.concatenate([[0], np.cumsum(counts)])
    return JointTable(kind, first, ends, anchors, axes, motor, limits, spring)


def _frames(
    x: np.ndarray, q: np.ndarray, places: np.ndarray, rotations: np.ndarray, others: np.ndarray
) -> Frames:
    """Return the frames of free bodies, of some colliders, and of the world.

    Args:
        x, q: Centers [m] and orientations of the bodies, shapes (m, 3) and (m, 4).
        places: Origins of all colliders, shape (colliders, 3) [m].
        rotations: Rotations of all colliders, shape (colliders, 3, 3).
        others: Numbers of the colliders.
    """
    turned = np.zeros((len(x), 3, 3))
    rotation_matrices(q, turned)
    return Frames(
        np.concatenate([x, places[others], np.zeros((1, 3))]),
        np.concatenate([turned, rotations[others], np.eye(3)[None]]),
    )
