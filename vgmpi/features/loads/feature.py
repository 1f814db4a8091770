"""Loads: forces, pressures and impulses on bodies, in addition to gravity.

They push the particles that they act on at the start, wherever these move later, before every
transfer to the grid (coupling.py). See [[load]] in docs/reference/scene.md.
"""

from typing import Any

from vgmpi.scene.probes import refuse_balance
from vgmpi.scene.scene_feature import (
    Errors,
    InitialParticles,
    SceneFeature,
    SceneTables,
    TableList,
)

from .table import Load, validate_load


class Loads(SceneFeature):
    """Loads in the tables of a scene."""

    name = title = "loads"
    lists = {"load": TableList({"": Load})}
    suits_implicit_pressure = True

    def check_list(self, name: str, raw: list[dict], tables: SceneTables) -> Errors:
        """Return the errors of the loads.

        Args:
            name, raw, tables: See `SceneFeature.check_list`.
        """
        return [
            ((name, k, *path), message)
            for k, (item, load) in enumerate(zip(raw, tables.lists[name], strict=True))
            for path, message in validate_load(item, load, tables.roles)
        ]

    def check_probes(self, probes: list, tables: SceneTables) -> Errors:
        """Return the errors of probes whose balance of momentum lacks the force of damping.

        Args:
            probes, tables: See `SceneFeature.check_probes`.
        """
        if not any(load and load.damping is not None for load in tables.lists["load"]):
            return []
        message = "is not for scenes with a load of damping: its force is no part of the balance"
        return refuse_balance(probes, message)

    def prepare(self, scene: Any, particles: InitialParticles, colliders: list) -> Any:
        """Return the loads with their particles, or None without any.

        Args:
            scene, particles, colliders: See `SceneFeature.prepare`.
        """
        if not scene.lists["load"]:
            return None
        from .plan import resolve_loads  # it compiles

        return tuple(resolve_loads(scene, particles))

    def plan(self, draft: Any, prepared: Any) -> tuple[Any, Any]:
        """Return the plan of the loads, and the draft as it is.

        Args:
            draft, prepared: See `SceneFeature.plan`.
        """
        if prepared is None:
            return None, draft
        from .plan import LoadsPlan

        return LoadsPlan(prepared), draft


FEATURE = Loads()
