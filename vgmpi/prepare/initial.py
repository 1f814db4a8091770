"""How a body begins: its velocities, its share of the space it lies in, its pressure at rest."""

from dataclasses import replace

import numpy as np

from vgmpi.objects import Object
from vgmpi.prepare.pieces import Piece, spacing_of
from vgmpi.prepare.place import PlacementError
from vgmpi.scene import Scene


def begun(scene: Scene, thing: Object, piece: Piece) -> Piece:
    """The piece with the rest volumes and volume ratios the scene asks for. Raises PlacementError
    where none of it is left."""
    if thing.fraction_profile is not None:
        profile = thing.fraction_profile
        along = piece.cloud.x[:, "xyz".index(profile.axis)]
        piece = _shared(piece, np.interp(along, profile.at, profile.share))
    elif thing.fraction != 1.0:
        piece = _shared(piece, np.full(len(piece.cloud), thing.fraction))
    if thing.compressed == "hydrostatic":
        piece = _compressed(scene, thing, piece)
    return piece


def _shared(piece: Piece, share: np.ndarray) -> Piece:
    there = share > 0  # a particle without mass is none
    if not there.any():
        raise PlacementError("fraction_profile", "leaves no particle: its share is 0 everywhere")
    return replace(piece, cloud=piece.cloud.select(there), volume=(piece.volume * share)[there])


def _compressed(scene: Scene, thing: Object, piece: Piece) -> Piece:
    """At rest under gravity: the volume made so far is the compressed one."""
    material, z = scene.material[thing.material], piece.cloud.x[:, 2]
    top = z.max() + spacing_of(scene, thing) / 2
    weight = material.density * -scene.domain.gravity[2] * (top - z)
    theta = material.theta_below(weight)
    return replace(piece, volume=piece.volume * np.exp(-theta), theta=theta)


def velocity(thing: Object, piece: Piece) -> np.ndarray:
    """Velocities [m/s] (n, 3): a translation, a turn about the centre of mass, and waves."""
    x, share = piece.cloud.x, piece.volume / piece.volume.sum()
    middle = (x * share[:, None]).sum(axis=0)
    v = np.asarray(thing.velocity) + np.cross(np.asarray(thing.spin), x - middle)
    for mode in thing.mode:
        k = mode.wave
        angle = k[0] * x[:, 0] + k[1] * x[:, 1] + k[2] * x[:, 2] + mode.phase
        v += np.asarray(mode.amplitude) * np.sin(angle)[:, None]
    return v
