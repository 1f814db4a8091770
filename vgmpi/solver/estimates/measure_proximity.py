"""Proximity of bodies, by the blocks in which their particles lie, for the cost estimate."""

from collections.abc import Sequence

import numpy as np

from vgmpi.kernels.colliders.static_colliders import SDF_BAND_CELLS
from vgmpi.parallel.block_lattice import BLOCK_EDGE, BlockLattice
from vgmpi.planning.step_costs import PhaseProximity, Proximity
from vgmpi.scene.scene import Scene
from vgmpi.scene.scene_feature import phases_of_features

_NEIGHBORS = np.stack(np.meshgrid(*(np.arange(-1, 2),) * 3, indexing="ij"), -1).reshape(-1, 1, 3)
_NONE = np.zeros(0, np.int64)


def surroundings(
    scene: Scene, objects: list[dict], x: np.ndarray, colliders: Sequence
) -> tuple[Proximity, ...]:
    """Measure the proximity of each object at the start; particle sources get an empty one.

    Args:
        scene: The scene.
        objects: Entries of the objects and particle sources, with their first rows and counts in x.
        x: Particle positions, shape (n, 3) [m].
        colliders: Colliders of the scene.
    """
    bodies = objects[: len(scene.object)]
    measured = measure_proximity(
        scene, [x[entry["first_row"] :][: entry["row_count"]] for entry in bodies], colliders
    )
    return (*measured, *[Proximity()] * (len(objects) - len(measured)))


def measure_proximity(
    scene: Scene, positions: Sequence[np.ndarray], colliders: Sequence
) -> tuple[Proximity, ...]:
    """Measure the proximity of bodies to other phases and to colliders.

    Args:
        scene: The scene.
        positions: Particle positions of each body, shape (n, 3) [m], in the order of
            `Scene.entities`.
        colliders: Colliders, which count where they are at the start.
    """
    lattice = BlockLattice(scene.domain.cells, scene.domain.cell)
    blocks = [_blocks(lattice, x) for x in positions]
    phase_of = [scene.phase_of(entity) for entity in scene.entities[: len(positions)]]
    for name, rows in phases_of_features(scene).items():
        for k in rows:
            phase_of[k] = name
    reached_by_phase = {
        name: _spread(
            lattice,
            [code for (code, _), phase in zip(blocks, phase_of, strict=True) if phase == name],
        )
        for name in sorted({name for name in phase_of if name is not None})
    }
    near_colliders = _blocks_near(lattice, [code for code, _ in blocks], colliders)
    return tuple(
        Proximity(
            len(code),
            tuple(
                _phase_proximity(lattice, other, code, count, reached)
                for other, reached in reached_by_phase.items()
                if other != phase_of[k]
            ),
            _fraction(code, count, near_colliders),
        )
        for k, (code, count) in enumerate(blocks)
    )


def _blocks(lattice: BlockLattice, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return codes (m,) of the blocks with particles at x (n, 3) [m], and the count in each."""
    return np.unique(lattice.code(blocks_at(x, lattice.dx)), return_counts=True)


def blocks_at(x: np.ndarray, dx: float) -> np.ndarray:
    """Return the blocks (n, 3) of positions x (n, 3) [m] in cells of dx [m]."""
    return np.floor((x / dx + 0.5) / BLOCK_EDGE).astype(np.int64)


def _phase_proximity(
    lattice: BlockLattice, phase: str, code: np.ndarray, count: np.ndarray, reached: np.ndarray
) -> PhaseProximity:
    """Return the proximity of blocks with `count` particles to a phase.

    Args:
        lattice: Block lattice.
        phase: Name of the other phase.
        code: Codes of the blocks, shape (m,).
        count: Particles in each block, shape (m,).
        reached: Codes of the blocks that the other phase reaches.
    """
    close_blocks = code[np.isin(code, reached)]
    shared = np.isin(_spread(lattice, [close_blocks]), reached) if len(close_blocks) else _NONE
    return PhaseProximity(
        phase, _fraction(code, count, reached), len(close_blocks), int(shared.sum())
    )


def _fraction(code: np.ndarray, count: np.ndarray, reached: np.ndarray) -> float:
    """Return the fraction of the particles whose blocks are among the `reached` ones."""
    return float(count[np.isin(code, reached)].sum() / max(count.sum(), 1))


def _spread(lattice: BlockLattice, codes: list[np.ndarray]) -> np.ndarray:
    """Return the codes of the blocks and of all their neighbors."""
    block = (lattice.block(np.unique(np.concatenate([_NONE, *codes]))) + _NEIGHBORS).reshape(-1, 3)
    inside = ((block >= 0) & (block < lattice.shape)).all(axis=1)
    return np.unique(lattice.code(block[inside]))


def _blocks_near(lattice: BlockLattice, codes: list[np.ndarray], colliders: Sequence) -> np.ndarray:
    """Return the codes of blocks at most one away from those that a collider may touch."""
    if not colliders:
        return _NONE
    candidates = _spread(lattice, codes)
    centre = (BLOCK_EDGE * lattice.block(candidates) - 1 + (BLOCK_EDGE - 1) / 2) * lattice.dx
    limit = (0.5 * np.sqrt(3.0) * (BLOCK_EDGE - 1) + SDF_BAND_CELLS) * lattice.dx
    close = np.zeros(len(candidates), bool)
    for collider in colliders:
        low, high = collider.ends()
        gap = np.maximum(np.maximum(low - centre, centre - high), 0.0)
        rows = np.flatnonzero((gap**2).sum(axis=1) < limit**2)
        close[rows] |= collider.distance(centre[rows]) < limit
    return _spread(lattice, [candidates[close]])
