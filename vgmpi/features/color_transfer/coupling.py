"""Color transfer as it acts in a run: nodal fields, colors of new particles and of frames."""

from typing import Any

import numpy as np

from vgmpi.features.active_feature import ActiveFeature
from vgmpi.features.field_request import CarriedValues, FieldRequest
from vgmpi.features.particle_insertion import ParticleRows
from vgmpi.kernels.nodal_fields import carried_values
from vgmpi.parallel.particle_group import ParticleGroup
from vgmpi.planning.phases_and_groups import GroupPlan
from vgmpi.planning.plan import Plan

from .plan import CHANNEL, ColorExchange, count_of


class ColorTransfer(ActiveFeature):
    """Colors that travel with the steps."""

    def __init__(self, exchange: ColorExchange):
        """Take the exchange."""
        self.exchange = exchange

    def channel_values(self, group: GroupPlan, rows: ParticleRows) -> dict[str, np.ndarray]:
        """Return the colors of new particles, shape (n, 3 K).

        Args:
            group, rows: See `ActiveFeature.channel_values`.
        """
        count = count_of(group)
        if not count or rows.sh is None:
            return {}
        missing = max(count - rows.sh.shape[1], 0)
        sh = np.pad(rows.sh[:, :count], ((0, 0), (0, missing), (0, 0)))
        values = sh - self.exchange.minimum[group.phase, :count]
        return {CHANNEL: values.reshape(len(values), 3 * count)}

    def frame_rows(self, group: ParticleGroup, indices: np.ndarray) -> dict[str, np.ndarray]:
        """Return the coefficients (n, 3 K), K the largest count of any group; NaN without color.

        Args:
            group, indices: See `ActiveFeature.frame_rows`.
        """
        exchange, count = self.exchange, 3 * count_of(group.plan)
        rows = np.full((len(indices), 3 * exchange.coefficients.max()), np.nan, np.float32)
        if count:
            offset = exchange.minimum[group.plan.phase].ravel()[:count]
            rows[:, :count] = group.get(CHANNEL, indices) + offset
        return {"color_sh": rows}


def request_color(plan: Plan, exchange: ColorExchange, coefficient: int) -> FieldRequest:
    """Return the request for the nodal field of a color coefficient.

    Args:
        plan: The plan.
        exchange: Colors that travel.
        coefficient: Number of the coefficient.
    """
    span = exchange.span[:, coefficient]

    def channel(group: GroupPlan) -> int:
        """Return the first channel of the values of a group."""
        return group.channels.first(CHANNEL) + 3 * coefficient

    def kind(group: GroupPlan) -> Any:
        """Return the contribution of a group, or None."""
        has_value = coefficient < count_of(group) and not group.carrier
        return carried_values.kind(plan, channel(group)) if has_value else None

    return FieldRequest(
        f"color {coefficient}", lambda _: carried_values.accumulator_range(plan, span), kind,
        carried=CarriedValues(exchange.set_of, channel),
    )  # fmt: skip
