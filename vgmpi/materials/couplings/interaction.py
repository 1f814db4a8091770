"""Base of all couplings: tables of a scene that say how two materials or objects interact.

A coupling names its `kind` (a Literal) and the two it is `between`. Its `rule` says how the phases
of the two interact, `refuses` why it cannot couple two materials.
"""

from typing import NamedTuple, TypeVar, get_args

import numpy as np

from vgmpi.runtime.config.schema import StrictModel

CONTACT, MIXING, DRAG = 0, 1, 2  # interaction of two phases
RULES = ("contact", "mixing", "drag")

registry: dict[str, type[StrictModel]] = {}
CouplingClass = TypeVar("CouplingClass", bound=StrictModel)


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

    def _of_phases(self, mixes: np.ndarray) -> np.ndarray:
        """Map (mixes,) bool of the mixing groups to (n,) of the phases, False for all others."""
        return np.append(mixes, False)[self.mix]  # index -1 reads the appended False


def coupling(cls: type[CouplingClass]) -> type[CouplingClass]:
    """Register a coupling's table under its kind."""
    kind = get_args(cls.model_fields["kind"].annotation)[0]
    if kind in registry:
        raise TypeError(f"two couplings call themselves {kind!r}")
    registry[kind] = cls
    return cls
