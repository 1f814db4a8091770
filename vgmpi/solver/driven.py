"""What is let go: bodies that were driven, whose particles join the groups in which they go on by
themselves, and what walls held that vanish."""

import numpy as np

from ..domain.migrate import arrive
from ..domain.ranks import Alone
from ..domain.state import Group
from ..engines.base import Engine
from ..materials.base import function
from ..planning.driven import DrivenPlan, Layer
from ..planning.plan import Plan
from ..scene.motion import Course, Courses, turning
from .enter import bounds
from .sinks import remove
from .tally import Tally

SAME = 1.0 + 1e-12  # times that differ by less are one


class Releases:
    """What a run lets go, and when: by the time alone, so that all ranks do it together. A sort
    must follow."""

    def __init__(self, plan: Plan, tally: Tally | None, engine: Engine):
        self.plan, self.tally, self.engine = plan, tally, engine
        self.layers = sorted(
            ((layer, one) for one in plan.driven for layer in one.layers),
            key=lambda pair: pair[0].time,
        )

    def next(self, time: float) -> float:
        """When something is let go after a time [s]; infinite where nothing is."""
        times = [layer.time for layer, _ in self.layers]
        times += [opens for opens in self.plan.opens if opens is not None]
        return min((one for one in times if one > time * SAME), default=np.inf)

    def open_walls(self, time: float) -> None:
        """Open the walls that have vanished by a time [s]."""
        for wall, opens in enumerate(self.plan.opens):
            if opens is not None and opens <= time * SAME:
                self.engine.open(wall)

    def ahead(self, time: float, goal: float) -> float:
        """The time [s] up to `goal` at which steps must land next after a time."""
        found = self.next(time)
        return found if found * SAME < goal else goal

    def due(self, before: float, time: float) -> bool:
        """Whether something is let go after `before`, up to and with `time` [s]."""
        return self.next(before) <= time * SAME

    def let_go(self, groups: list[Group], before: float, time: float, ranks: Alone) -> np.ndarray:
        """Let go what is due. Returns what bounds the steps and sums of it, (4,) as of
        enter.bounds, on every rank. Collective."""
        found = np.zeros(4)
        self.open_walls(time)
        for layer, one in self.layers:
            if before * SAME < layer.time <= time * SAME:
                found = np.maximum(found, self._let_go(groups, layer, one))
        return ranks.max(found)

    def _let_go(self, groups: list[Group], layer: Layer, one: DrivenPlan) -> np.ndarray:
        group, joins = groups[one.group], groups[one.joins]
        at = group.index()
        height = group.positions_at(at)[:, 2]
        at = at[(layer.low <= height) & (height < layer.high)]
        if not len(at):
            return np.zeros(4)
        if one.course is not None:
            _set_off(group, at, one.course, layer.time)
        block = group.block[group.segment_of(at)]
        xi, f, ids = group.xi[:, at], group.f[:, at], group.ids[at]  # what is read is a copy
        found = _bounds(self.plan, group, at)
        remove(group, at)
        arrive(joins, block, xi, f, ids)
        if self.tally is not None:
            volume = f[group.plan.channels["vol0"].first]
            self.tally.goes_over(one.group, one.joins, volume)
        return found


def _set_off(group: Group, at: np.ndarray, course: Course, time: float) -> None:
    """Give the particles at `at` (n,) the velocity that their motion has when it ends."""
    v, spin = course.rates(time)
    move = Courses([course]).poses(time)[1][0]
    x = group.positions_at(at) - (np.array(course.about) + move)
    group.put("v", at, v + np.cross(spin, x))
    group.put("C", at, np.tile(turning(spin), (len(at), 1)))


def _bounds(plan: Plan, group: Group, at: np.ndarray) -> np.ndarray:
    """As of enter.bounds, of the particles at `at` (n,)."""
    law, state = group.plan.law, group.law_state(at)
    wave2 = np.broadcast_to(function(law, "wave_speed2")(law, state), len(at))
    tau = np.abs(np.stack(np.broadcast_arrays(*function(law, "stress")(law, state, (0.0,) * 9))))
    worst = {int(np.argmax(wave2)), int(np.argmax(np.broadcast_to(tau.sum(0), len(at))))}
    states = [tuple(row[k] for row in state) for k in sorted(worst)]
    return bounds(plan, group.plan, states, group.get("v", at), group.get("C", at))
