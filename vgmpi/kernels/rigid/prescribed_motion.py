"""Prescribed motion of bodies as the grid sees it, step by step."""

from typing import NamedTuple, Protocol

import numpy as np

ROTATED_CHANNELS = (
    "H",
    "F",
)  # channels that rotate with the body: F - I of the law, or stored in addition
EFFECTIVE_MASS_FACTOR = (
    2.0**60
)  # [-] factor on the mass of such bodies in contact: nothing deflects them


class PrescribedSteps(NamedTuple):
    """Prescribed displacement of a point x in a step: (turn (x - about) + shift) dt, by phase.

    Nodes that something else attaches are marked: colliders do not touch these bodies there.
    """

    driven: np.ndarray  # (phases,) bool, True if the motion is prescribed
    row: np.ndarray  # (phases,) row of the reactions, after all colliders; -1 for other phases
    about: np.ndarray  # (phases, 3) [m] center of rotation
    turn: np.ndarray  # (phases, 3, 3) [1/s] rotation minus identity, per time
    shift: np.ndarray  # (phases, 3) [m/s] translation per time
    reserved: np.ndarray = np.zeros((0, 64), np.uint8)  # (node blocks, 64), or without rows


def no_motions(phases: int) -> PrescribedSteps:
    """Return the steps of phases without prescribed motion."""
    return PrescribedSteps(
        np.zeros(phases, bool), np.full(phases, -1), np.zeros((phases, 3)),
        np.zeros((phases, 3, 3)), np.zeros((phases, 3)),
    )  # fmt: skip


class PhaseMotions(Protocol):
    """Phases whose velocity a feature prescribes."""

    motions: PrescribedSteps
    phases: list[int]  # those that move

    def row_of_group(self, group: int, phase: int) -> int:
        """Return the row of a group's motion in `motions`, -1 if it is at rest."""


NO_PRESCRIBED_BODIES = no_motions(0)


def turn_rates(before: np.ndarray, after: np.ndarray, dt: float) -> np.ndarray:
    """Return rotation minus identity, per time, between two rotations, shape (m, 3, 3) [1/s].

    The products are written out: all ranks must agree, and the rounding of a matrix product may
    differ.

    Args:
        before, after: Rotations at the beginning and the end of a step, shape (m, 3, 3).
        dt: Length of the step [s].
    """
    turned = (after[:, :, None, :] * before[:, None, :, :]).sum(axis=3)
    return (turned - np.eye(3)) / dt
