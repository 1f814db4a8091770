"""Interaction rules: phases that share space, and the scene's couplings as kernels read them."""

from typing import NamedTuple

import numpy as np

from vgmpi.materials.couplings.interaction import DRAG, MIXING
from vgmpi.materials.material import law_function
from vgmpi.planning.feature_plan import SlipRelaxation
from vgmpi.planning.phases_and_groups import GroupPlan, connected_sets
from vgmpi.scene.scene import Scene

WAVE_MARGIN = (
    1.25  # [-] squared wave speed over the fastest fluid's own that the step's margin bears
)
FRACTION_SAMPLES = 1001  # number of volume fractions at which the waves of two fluids are evaluated
WAVE_ITERATIONS = 60  # iterations for the wave speed and its step; each halves the error


class InteractionRules(NamedTuple):
    """Interaction rules of the phases, for the kernels; rows and columns are phases.

    A mixture set holds phases that share space: fluids that mix, sands with fluids in their pores.
    """

    pair: np.ndarray  # (n, n) CONTACT, MIXING or DRAG
    mixture_set: np.ndarray  # (n,) mixture set, or -1
    sets: int  # number of mixture sets
    fluid: np.ndarray  # (n,) whether it is a fluid
    mix: np.ndarray  # (n,) mixing group, or -1
    mixing_group_count: int  # number of mixing groups
    diffusion: np.ndarray  # (mixes,) [m2/s]
    slip_relaxation_time: np.ndarray  # (mixes,) [s]
    drag: np.ndarray  # (n, n) [kg/(m3 s)] drag coefficient, 0 where there is none
    porosity: np.ndarray  # (n,) [-] volume fraction of pores in a sand
    has_drag: bool  # whether a fluid flows through sand
    volume: np.ndarray  # (n,) [m3/kg] specific volume of a sand's grains
    printed_mix: np.ndarray  # (mixes,) bool: mixing as published
    printed_drag: np.ndarray  # (n, n) bool: drag as published

    @property
    def drifting(self) -> np.ndarray:
        """Return the phases that drift by diffusion, as published or not: (n,) bool."""
        return self._of_phases(self.diffusion > 0.0)

    @property
    def conservative_drift(self) -> np.ndarray:
        """Return the phases whose drift is kept out of their momentum: (n,) bool.

        As published it is part of the momentum.
        """
        return self._of_phases((self.diffusion > 0.0) & ~np.asarray(self.printed_mix, bool))

    @property
    def phase_sets(self) -> np.ndarray:
        """Return the mixing group of phases without slip, which share one velocity, or -1: (n,)."""
        still = (np.asarray(self.slip_relaxation_time) == 0.0) & ~np.asarray(self.printed_mix, bool)
        return np.where(self._of_phases(still), self.mix, -1)

    @property
    def slip_relaxation(self) -> SlipRelaxation:
        """Return the relaxation of the relative motion of fluids that mix."""
        times = np.append(self.slip_relaxation_time, np.inf)  # -1 is the last
        return SlipRelaxation(self.mix, times[self.mix])

    def _of_phases(self, mixes: np.ndarray) -> np.ndarray:
        """Map (mixes,) bool of the mixing groups to (n,) of the phases, False for all others."""
        return np.append(mixes, False)[self.mix]  # index -1 reads the appended False


def interaction_rules(scene: Scene, groups, phases) -> InteractionRules | None:
    """Return the interaction rules of a scene, None if no phases share space.

    Raises SceneError if fluids that mix have one velocity field, a mixture has more than one
    diffusion coefficient or slip time, or frames shall have fractions without mixtures. `groups`
    and `phases` are those of phases_and_groups.py.
    """
    couplings = [(k, c) for k, c in enumerate(scene.coupling) if c.rule in (MIXING, DRAG)]
    if not couplings:
        _reject_fractions(scene)
        return None
    n = len(phases)
    pair, drag = np.zeros((n, n), np.int64), np.zeros((n, n))
    printed = np.zeros((n, n), bool)
    phases_by_material: dict[str, list[int]] = {}
    for group in groups:
        phases_by_material.setdefault(group.material, []).append(group.phase)
    pairs = []
    _one_sand_per_phase(scene, couplings, groups, phases_by_material)
    for k, coupling in couplings:
        for a in phases_by_material.get(coupling.between[0], []):
            for b in phases_by_material.get(coupling.between[1], []):
                if a == b:
                    message = "both share one velocity field: give them no phase, or different ones"
                    raise scene.error([(("coupling", k, "between"), message)])
                pair[a, b] = pair[b, a] = coupling.rule
                pairs.append((a, b))
                if coupling.rule == DRAG:
                    drag[a, b] = drag[b, a] = _coefficient(scene, coupling)
                    printed[a, b] = printed[b, a] = coupling.printed
    if not pairs:
        _reject_fractions(scene)  # the couplings name materials that no body has
        return None
    fluid = np.array([phase.families == ("fluid",) for phase in phases])
    mix = connected_sets(n, [p for p in pairs if pair[p] == MIXING])
    together = connected_sets(n, pairs)
    # Fluids in the same sand share its pores and the pore pressure.
    numbers = _mixing_numbers(scene, couplings, phases_by_material, mix)
    porosity, volume = np.zeros(n), np.zeros(n)
    for group in groups:
        porosity[group.phase] = getattr(scene.material[group.material], "porosity", 0.0)
        volume[group.phase] = group.share / group.density
    return InteractionRules(
        pair=pair,
        mixture_set=together,
        sets=int(together.max()) + 1,
        fluid=fluid,
        mix=mix,
        mixing_group_count=int(mix.max()) + 1,
        diffusion=np.array([d for d, _, _ in numbers]),
        slip_relaxation_time=np.array([t for _, t, _ in numbers]),
        drag=drag,
        porosity=porosity,
        has_drag=bool(drag.any()),
        volume=volume,
        printed_mix=np.array([p for _, _, p in numbers], bool),
        printed_drag=printed,
    )


