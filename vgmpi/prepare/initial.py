"""How a body begins: its share of the space it lies in, its pressure at rest. See motion.py for its
velocities."""

from dataclasses import replace

import numpy as np

from vgmpi.prepare.pieces import Piece, spacing_of
from vgmpi.prepare.place import PlacementError
from vgmpi.scene.objects import Object
from vgmpi.scene.scene import Scene


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
