"""Message of a step that failed: object, particle and step, or the place of an overflow."""

from typing import Any

import numpy as np

from vgmpi.kernels.kernel_arguments import J_MAX, J_MIN
from vgmpi.kernels.step_records import StepReport
from vgmpi.kernels.transfer import g2p
from vgmpi.scene.sections import WALLS

FAILURE_MESSAGES = {
    g2p.INVALID_VOLUME: f"its volume ratio J left {J_MIN:g} .. {J_MAX:g} or is not a number",
    g2p.OUT_OF_DOMAIN: "it left the domain",
    g2p.CFL_EXCEEDED: "it would move more than a cell in one step",
    g2p.NOT_FINITE: "its velocity or stress is not a number",
}
FIELD_NAMES = {
    "momentum": "mass or momentum", "offsets": "volume", "impulses": "impulse",
    "shear": "velocity's gradient", "color": "color", "rest": "volume",
    "velocity": "velocity's gradient", "mean": "mean pressure", "particle": "pressure",
}  # fmt: skip


def failure_message(simulation: Any, report: StepReport) -> str:
    """Name the failed particle of lowest id or the first overflown block, on every rank.

    Args:
        simulation: Simulation after the step.
        report: Report of the step on this rank.
    """
    ranks, plan = simulation.ranks, simulation.plan
    rows = ranks.all_rows(np.array(report.failures, np.int64).reshape(-1, 2))
    when = f"step {simulation.step}, time {simulation.time:.6g} s"
    if len(rows):
        worst, reason = rows[np.argmin(rows[:, 0])]
        # an empty object begins where the next one does: take the one that has particles
        owner = int(simulation.object_of(np.array([worst]))[0])
        message = FAILURE_MESSAGES[int(reason)]
        if reason == g2p.OUT_OF_DOMAIN:
            message = _way_out(simulation, worst) or message
        return f"object {{{owner}}}, particle {worst}, {when}: {message}"
    fields = simulation.exchange.needs.layers
    local = [(*over.block, over.phase, fields.index(over.field)) for over in report.overflows]
    rows = ranks.all_rows(np.array(local, np.int64).reshape(-1, 5))
    if not len(rows):  # equal on all ranks
        departed = next(filter(None, (each.failure() for each in simulation.features.values())))
        return f"object {departed}, {when}: {FAILURE_MESSAGES[g2p.OUT_OF_DOMAIN]}"
    *block, phase, field = min(map(tuple, rows.tolist()))
    spot = ", ".join(f"{(4 * b + 0.5) * plan.dx:.4g}" for b in block)
    name = FIELD_NAMES.get(fields[field].split()[0], fields[field])
    return (
        f"phase '{plan.phases[phase].name}', near ({spot}) m, {when}: the {name} at a node"
        " is beyond what a sum can hold"
    )


def is_way_out(message: str) -> bool:
    """Return whether a message tells of a body that left the domain: no number has grown."""
    return FAILURE_MESSAGES[g2p.OUT_OF_DOMAIN] in message


def _way_out(simulation: Any, particle: int) -> str:
    """Return how a particle left the domain through a wall, or an empty text; on every rank."""
    plan, local = simulation.plan, []
    for group in simulation.groups:
        index = group.index()
        for x in group.positions_at(index[group.ids[index] == particle]):
            beyond = np.stack([-x, x - np.array(plan.cells) * plan.dx], -1)
            local.append(int(np.argmax(beyond)))
    walls = simulation.ranks.all_rows(np.array(local, np.int64).reshape(-1, 1))
    if not len(walls):
        return ""
    wall = int(walls[0, 0])
    kind, _ = plan.walls.solids[wall]
    if kind == "open":
        return ""
    return f"{FAILURE_MESSAGES[g2p.OUT_OF_DOMAIN]}: it sank through the {WALLS[wall]} wall"
