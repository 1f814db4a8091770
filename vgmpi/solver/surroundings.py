"""How bodies stand, by the blocks that their particles lie in: for --plan."""

from collections.abc import Sequence

import numpy as np

from ..domain.blocks import EDGE, Lattice
from ..domain.solids import REACH
from ..planning.driven import driven_phases
from ..planning.surroundings import Near, Surroundings
from ..scene.scene import Scene

_AROUND = np.stack(np.meshgrid(*(np.arange(-1, 2),) * 3, indexing="ij"), -1).reshape(-1, 1, 3)
_NONE = np.zeros(0, np.int64)


def surroundings(
    scene: Scene, objects: list[dict], x: np.ndarray, colliders: Sequence
) -> tuple[Surroundings, ...]:
    """Of each object and source at the start, when nothing is known of sources. objects: first and
    count of each one's rows in x (n, 3) [m]."""
    bodies = objects[: len(scene.object)]
    found = standing(scene, [x[told["first"] :][: told["count"]] for told in bodies], colliders)
    return (*found, *[Surroundings()] * (len(objects) - len(found)))


def standing(
    scene: Scene, of: Sequence[np.ndarray], colliders: Sequence
) -> tuple[Surroundings, ...]:
    """The same of those whose particles are at `of` (n, 3) [m] each, in the order of scene.things;
    colliders are where they are at the start."""
    lattice = Lattice(scene.domain.cells, scene.domain.cell)
    found = [_blocks(lattice, x) for x in of]
    own = [scene.phase_of(thing) for thing in scene.things[: len(of)]]
    for name, rows in driven_phases(scene).items():
        for k in rows:
            own[k] = name
    beside = {
        name: _spread(
            lattice, [code for (code, _), of in zip(found, own, strict=True) if of == name]
        )
        for name in sorted({name for name in own if name is not None})
    }
    near = _by(lattice, [code for code, _ in found], colliders)
    return tuple(
        Surroundings(
            len(code),
            tuple(
                _near(lattice, p, code, count, there) for p, there in beside.items() if p != own[k]
            ),
            _share(code, count, near),
        )
        for k, (code, count) in enumerate(found)
    )


def _blocks(lattice: Lattice, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Codes (m,) of the blocks in which particles at x (n, 3) [m] lie, and how many in each."""
    block = np.floor((x / lattice.dx + 0.5) / EDGE).astype(np.int64)
    return np.unique(lattice.code(block), return_counts=True)


def _near(
    lattice: Lattice, phase: str, code: np.ndarray, count: np.ndarray, there: np.ndarray
) -> Near:
    """What of blocks with `count` particles is near a phase, which reaches the blocks `there`."""
    close = code[np.isin(code, there)]
    both = np.isin(_spread(lattice, [close]), there) if len(close) else _NONE
    return Near(phase, _share(code, count, there), len(close), int(both.sum()))


def _share(code: np.ndarray, count: np.ndarray, there: np.ndarray) -> float:
    return float(count[np.isin(code, there)].sum() / max(count.sum(), 1))


def _spread(lattice: Lattice, codes: list[np.ndarray]) -> np.ndarray:
    """Codes of the blocks and of all beside them."""
    block = (lattice.block(np.unique(np.concatenate([_NONE, *codes]))) + _AROUND).reshape(-1, 3)
    inside = ((block >= 0) & (block < lattice.shape)).all(axis=1)
    return np.unique(lattice.code(block[inside]))


def _by(lattice: Lattice, codes: list[np.ndarray], colliders: Sequence) -> np.ndarray:
    """Codes of blocks at most one away from those that a collider may touch."""
    if not colliders:
        return _NONE
    wide = _spread(lattice, codes)
    centre = (EDGE * lattice.block(wide) - 1 + (EDGE - 1) / 2) * lattice.dx
    limit = (0.5 * np.sqrt(3.0) * (EDGE - 1) + REACH) * lattice.dx
    close = np.zeros(len(wide), bool)
    for collider in colliders:
        low, high = collider.ends()
        out = np.maximum(np.maximum(low - centre, centre - high), 0.0)
        rows = np.flatnonzero((out**2).sum(axis=1) < limit**2)
        close[rows] |= collider.distance(centre[rows]) < limit
    return _spread(lattice, [wide[close]])
