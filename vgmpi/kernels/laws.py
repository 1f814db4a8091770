"""Laws written as plain Python, made callable from compiled kernels.

A kernel calls `stress(law, state, L)`; which material's function that is, the type of `law` decides
when the kernel is compiled. Called from plain Python the same names look the material up.
"""

from numba import types
from numba.extending import overload, register_jitable

from ..device import jit as _jit  # noqa: F401  (sets numba's cache folder first)
from ..device import tensor
from ..materials.base import function, law_owner, state_channels
from .lanes import load, store

for _name, _function in vars(tensor).items():
    if callable(_function) and not _name.startswith("_"):
        register_jitable(_function)


def _owner(law):
    return law_owner(law.instance_class) if isinstance(law, types.BaseNamedTuple) else None


def advance(law, state, L, dt):
    return function(law, "advance")(law, state, L, dt)


def stress(law, state, L):
    return function(law, "stress")(law, state, L)


def volume_ratio(law, state):
    return function(law, "volume_ratio")(law, state)


def wave_speed2(law, state):
    return function(law, "wave_speed2")(law, state)


def energy(law, state):
    return function(law, "energy")(law, state)


@overload(advance, strict=False)
def _advance(law, state, L, dt):
    return _owner(law) and _owner(law).advance


@overload(stress, strict=False)
def _stress(law, state, L):
    return _owner(law) and _owner(law).stress


@overload(volume_ratio, strict=False)
def _volume_ratio(law, state):
    return _owner(law) and _owner(law).volume_ratio


@overload(wave_speed2, strict=False)
def _wave_speed2(law, state):
    return _owner(law) and _owner(law).wave_speed2


@overload(energy, strict=False)
def _energy(law, state):
    return _owner(law) and _owner(law).energy


def load_state(law, f, row, p):
    """The particle's state, channels row.. of column p of f, as a tuple as long as the law carries
    numbers.
    """
    return tuple(f[row + c, p] for c in range(state_channels(type(law))))


def _load1(law, f, row, p):
    return (f[row, p],)


def _load9(law, f, row, p):
    return (
        f[row, p],
        f[row + 1, p],
        f[row + 2, p],
        f[row + 3, p],
        f[row + 4, p],
        f[row + 5, p],
        f[row + 6, p],
        f[row + 7, p],
        f[row + 8, p],
    )


_LOADS = {1: _load1, 9: _load9}


@overload(load_state, strict=False)
def _load_state(law, f, row, p):
    return _owner(law) and _LOADS[state_channels(law.instance_class)]


def lane_state(law, f, at, cap):
    """The state of 16 particles from a flat array, channels `cap` numbers apart: vectors."""
    raise TypeError("for compiled kernels only")


def _lanes1(law, f, at, cap):
    return (load(f, at),)


def _lanes9(law, f, at, cap):
    return (
        load(f, at),
        load(f, at + cap),
        load(f, at + 2 * cap),
        load(f, at + 3 * cap),
        load(f, at + 4 * cap),
        load(f, at + 5 * cap),
        load(f, at + 6 * cap),
        load(f, at + 7 * cap),
        load(f, at + 8 * cap),
    )


_LANE_LOADS = {1: _lanes1, 9: _lanes9}


@overload(lane_state, strict=False)
def _lane_state(law, f, at, cap):
    return _owner(law) and _LANE_LOADS[state_channels(law.instance_class)]


def store_state(f, at, cap, state):
    """Inverse of `lane_state`."""
    raise TypeError("for compiled kernels only")


@overload(store_state, strict=False)
def _store_state(f, at, cap, state):
    count = len(state)

    def put1(f, at, cap, state):
        store(f, at, state[0])

    def put9(f, at, cap, state):
        store(f, at, state[0])
        store(f, at + cap, state[1])
        store(f, at + 2 * cap, state[2])
        store(f, at + 3 * cap, state[3])
        store(f, at + 4 * cap, state[4])
        store(f, at + 5 * cap, state[5])
        store(f, at + 6 * cap, state[6])
        store(f, at + 7 * cap, state[7])
        store(f, at + 8 * cap, state[8])

    return {1: put1, 9: put9}[count]
