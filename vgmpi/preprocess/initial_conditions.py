"""Initial volume fraction and hydrostatic pressure of a body.

The module initial_velocity has its velocities.
"""

from dataclasses import replace

import numpy as np

from vgmpi.scene.objects import Object
from vgmpi.scene.scene import Scene

from .built_object import BuiltObject
from .memory_estimate import spacing_of
from .placement import PlacementError


def apply_initial_conditions(scene: Scene, obj: Object, piece: BuiltObject) -> BuiltObject:
    """Return the object with the rest volumes and volume ratios that the scene requests.

    Raises PlacementError if no particle is left.
    """
    if obj.volume_fraction_profile is not None:
        profile = obj.volume_fraction_profile
        along = piece.cloud.x[:, "xyz".index(profile.axis)]
        piece = _with_fractions(piece, np.interp(along, profile.positions, profile.values))
    elif obj.volume_fraction != 1.0:
        piece = _with_fractions(piece, np.full(len(piece.cloud), obj.volume_fraction))
    if obj.initial_pressure == "hydrostatic":
        piece = _compressed(scene, obj, piece)
    return piece


def _with_fractions(piece: BuiltObject, fraction: np.ndarray) -> BuiltObject:
    """Return the object with volumes scaled by volume fractions (n,)."""
    is_filled = fraction > 0  # particles without mass are dropped
    if not is_filled.any():
        raise PlacementError(
            "volume_fraction_profile", "leaves no particle: its values are 0 everywhere"
        )
    return replace(piece, volume=piece.volume * fraction).select(is_filled)


def _compressed(scene: Scene, obj: Object, piece: BuiltObject) -> BuiltObject:
    """Return the object in equilibrium under gravity: its volume so far is the compressed one."""
    material, z = scene.material_of(obj), piece.cloud.x[:, 2]
    top = z.max() + spacing_of(scene, obj) / 2
    weight = material.density * -scene.domain.gravity[2] * (top - z)
    theta = material.hydrostatic_theta(weight)
    return replace(piece, volume=piece.volume * np.exp(-theta), theta=theta)
