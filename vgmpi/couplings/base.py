"""What a coupling is: a table of the scene that says how two materials or objects act on each
other.

A coupling names its `kind` (a Literal) and the two it is `between`. Its `rule` says how the phases
of the two act on each other, `refuses` why two materials cannot be coupled by it.
"""

from typing import NamedTuple, get_args

import numpy as np

CONTACT, MIXING, DRAG = 0, 1, 2  # how two phases act on each other
RULES = ("contact", "mixing", "drag")

registry: dict[str, type] = {}


class Rules(NamedTuple):
    """How phases act on each other, as kernels read it; rows and columns are phases.

    A set holds phases that share space: fluids that mix, sands that fluids flow through.
    """

    pair: np.ndarray  # (n, n) CONTACT, MIXING or DRAG
    together: np.ndarray  # (n,) the set, or -1
    sets: int
    fluid: np.ndarray  # (n,) whether it is a fluid
    mix: np.ndarray  # (n,) mixing group, or -1
    mixes: int
    diffusion: np.ndarray  # (mixes,) [m2/s]
    slip_time: np.ndarray  # (mixes,) [s]
    drag: np.ndarray  # (n, n) coefficient of drag [kg/(m3 s)], 0 where there is none
    porosity: np.ndarray  # (n,) share of pores in a sand's bulk volume
    drags: bool  # whether a fluid flows through sand
    volume: np.ndarray  # (n,) [m3/kg] of a sand's grains
    printed_mix: np.ndarray  # (mixes,) bool: as the paper prints it
    printed_drag: np.ndarray  # (n, n) bool

    @property
    def drifting(self) -> np.ndarray:
        """Phases that drift by diffusion, as the paper prints it or not: (n,) bool."""
        return self._of_phases(self.diffusion > 0.0)

    @property
    def drifting_apart(self) -> np.ndarray:
        """Those whose drift is kept out of their momentum; as printed it is not: (n,) bool."""
        return self._of_phases((self.diffusion > 0.0) & ~np.asarray(self.printed_mix, bool))

    @property
    def as_one(self) -> np.ndarray:
        """The mixing group of phases that have one velocity, no slip is left in it; -1 of others:
        (n,)."""
        still = (np.asarray(self.slip_time) == 0.0) & ~np.asarray(self.printed_mix, bool)
        return np.where(self._of_phases(still), self.mix, -1)

    def _of_phases(self, mixes: np.ndarray) -> np.ndarray:
        """(mixes,) bool of the mixing groups as (n,) of the phases, False for those in none."""
        return np.append(mixes, False)[self.mix]  # -1 is the last


def coupling(cls: type) -> type:
    """Register a coupling's table under its kind."""
    kind = get_args(cls.model_fields["kind"].annotation)[0]
    if kind in registry:
        raise TypeError(f"two couplings call themselves {kind!r}")
    registry[kind] = cls
    return cls
