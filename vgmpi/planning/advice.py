"""What would make a scene cheaper, a line each, with the key and where it stands."""

from typing import Any

from ..materials.liquid import Liquid
from ..scene.scene import Scene
from ..source import printable
from .plan import Plan, fastest

WORTH = 1.5  # times as long steps, for which something is said
KEYS = ("youngs_modulus", "shear_modulus")


def stiffness(material: Any) -> str:
    """The key that says how stiff a material is, as the scene gives it."""
    if isinstance(material, Liquid):
        given = ("max_speed", "depth")
        return next((k for k in given if getattr(material, k) is not None), "bulk_modulus")
    return next(k for k in KEYS if k in type(material).model_fields)


def stiffer(scene: Scene, plan: Plan) -> list[str]:
    """What sets the time step alone, where the others would allow longer ones."""
    found = fastest(scene, plan)
    dt, what = found[0]
    others = [bound for bound, of in found if of != what]
    if plan.fixed_dt or not others or others[0] < WORTH * dt:
        return []
    keys = {f"material {name!r}": (name, stiffness(m)) for name, m in scene.material.items()}
    keys |= {f"the viscosity of material {name!r}": (name, "viscosity") for name in scene.material}
    if what not in keys:
        return []
    times, where = others[0] / dt, scene.place(("material", *keys[what]))
    return [
        f"  advice      without {printable(what)} steps would be {times:.1f} times as long:"
        f" they grow as {where} becomes less"
    ]
