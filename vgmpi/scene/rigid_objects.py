"""Free rigid bodies of a scene: bodies of solids that do not deform and have no particles."""

from typing import TYPE_CHECKING, NamedTuple

from vgmpi.materials.couplings.interaction import CONTACT

if TYPE_CHECKING:
    from vgmpi.materials.material import Material

    from .objects import Object

# keys of bodies made of particles
KEYS_OF_PARTICLES = (
    "region",
    "motion",
    "phase",
    "velocity_mode",
    "volume_fraction",
    "volume_fraction_profile",
    "initial_pressure",
    "subtract",
    "track_deformation",
)
PROBES_OF_PARTICLES = "velocity", "wall", "collider"


class FreeBody(NamedTuple):
    """Properties of a free rigid body."""

    density: float  # [kg/m3]
    friction: float  # [-] Coulomb coefficient against rigid bodies and colliders
    restitution: float  # [-]
    velocity: tuple[float, ...]  # [m/s] at the start
    angular_velocity: tuple[float, ...]  # [rad/s] at the start


def validate_rigid(raw: dict, scenery: bool) -> list[tuple[tuple, str]]:
    """Return (path, message) for keys that do not go together with `rigid`.

    Args:
        raw: Table of the object as read.
        scenery: Whether it is scenery.
    """
    if raw.get("rigid") is not True:
        message = "is only for bodies with rigid = true"
        return [(("restitution",), message)] if "restitution" in raw else []
    if scenery:
        return [(("rigid",), "is not for scenery: it has no mass and does not move")]
    message = "is not for rigid bodies: they have no particles and move freely"
    return [((key,), message) for key in KEYS_OF_PARTICLES if key in raw]


def validate_bodies(objects: list[dict]) -> str:
    """Return why objects, as read, hold nothing that moves, or an empty text."""
    if all(raw.get("role") == "scenery" for raw in objects):
        return "all objects are scenery: at least one must be a body"
    return ""


def validate_rigid_probes(
    probes: list, objects: list, has_sources: bool
) -> list[tuple[tuple, str]]:
    """Return (path, message) of probes of particles in a scene of rigid bodies alone.

    Args:
        probes: Probes of the scene, None in place of invalid ones.
        objects: Objects of the scene, None in place of invalid ones.
        has_sources: Whether the scene has other sources of particles.
    """
    if has_sources or any(
        obj is None or not (obj.rigid or obj.role == "scenery") for obj in objects
    ):
        return []
    message = "measures particles, and all bodies are rigid; object = NAME measures a rigid body"
    return [
        (("probe", k, key), message)
        for k, probe in enumerate(probes)
        for key in PROBES_OF_PARTICLES
        if probe is not None and getattr(probe, key) is not None
    ]


def validate_rigid_scene(
    objects: list, materials: dict, couplings: list, accuracy
) -> list[tuple[tuple, str]]:
    """Return (path, message) for what a scene with rigid bodies cannot have.

    Args:
        objects: Objects of the scene.
        materials: Materials by their names, None in place of invalid ones.
        couplings: Couplings of its materials, None in place of invalid ones.
        accuracy: Table `accuracy`, or None.
    """
    rigid = [k for k, obj in enumerate(objects) if obj.rigid and obj.role == "body"]
    if not rigid:
        return []
    key, errors = ("object", rigid[0], "rigid"), []
    for k in rigid:
        material = materials.get(objects[k].material)
        if material is not None and material.family != "solid":
            message = f"is only for solids; the material is of kind {material.kind!r}"
            errors.append((("object", k, "rigid"), message))
    if accuracy is not None and accuracy.is_flip:
        errors.append((key, f'is not for accuracy.transfer = "{accuracy.transfer}"'))
    if any(coupling is not None and coupling.rule != CONTACT for coupling in couplings):
        errors.append((key, "is not for scenes in which materials mix or flow through sand"))
    return errors


def as_collider(obj: "Object", material: "Material | None") -> "Object":
    """Return a rigid body as the collider by which the solver represents it; others as they are."""
    if not obj.rigid or material is None:
        return obj
    body = FreeBody(
        material.bulk_density, getattr(material, "friction", 0.0), obj.restitution or 0.0,
        obj.velocity, obj.angular_velocity,
    )  # fmt: skip
    changes = {
        "role": "scenery", "collider": True, "material": None, "velocity": (0.0,) * 3,
        "angular_velocity": (0.0,) * 3, "prune": "off", "passive_gaussians": False,
    }  # fmt: skip
    collider = obj.model_copy(update=changes)
    collider._free_body = body
    return collider
