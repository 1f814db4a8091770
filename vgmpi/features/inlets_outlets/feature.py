"""Inlets and outlets: particles enter through nozzles, and leave where outlets and open walls are.

See docs/explanation/boundaries.md.
"""

from typing import Any

from vgmpi.materials.material import unknown_material
from vgmpi.scene.probes import refuse_balance
from vgmpi.scene.scene_feature import Errors, SceneFeature, SceneTables, TableList

from .geometry import Disc, Rectangle, spacing
from .table import Inlet, Outlet, validate_inlet, validate_outlet


class InletsOutlets(SceneFeature):
    """Inlets and outlets in the tables of a scene; walls that particles leave through, too."""

    name, title = "inlets_outlets", "inlets and outlets"
    suits_implicit_pressure = True
    lists = {
        "inlet": TableList({"": Inlet}, {"disc": Disc, "rectangle": Rectangle}),
        "outlet": TableList({"": Outlet}),
    }

    def check_list(self, name: str, raw: list[dict], tables: SceneTables) -> Errors:
        """Return the errors of the inlets, or of the outlets.

        Args:
            name, raw, tables: See `SceneFeature.check_list`.
        """
        errors: Errors = []
        for k, (table, item) in enumerate(zip(raw, tables.lists[name], strict=True)):
            if name == "outlet":
                own = validate_outlet(table, tables.lists["inlet"])
            else:
                own = validate_inlet(table, item, tables)
            if name == "inlet" and item is not None and item.material not in tables.materials:
                own.append((("material",), unknown_material(item.material, tables.materials)))
            errors += [((name, k, *path), message) for path, message in own]
        return errors

    def check_probes(self, probes: list, tables: SceneTables) -> Errors:
        """Return the errors of probes whose balance of momentum lacks what comes and goes.

        Args:
            probes, tables: See `SceneFeature.check_probes`.
        """
        domain = tables.sections.get("domain")
        is_open = domain is not None and bool(domain.open_walls)
        if not (is_open or tables.lists["inlet"] or tables.lists["outlet"]):
            return []
        message = "is not for scenes where particles come or go: these are no part of its balance"
        return refuse_balance(probes, message)

    def changes_mass(self, scene: Any) -> bool:
        """Return whether particles enter or leave the domain."""
        return bool(scene.lists["inlet"] or scene.lists["outlet"] or scene.domain.open_walls)

    def particle_estimates(self, scene: Any) -> list[tuple[int, float]]:
        """Return the number of particles and their spacing [m] of each inlet."""
        from .plan import particle_count

        return [
            (particle_count(scene, inlet), spacing(inlet, scene.domain.cell))
            for inlet in scene.lists["inlet"]
        ]

    def check_memory(self, scene: Any) -> None:
        """Raise SceneError if an inlet's particles cannot fit into the memory, or none would come.

        Args:
            scene: The scene.
        """
        from .particles import require_inlet_memory  # it compiles

        require_inlet_memory(scene)

    def check_bodies(self, scene: Any, pieces: list, colliders: list) -> Errors:
        """Return the errors of inlets and outlets in invalid positions.

        Args:
            scene, pieces, colliders: See `SceneFeature.check_bodies`.
        """
        from .particles import validate_inlets_outlets

        return validate_inlets_outlets(scene, pieces, colliders)

    def build_particles(self, scene: Any) -> list:
        """Return all particles that may come out of each inlet."""
        from .particles import reserve_inlet_particles

        return reserve_inlet_particles(scene)

    def plan(self, draft: Any, prepared: Any) -> tuple[Any, Any]:
        """Return the plan of the inlets and outlets, or None without any, and the draft as it is.

        Args:
            draft, prepared: See `SceneFeature.plan`.
        """
        if not self.changes_mass(draft.scene):
            return None, draft
        from .plan import plan_inlets_outlets

        return plan_inlets_outlets(draft), draft


FEATURE = InletsOutlets()
