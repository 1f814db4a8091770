"""Pushes along walls that walls do not take away, on dense arrays; see grid/collider_hold.py."""

from typing import Any, NamedTuple

import numpy as np

from vgmpi.kernels.grid.collider_hold import MIN_SQUARED_LENGTH
from vgmpi.kernels.grid.contact_impulses import FULL_CONTACT_DISTANCE, NO_CONTACT_DISTANCE

from .dense_grid import PUSHING, Dense


class _Source(NamedTuple):
    """Collider or body that pushes a phase, at all nodes."""

    is_near: np.ndarray  # (...) bool
    normal: np.ndarray  # (..., 3) outward normal
    distance: np.ndarray  # (...) [m] distance of the node outside it
    speed: np.ndarray  # (..., 3) [m/s] its velocity
    row: np.ndarray  # (...) row of its reactions


class ColliderHold:
    """Colliders and bodies with prescribed motion that push one phase along walls."""

    def __init__(self, engine: Any, p: int, v: np.ndarray, mass: np.ndarray, volume: np.ndarray):
        """Find what may push phase `p`.

        Args:
            engine: Reference engine.
            p: The phase.
            v: Velocities after contact, shape (phases, ..., 3) [m/s].
            mass: Masses, shape (phases, ...) [kg].
            volume: Mass times distance of known surfaces, else volumes, shape (phases, ...).
        """
        contact, offset = engine.contact, engine.nodes.offset
        self.contact, self.p, self.mass = contact, p, mass[p]
        self.sources: list[_Source] = []
        if contact.plan.phases[p].surface:
            return
        if engine.movers is not None:
            self.sources.append(self._collider())
        for q in np.flatnonzero(contact.motions.driven):
            size = np.linalg.norm(offset[q], axis=-1)
            is_near = (mass[q] > contact.contact_mass[q]) & (size > 0.0)
            if contact.plan.phases[q].surface and is_near.any():
                normal = offset[q] / np.where(is_near, size, 1.0)[..., None]
                distance = volume[q] / np.where(is_near, mass[q], 1.0)
                row = np.full(contact.shape, contact.motions.row[q])
                self.sources.append(_Source(is_near, normal, distance, v[q].copy(), row))

    def _collider(self) -> _Source:
        """Return the nearest collider, or the face that divides nodes, in the half of the phase."""
        contact = self.contact
        is_near = contact.near_collider & (
            contact.collider[..., 3] < NO_CONTACT_DISTANCE * contact.dx
        )
        normal, distance = contact.collider[..., :3].copy(), contact.collider[..., 3].copy()
        if contact.division is not None:
            for node in map(tuple, np.argwhere(is_near)):
                normal[node], distance[node] = contact.division.face(
                    self.p, node, normal[node].copy(), distance[node]
                )
        return _Source(is_near, normal, distance, contact.moves, contact.collider_number)

    def give_back(self, v: np.ndarray, axis: int, plane: int, before: np.ndarray) -> None:
        """Give the phase what a wall has taken of the push, at the nodes of one plane.

        Args:
            v: Velocities of the phase (in/out), shape (..., 3) [m/s].
            axis, plane: Axis across the wall and index of the plane.
            before: Velocities in the plane before the wall acted, shape (n, m, 3) [m/s].
        """
        now = np.moveaxis(v, axis, 0)[plane]
        for source in self.sources:
            is_near, n, distance, speed, row = (np.moveaxis(a, axis, 0)[plane] for a in source)
            nearing = ((speed - now) * n).sum(-1)
            nearing_before = ((speed - before) * n).sum(-1)
            width = NO_CONTACT_DISTANCE - FULL_CONTACT_DISTANCE
            part = (
                NO_CONTACT_DISTANCE - np.where(is_near, distance, 0.0) / self.contact.dx
            ) / width
            push = np.clip(part, 0.0, 1.0) * np.maximum(
                nearing - np.maximum(nearing_before, 0.0), 0.0
            )
            push = np.where(is_near, push, 0.0)
            along = np.where(self._is_blocked(n, axis, plane), 0.0, n)
            change = (push / np.maximum((along**2).sum(-1), MIN_SQUARED_LENGTH))[..., None] * along
            now += np.where(is_near[..., None], change, 0.0)
            self._record(axis, plane, source, np.where(is_near[..., None], change, 0.0))

    def _is_blocked(self, normal: np.ndarray, axis: int, plane: int) -> np.ndarray:
        """Return which components of normals (n, m, 3) in a plane point into a wall."""
        dense: Dense = self.contact.walls
        blocked = np.zeros(normal.shape, bool)
        index = np.moveaxis(np.indices(dense.shape), axis + 1, 1)[:, plane]
        for across, kind, _, wall, _, _ in dense.wall_planes(self.p):
            outward = -1.0 if wall == 1 else 1.0
            beyond = outward * (index[across] - wall) >= 0
            into = (outward * normal[..., across] > 0.0) | (kind not in PUSHING)
            blocked[..., across] |= beyond & into
        return blocked

    def _record(self, axis: int, plane: int, source: _Source, change: np.ndarray) -> None:
        """Record the reactions of what pushes, where they are requested."""
        sums = self.contact.reactions
        if sums is None:
            return
        for i, j in map(tuple, np.argwhere((change != 0.0).any(-1))):
            node = tuple(np.insert([i, j], axis, plane))
            is_body = source.speed is not self.contact.moves
            depth = np.zeros(3) if is_body else source.distance[node] * source.normal[node]
            impulse = self.mass[node] * change[i, j]
            work = float(impulse @ source.speed[node])
            sums.add(int(source.row[node]), sums.points[node] - depth, impulse, work)
