"""Features of a run, in the order in which they act; it is part of the results."""

from importlib import import_module

from .active_feature import ActiveFeature, StartContext

# name in Simulation.features -> module and function that starts it; None: its plan does
STARTS: dict[str, tuple[str, str] | None] = {
    "flow_accounting": ("inlets_outlets.flow_accounting", "start"),
    "loads": None,
    "moving_colliders": ("moving_colliders.coupling", "start"),
    "implicit_pressure": None,
    "surface_slip": None,
    "pinned_parts": None,
    "rigid_bodies": None,
    "prescribed_motion": ("prescribed_motion.coupling", "start"),
    "reactions": None,
    "inlets": ("inlets_outlets.coupling", "start_inlets"),
    "outlets": ("inlets_outlets.coupling", "start_outlets"),
    "releases": ("releases.coupling", "start"),
    "thin_walls": None,
}


def start_features(context: StartContext, features: dict[str, ActiveFeature]) -> None:
    """Start the features of a plan on this rank: those of STARTS, then the others by the plan.

    Args:
        context: What they may take.
        features: The features by name (out).
    """
    plans = {plan.name: plan for plan in context.plan.features}
    row = context.first_reaction_row
    for name in (*STARTS, *(name for name in plans if name not in STARTS)):
        feature = None
        if place := STARTS.get(name):
            module, function = place
            feature = getattr(import_module(f"vgmpi.features.{module}"), function)(context)
        elif name in plans:
            feature = plans[name].start(context._replace(first_reaction_row=row))
            row += len(plans[name].reaction_bodies())
        if feature is not None:
            features[name] = feature
