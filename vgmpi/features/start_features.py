"""Features of a run, in the order in which they act; it is part of the results."""

from importlib import import_module

from .active_feature import ActiveFeature, StartContext

# name in Simulation.features -> module and function that starts it
BEFORE_FEATURES_OF_PLAN = {
    "flow_accounting": ("inlets_outlets.flow_accounting", "start"),
    "loads": ("loads.coupling", "start"),
    "moving_colliders": ("moving_colliders.coupling", "start"),
    "implicit_pressure": ("implicit_pressure.coupling", "start"),
    "collider_slip": ("surface_slip.coupling", "start_collider_slip"),
    "solid_slip": ("surface_slip.coupling", "start_solid_slip"),
}
AFTER_FEATURES_OF_PLAN = {
    "rigid_bodies": ("rigid_bodies.coupling", "start"),
    "prescribed_motion": ("prescribed_motion.coupling", "start"),
    "reactions": ("reactions.coupling", "start"),
    "inlets": ("inlets_outlets.coupling", "start_inlets"),
    "outlets": ("inlets_outlets.coupling", "start_outlets"),
    "releases": ("releases.coupling", "start"),
    "thin_walls": ("thin_walls.coupling", "start"),
}


def start_features(context: StartContext, features: dict[str, ActiveFeature]) -> None:
    """Start the features of a plan on this rank.

    Args:
        context: What they may take.
        features: The features by name (out).
    """
    _start(BEFORE_FEATURES_OF_PLAN, context, features)
    row = context.first_reaction_row
    for plan in context.plan.features:
        features[plan.name] = plan.start(context._replace(first_reaction_row=row))
        row += len(plan.reaction_bodies())
    _start(AFTER_FEATURES_OF_PLAN, context, features)


def _start(places: dict[str, tuple[str, str]], context: StartContext, features: dict) -> None:
    for name, (module, function) in places.items():
        start = getattr(import_module(f"vgmpi.features.{module}"), function)
        if (feature := start(context)) is not None:
            features[name] = feature
