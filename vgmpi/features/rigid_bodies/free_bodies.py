"""State of free rigid bodies: mass, inertia, pose, momentum; all ranks hold the same.

Products are written out or compiled: all ranks must agree, and the rounding of a library's matrix
product may differ.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.kernels.colliders.sdf_sampling import SampledSdf
from vgmpi.runtime.jit import device_function, kernel

SAMPLES_PER_CELL = 4  # samples per cell and axis by which mass and inertia are integrated
STATE = "x", "q", "momentum", "spin", "travel"  # what a checkpoint stores
MAX_SAMPLES = 300_000  # samples that are evaluated together


class RigidBody(NamedTuple):
    """Free rigid body at the start."""

    mass: float  # [kg]
    center: np.ndarray  # (3,) [m] center of mass
    inertia: np.ndarray  # (3, 3) [kg m2] about it
    friction: float  # [-] Coulomb coefficient
    restitution: float  # [-]
    velocity: tuple[float, ...]  # (3,) [m/s]
    angular_velocity: tuple[float, ...]  # (3,) [rad/s]


def mass_properties(collider, density: float, dx: float) -> tuple[float, np.ndarray, np.ndarray]:
    """Return mass [kg], center (3,) [m] and inertia about it (3, 3) [kg m2] of a collider's solid.

    Args:
        collider: Object with distance(points) and ends().
        density: Density [kg/m3].
        dx: Cell size [m].
    """
    low, high = collider.ends()
    step = dx / SAMPLES_PER_CELL
    shape = np.ceil((high - low) / step).astype(np.int64) + 2
    start = 0.5 * (low + high) - 0.5 * step * (shape - 1)
    first, second, volume = np.zeros(3), np.zeros((3, 3)), 0.0
    middle = 0.5 * (low + high)
    for begin in range(0, int(np.prod(shape)), MAX_SAMPLES):
        rows = np.arange(begin, min(begin + MAX_SAMPLES, int(np.prod(shape))))
        x = start + step * np.stack(np.unravel_index(rows, shape), -1)
        share = np.clip(0.5 - collider.distance(x) / step, 0.0, 1.0)
        r = x - middle
        volume += share.sum()
        first += (share[:, None] * r).sum(0)
        second += (share[:, None, None] * r[:, :, None] * r[:, None, :]).sum(0)
    mass = density * volume * step**3
    if not mass > 0.0:
        return 0.0, middle, np.eye(3)
    center = first / volume
    spread = second / volume - center[:, None] * center[None, :] - np.eye(3) * step**2 / 12.0
    inertia = mass * (np.trace(spread) * np.eye(3) - spread)
    return mass, middle + center, inertia


class FreeBodies:
    """Free rigid bodies among the colliders of a scene.

    Attributes:
        rows: Numbers of their colliders, shape (m,).
        mass, inertia: Masses [kg] and inertia tensors at the start [kg m2], (m,) and (m, 3, 3).
        v: Velocity and angular velocity, shape (m, 6) [m/s], [rad/s].
        momentum, spin: Momentum [kg m/s] and angular momentum [kg m2/s], shape (m, 3) each.
        x, q: Centers [m] and orientations (unit quaternions), shape (m, 3) and (m, 4).
    """

    def __init__(self, colliders: list):
        """Take the bodies as they are at the start."""
        self.rows = np.array([m for m, c in enumerate(colliders) if c.body is not None])
        bodies: list[RigidBody] = [colliders[m].body for m in self.rows]
        self.mass = np.array([body.mass for body in bodies])
        self.start = np.array([body.center for body in bodies])
        self.inertia = np.array([body.inertia for body in bodies])
        self.x, self.q = self.start.copy(), np.tile([1.0, 0.0, 0.0, 0.0], (len(bodies), 1))
        self.v = np.array([(*body.velocity, *body.angular_velocity) for body in bodies])
        self.momentum = self.mass[:, None] * self.v[:, :3]
        self.spin = (self.inertia * self.v[:, None, 3:]).sum(2)
        self.friction = np.array([body.friction for body in bodies])
        self.restitution = np.array([body.restitution for body in bodies])
        ends = [np.array(colliders[m].ends()) for m in self.rows]
        self.radius = np.array(
            [
                np.sqrt((np.abs(end - center).max(0) ** 2).sum())
                for end, center in zip(ends, self.start, strict=True)
            ]
        )
        self.travel = np.zeros(len(bodies))  # [m] bound of what a point moved since the last search
        self.searched = self.x.copy(), self.q.copy()  # poses at the last search for near blocks

    def rotations(self) -> np.ndarray:
        """Return the rotations from the start, shape (m, 3, 3)."""
        out = np.zeros((len(self.q), 3, 3))
        rotation_matrices(self.q, out)
        return out

    def turned_inertia(self) -> np.ndarray:
        """Return the inertia tensors in the domain's axes, shape (m, 3, 3) [kg m2]."""
        out = np.zeros_like(self.inertia)
        turn_inertia(self.rotations(), self.inertia, out)
        return out

    def place(self, table: SampledSdf) -> None:
        """Set the poses of the bodies' colliders in their table."""
        rotation, rows = self.rotations(), self.rows
        table.about[rows] = self.start
        table.rotation[rows] = table.rotation_end[rows] = rotation
        table.move[rows] = table.move_end[rows] = self.x - self.start

    def matrices(self) -> np.ndarray:
        """Return matrices from positions at the start to positions now, shape (m, 4, 4)."""
        out = np.tile(np.eye(4), (len(self.x), 1, 1))
        out[:, :3, :3] = rotation = self.rotations()
        out[:, :3, 3] = self.x - (rotation * self.start[:, None, :]).sum(axis=2)
        return out

    def speeds(self) -> np.ndarray:
        """Return a bound of the speed of each body's points, shape (m,) [m/s]."""
        v, w = (np.sqrt((part**2).sum(1)) for part in (self.v[:, :3], self.v[:, 3:]))
        return v + w * self.radius

    def conserved(self, gravity: np.ndarray) -> dict[str, float]:
        """Return momentum, angular momentum about the origin and energies of all bodies.

        Args:
            gravity: Acceleration, shape (3,) [m/s2].
        """
        moments = self.spin + np.cross(self.x, self.momentum)
        kinetic = 0.5 * (self.momentum * self.v[:, :3] + self.spin * self.v[:, 3:]).sum()
        sums = {
            "kinetic_energy": kinetic,
            "potential_energy": -(self.mass * (self.x * gravity).sum(1)).sum(),
        }
        for a, axis in enumerate("xyz"):
            sums |= {
                f"momentum_{axis}": self.momentum[:, a].sum(),
                f"angular_momentum_{axis}": moments[:, a].sum(),
            }
        return {f"rigid_{name}": float(value) for name, value in sums.items()}

    def set_velocities(self) -> None:
        """Compute the velocities from momentum and angular momentum."""
        self.v[:, :3] = self.momentum / self.mass[:, None]
        angular_velocities(self.turned_inertia(), self.spin, self.v)

    def move(self, dt: float) -> None:
        """Advance the poses by a step of dt [s]."""
        self.travel += dt * self.speeds()
        advance_poses(self.x, self.q, self.inertia, self.momentum, self.mass, self.spin, dt)
        self.set_velocities()

    def saved(self) -> dict:
        """Return the state that a checkpoint stores."""
        x, q = self.searched
        state = {name: getattr(self, name).tolist() for name in STATE}
        return state | {"searched_x": x.tolist(), "searched_q": q.tolist()}

    def restore_search(self, saved: dict) -> None:
        """Place the bodies where they were when the blocks near them were searched."""
        self.x[:], self.q[:] = np.array(saved["searched_x"]), np.array(saved["searched_q"])

    def restore(self, saved: dict) -> None:
        """Restore a saved state, after the blocks near the bodies are known."""
        for name in STATE:
            getattr(self, name)[:] = np.array(saved[name])
        self.set_velocities()

    def note_search(self) -> None:
        """Note that the blocks near the bodies are searched as they are placed now."""
        self.searched = self.x.copy(), self.q.copy()
        self.travel[:] = 0.0


