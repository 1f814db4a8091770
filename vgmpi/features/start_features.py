"""Features of a run, in the order in which they act; it is part of the results."""

from importlib import import_module
from typing import NamedTuple

from vgmpi.scene import scene_feature

from .active_feature import ActiveFeature, StartContext


class Start(NamedTuple):
    """Start of what acts in a run and has no plan of its own."""

    module: str  # in vgmpi/features
    function: str
    following: str  # feature of the list before which it acts


# by name in Simulation.features: features that are not in FEATURES yet
STARTS = {
    "moving_colliders": Start("moving_colliders.coupling", "start", "implicit_pressure"),
    "prescribed_motion": Start("prescribed_motion.coupling", "start", "reactions"),
    "releases": Start("releases.coupling", "start", "thin_walls"),
}


def order_of_features() -> list[str]:
    """Return the names of all features in the order in which they act."""
    order = list(scene_feature.FEATURES)
    for name, start in STARTS.items():
        order.insert(order.index(start.following), name)
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
        if own := STARTS.get(name):
            module = import_module(f"vgmpi.features.{own.module}")
            feature = getattr(module, own.function)(context)
        elif name in plans:
            feature = plans[name].start(context._replace(first_reaction_row=row))
            row += len(plans[name].reaction_bodies())
        if feature is not None:
            features[name] = feature
