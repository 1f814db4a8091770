"""What may come out of the sources of a scene, as rows behind those of its objects; and whether
sources and sinks lie where they can."""

from collections.abc import Iterator

import numpy as np

from vgmpi import room
from vgmpi.planning.groups import surfaced
from vgmpi.planning.inflow import layers, sink_plans, speed
from vgmpi.prepare import cost
from vgmpi.prepare.collider import Collider
from vgmpi.prepare.pieces import Piece, round_cloud
from vgmpi.prepare.place import Placement
from vgmpi.prepare.shapes import TIE, distance
from vgmpi.scene import nozzle
from vgmpi.scene.scene import Scene
from vgmpi.scene.sources import Inflow

FINER = 4  # points of a nozzle that are looked at, from one layer to the next

Complaint = tuple[tuple, str]


def afford(scene: Scene) -> None:
    """Raises SceneError where what comes cannot fit into the memory, or nothing comes."""
    each, dx = cost.MADE["body"] + cost.JOINED["body"], scene.domain.cell
    for k, source in enumerate(scene.inflow):
        per_layer = nozzle.per_layer(source, dx)
        try:
            room.check(per_layer * each, f"a layer of source '{source.name}' has at least")
            found = per_layer * layers(scene, source)
            said = f"source '{source.name}' makes {found:.3g} particles until it ends: at least"
            room.check(found * each, said)
        except room.TooLarge as error:
            raise scene.error([(("source", k), str(error))]) from None
        if not layers(scene, source):
            said = "nothing comes: it ends before the first layer has passed its mouth"
            raise scene.error([(("source", k, "end" if source.end else "start"), said)])


def poured(scene: Scene) -> list[Piece]:
    """All that may come out of each source, as it lies when it passes the mouth: layer after
    layer."""
    dx, still = scene.domain.cell, Placement(np.eye(3), 1.0, np.zeros(3))
    found = []
    for source in scene.inflow:
        h = nozzle.spacing(source, dx)
        x = np.tile(nozzle.mouth(source, dx), (layers(scene, source), 1))
        rgb = np.tile(np.asarray(source.colour, float), (len(x), 1))
        cloud = round_cloud(x, h, rgb, source.opacity)
        found.append(Piece(cloud, np.full(len(x), h**3), still))
    return found


def velocity(scene: Scene, source: Inflow, count: int) -> np.ndarray:
    """[m/s] (count, 3) at the mouth."""
    return np.tile(speed(scene, source) * np.array(source.direction), (count, 1))


def check(scene: Scene, pieces: list[Piece], colliders: list[Collider]) -> None:
    """Raises SceneError where a source or a sink lies where it cannot. pieces: of the objects;
    colliders: where they are at the start."""
    bodies = {
        thing.name: piece.cloud.x
        for thing, piece in zip(scene.object, pieces, strict=True)
        if thing.role == "body"
    }
    found: list[Complaint] = []
    for k, source in enumerate(scene.inflow):
        points = _nozzle(source, scene.domain.cell)
        said = [*_solid(scene, source), *_blocked(scene, k, points, bodies, colliders)]
        found += [(("source", k, key), line) for key, line in said[:1]]  # one of them is enough
    begun = [(k, sink) for k, sink in enumerate(sink_plans(scene)) if not sink.since]
    for k, sink in begun:
        eaten = [
            name
            for name, x in bodies.items()
            if (distance(sink.shape, x + TIE * scene.domain.cell) < 0).any()
        ]
        if eaten:
            said = f"'{sink.name}' holds particles of '{eaten[0]}'"
            said = f"a sink that eats a body at the start: {said}"
            wall = k >= len(scene.sink)
            found.append((("domain", "boundary") if wall else ("sink", k, "shape"), said))
    if found:
        raise scene.error(found)


def _solid(scene: Scene, source: Inflow) -> Iterator[tuple[str, str]]:
    if scene.phase_of(source) in surfaced(scene):
        yield (
            "material",
            f"{source.material!r} is a solid, of which contact knows the surface, and something may"
            " touch it: only liquids, pastes, sand and snow can pour here",
        )


def _blocked(
    scene: Scene, k: int, points: np.ndarray, bodies: dict, colliders: list[Collider]
) -> Iterator[tuple[str, str]]:
    """(key, text) of what lies in the nozzle of source k, whose points (m, 3) these are."""
    source, dx = scene.inflow[k], scene.domain.cell
    key = source.shaped
    for collider in colliders:
        if (collider.distance(points) < 0).any():
            yield key, f"lies inside the collider '{collider.name}'"
    for name, x in bodies.items():
        if _inside(source, dx, x).any():
            yield key, f"body '{name}' lies in its nozzle, two cells behind its mouth"
    for other in scene.inflow[:k]:
        if _inside(other, dx, points).any():
            yield key, f"lies in the nozzle of source '{other.name}'"
    for sink in sink_plans(scene):
        if (distance(sink.shape, points) < 0).any():
            yield key, f"lies in the sink '{sink.name}': nothing would come"


def _nozzle(source: Inflow, dx: float) -> np.ndarray:
    """Points (m, 3) [m] all through a nozzle."""
    h, along = nozzle.spacing(source, dx), np.array(source.direction)
    back = np.arange(FINER * nozzle.ahead(source) + 1) * h / FINER
    return (nozzle.mouth(source, dx) - back[:, None, None] * along).reshape(-1, 3)


def _inside(source: Inflow, dx: float, x: np.ndarray) -> np.ndarray:
    """Which points x (n, 3) [m] lie in the source's nozzle: (n,)."""
    one, other, along = nozzle.frame(source)
    a, b = nozzle.extent(source)
    h = nozzle.spacing(source, dx)
    own = x - np.array(source.opening.center)
    u, v, s = ((own * axis).sum(axis=1) for axis in (one, other, along))
    across = u * u + v * v < a * a if source.disc else (np.abs(u) < a) & (np.abs(v) < b)
    return across & (s < 0) & (s > -nozzle.ahead(source) * h)