def rules_without_drag(rules: InteractionRules) -> InteractionRules:
    """Return the rules of the mixtures of fluids alone, without the sands that they flow through.

    Args:
        rules: Rules of all.
    """
    return rules._replace(mixture_set=rules.mix, sets=rules.mixing_group_count, has_drag=False)


def _reject_fractions(scene: Scene) -> None:
    """Reject volume fractions in the frames of a scene without mixtures."""
    if "volume_fraction" in scene.output.fields:
        path = "output", "fields", scene.output.fields.index("volume_fraction")
        message = (
            "volume_fraction needs two materials that share space: a [[coupling]] of kind mixing or"
            " drag between materials that bodies have"
        )
        raise scene.error([(path, message)])


def _coefficient(scene: Scene, coupling) -> float:
    """Return the drag coefficient of a coupling of sand and fluid."""
    a, b = (scene.material[name] for name in coupling.between)
    sand, fluid = (a, b) if a.family == "sand" else (b, a)
    return coupling.coefficient(sand.porosity, fluid.density)


def _one_sand_per_phase(scene: Scene, couplings, groups, phases_by_material) -> None:
    """Reject different sands in one velocity field that a fluid flows through.

    A node knows their grains by mass alone.
    """
    makes: dict[int, set] = {}
    for group in groups:
        makes.setdefault(group.phase, set()).add((group.share, group.density))
    for k, coupling in couplings:
        for name in coupling.between:
            if coupling.rule == DRAG and scene.material[name].family == "sand":
                if any(len(makes[phase]) > 1 for phase in phases_by_material.get(name, [])):
                    message = (
                        "its velocity field holds sand of another density or porosity as well:"
                    )
                    message += " give the objects of each a phase of its own"
                    raise scene.error([(("coupling", k, "between"), f"{name!r}: {message}")])


def _mixing_numbers(
    scene: Scene, couplings, phases_by_material, mix
) -> list[tuple[float, float, bool]]:
    """Return (diffusion, slip time, as printed) of each mixing group."""
    by_group: dict[int, tuple[float, float, bool]] = {}
    for k, coupling in couplings:
        if coupling.rule != MIXING:
            continue
        numbers = coupling.diffusivity, coupling.slip_relaxation_time, coupling.printed
        for phase in phases_by_material.get(coupling.between[0], []):
            if by_group.setdefault(int(mix[phase]), numbers) != numbers:
                message = "fluids that mix with one another must have the same numbers and kind"
                raise scene.error([(("coupling", k), message)])
    return [by_group[group] for group in sorted(by_group) if group >= 0]


def with_slip_wave_factors(
    groups: tuple[GroupPlan, ...], rules: InteractionRules, step_length: float
) -> tuple[GroupPlan, ...]:
    """Return the groups with the factor by which slip in a mixture raises the squared wave speed.

    The factor is relative to the group's own squared wave speed at rest. It is 1 if no wave is much
    faster than those of the fluids alone, and 1 for all but the stiffer of two fluids
    (docs/explanation/mixtures.md).

    Args:
        groups: Groups of the plan.
        rules: Interaction rules.
        step_length: Distance that a wave may travel in a step [m].
    """
    factors = [1.0] * len(groups)
    slip_relaxation_time = np.append(
        np.where(rules.printed_mix, 0.0, rules.slip_relaxation_time), 0.0
    )  # -1 is the last
    mixture_of = [int(rules.mix[g.phase]) for g in groups]
    free = [k for k, mix in enumerate(mixture_of) if slip_relaxation_time[mix] > 0.0]
    own = {k: _wave2(groups[k]) for k in free}
    ends = {k: (groups[k].density, own[k]) for k in free}
    for k in free:
        for m in free:
            if mixture_of[m] == mixture_of[k] and np.prod(ends[k]) > np.prod(ends[m]):
                fastest = _slipping_waves(
                    ends[k], ends[m], slip_relaxation_time[mixture_of[k]], step_length
                )
                if fastest > WAVE_MARGIN * max(own[k], own[m]):
                    factors[k] = max(factors[k], fastest / own[k])
    return tuple(
        g._replace(wave=g.wave._replace(factor=s)) for g, s in zip(groups, factors, strict=True)
    )


def _wave2(group) -> float:
    """Return the squared wave speed of a group at rest [m2/s2]."""
    return float(law_function(group.law, "wave_speed2")(group.law, group.reference))


def _slipping_waves(first, second, slip_relaxation_time: float, step_length: float) -> float:
    """Return the largest squared wave speed [m2/s2], at any volume fractions, of two mixed fluids.

    Args:
        first: Density [kg/m3] and squared wave speed [m2/s2] of the first fluid alone.
        second: Density and squared wave speed of the second fluid alone.
        slip_relaxation_time: Relaxation time of the slip [s].
        step_length: Distance that a wave may travel in a step [m].
    """
    a = np.linspace(0.0, 1.0, FRACTION_SAMPLES)
    (d0, c0), (d1, c1) = first, second
    modulus = a * d0 * c0 + (1.0 - a) * d1 * c1
    mean = a * d0 + (1.0 - a) * d1
    together = modulus / mean
    separate = modulus * (a / d0 + (1.0 - a) / d1)
    speed2 = separate
    for _ in range(WAVE_ITERATIONS):  # descends to the slip within a step of step_length / speed
        step = step_length / np.sqrt(speed2)
        speed2 = together + (separate - together) / (1.0 + step / (2.0 * slip_relaxation_time))
    return float(speed2.max())
