"""Which surfaces touch at a node: by their gap, how well it is known, and what a wall faces."""

import numpy as np
import pytest

from tests.kernels.test_contact import meeting
from vgmpi.kernels.grid import contact_impulses
from vgmpi.solver.engines.numpy_reference import contact as plain


@pytest.mark.parametrize("known, sure, limit", [
    (True, True, -contact_impulses.LAYER_MAX_OVERLAP), (True, False, contact_impulses.GAP_RESOLVED),
    (False, True, -contact_impulses.MAX_OVERLAP_FLUID),
    (False, False, contact_impulses.GAP_UNRESOLVED),
])  # fmt: skip
def test_what_touches(known, sure, limit):
    """Below a gap that depends on what is known; of known surfaces near their middle only."""
    width = contact_impulses.OVERLAP_HALF_WIDTH if sure else contact_impulses.LAYER_HALF_WIDTH
    for off, near in ((0.0, True), (0.99 * width, True), (1.01 * width, not known)):
        for gap, touches in ((limit - 1e-9, near), (limit + 1e-9, False)):
            m = meeting(gap / 2 + off, gap / 2 - off, known=known, sure=sure)
            assert contact_impulses.in_contact(m) == touches
            assert plain._touching(m.distance_a, m.distance_b, known, sure, False) == touches


def test_what_faces_a_wall_and_overlaps_stays_out_of_it():
    """A wall stops the nodes a cell beyond, too, where a body without reliable normals faces it."""
    overlap = contact_impulses.WALL_OVERLAP_ROUND
    for gap, faces, touches in (
        (-overlap - 1e-9, True, True), (-overlap + 1e-9, True, False), (-2 * overlap, False, False),
    ):  # fmt: skip
        m = meeting(-1.0, 1.0 + gap, sure=False, faces=faces)
        assert contact_impulses.in_contact(m) == touches
        assert plain._touching(m.distance_a, m.distance_b, True, False, faces) == touches
    n, least = np.array([0.0, 0.0, 1.0]), contact_impulses.WALL_ALIGNMENT_MIN
    for cosine, faces in ((-least - 1e-9, True), (-least + 1e-9, False), (1.0, False)):
        x = 0.3 * np.array([np.sqrt(1.0 - cosine**2), 0.0, cosine])
        assert contact_impulses.faces_wall(n, np.array([*x, 1.0])) == faces
        assert plain._PhaseAtNode(0.02, True, 1.0, x, 1.0, 1.0).faces(n) == faces
