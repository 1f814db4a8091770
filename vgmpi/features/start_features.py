"""Features of a run, in the order in which they act; it is part of the results."""

from importlib import import_module

from vgmpi.scene import scene_feature

from .active_feature import ActiveFeature, StartContext

# Features that are not in FEATURES yet: name in Simulation.features -> module and function that
# starts it; None marks the places of features of a plan between these
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


def order_of_features() -> list[str]:
    """Return the names of all features in the order in which they act.

    One of FEATURES that has no place in STARTS acts before the next that has one, or last.
    """
    order = list(STARTS)
    following = len(order)
    for name in reversed(scene_feature.FEATURES):
        if name in STARTS:
            following = order.index(name)
        else:
            order.insert(following, name)
    return order


def start_features(context: StartContext, features: dict[str, ActiveFeature]) -> None:
    """Start the features of a plan on this rank, in their order.

    Args:
        context: What they may take.
        features: The features by name (out).
    """
    plans = {plan.name: plan for plan in context.plan.features}
    row = context.first_reaction_row
    for name in order_of_features():
        feature = None
        if place := STARTS.get(name):
            module, function = place
            feature = getattr(import_module(f"vgmpi.features.{module}"), function)(context)
        elif name in plans:
            feature = plans[name].start(context._replace(first_reaction_row=row))
            row += len(plans[name].reaction_bodies())
        if feature is not None:
            features[name] = feature