@device_function
def _rotation(q, r):
    """Store the rotation matrix of a unit quaternion."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    r[0, 0], r[0, 1], r[0, 2] = (
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    )  # fmt: skip
    r[1, 0], r[1, 1], r[1, 2] = (
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    )  # fmt: skip
    r[2, 0], r[2, 1], r[2, 2] = (
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
    )  # fmt: skip


@kernel
def rotation_matrices(q, out):
    """Compute the rotation matrices of unit quaternions.

    Args:
        q: Quaternions, shape (m, 4).
        out: Matrices (out), shape (m, 3, 3).
    """
    for k in range(len(q)):
        _rotation(q[k], out[k])


@device_function
def _turned(r, inertia, out):
    """Store R I R^T."""
    for a in range(3):
        for b in range(3):
            total = 0.0
            for c in range(3):
                for d in range(3):
                    total += r[a, c] * inertia[c, d] * r[b, d]
            out[a, b] = total


@kernel
def turn_inertia(rotations, inertia, out):
    """Compute inertia tensors in the domain's axes.

    Args:
        rotations: Rotations from the start, shape (m, 3, 3).
        inertia: Inertia tensors at the start, shape (m, 3, 3).
        out: Tensors (out), shape (m, 3, 3).
    """
    for k in range(len(inertia)):
        _turned(rotations[k], inertia[k], out[k])


@device_function
def inverse_times(m, b, out):
    """Store the solution of m y = b for a symmetric positive definite matrix, shape (3, 3)."""
    c00 = m[1, 1] * m[2, 2] - m[1, 2] * m[1, 2]
    c01 = m[0, 2] * m[1, 2] - m[0, 1] * m[2, 2]
    c02 = m[0, 1] * m[1, 2] - m[0, 2] * m[1, 1]
    c11 = m[0, 0] * m[2, 2] - m[0, 2] * m[0, 2]
    c12 = m[0, 1] * m[0, 2] - m[0, 0] * m[1, 2]
    c22 = m[0, 0] * m[1, 1] - m[0, 1] * m[0, 1]
    det = m[0, 0] * c00 + m[0, 1] * c01 + m[0, 2] * c02
    out[0] = (c00 * b[0] + c01 * b[1] + c02 * b[2]) / det
    out[1] = (c01 * b[0] + c11 * b[1] + c12 * b[2]) / det
    out[2] = (c02 * b[0] + c12 * b[1] + c22 * b[2]) / det


@kernel
def angular_velocities(inertia, spin, v):
    """Compute the angular velocities of bodies.

    Args:
        inertia: Inertia tensors in the domain's axes, shape (m, 3, 3) [kg m2].
        spin: Angular momenta, shape (m, 3) [kg m2/s].
        v: Velocities, whose last three numbers are set (out), shape (m, 6).
    """
    for k in range(len(spin)):
        inverse_times(inertia[k], spin[k], v[k, 3:])


@device_function
def _turn(q, w, dt, out):
    """Store the quaternion turned by an angular velocity for dt [s], of length 1."""
    rate = np.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
    half = 0.5 * rate * dt
    s = np.sin(half) / rate if rate > 0.0 else 0.5 * dt
    c, x, y, z = np.cos(half), s * w[0], s * w[1], s * w[2]
    a, b, e, f = q[0], q[1], q[2], q[3]
    out[0] = c * a - x * b - y * e - z * f
    out[1] = c * b + x * a + y * f - z * e
    out[2] = c * e - x * f + y * a + z * b
    out[3] = c * f + x * e - y * b + z * a
    size = np.sqrt(out[0] ** 2 + out[1] ** 2 + out[2] ** 2 + out[3] ** 2)
    for k in range(4):
        out[k] /= size


@kernel
def advance_poses(x, q, inertia, momentum, mass, spin, dt):
    """Advance the poses of bodies by a step, by the midpoint rule for their turn.

    Args:
        x, q: Centers [m] and orientations (in/out), shape (m, 3) and (m, 4).
        inertia: Inertia tensors at the start, shape (m, 3, 3) [kg m2].
        momentum, mass: Momenta [kg m/s] and masses [kg], shape (m, 3) and (m,).
        spin: Angular momenta, shape (m, 3) [kg m2/s].
        dt: Time step [s].
    """
    r, turned, w, middle = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3), np.zeros(4)
    for k in range(len(mass)):
        for a in range(3):
            x[k, a] += dt * momentum[k, a] / mass[k]
        _rotation(q[k], r)
        _turned(r, inertia[k], turned)
        inverse_times(turned, spin[k], w)
        _turn(q[k], w, 0.5 * dt, middle)
        _rotation(middle, r)
        _turned(r, inertia[k], turned)
        inverse_times(turned, spin[k], w)
        _turn(q[k], w, dt, middle)
        for a in range(4):
            q[k, a] = middle[a]
