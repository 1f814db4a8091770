"""Laws written as plain Python, made callable from compiled kernels.

A kernel calls `stress(law, state, L)`; which material's function that is, the type of `law` decides
when the kernel is compiled. Called from plain Python the same names look the material up.
"""

import inspect
import sys

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, overload, register_jitable

from ..device import eigen, flow, hencky, tait, tensor
from ..device import jit as _jit  # noqa: F401  (sets numba's cache folder first)
from ..materials import registry
from ..materials.base import function, law_owner, state_channels
from . import functions as _functions  # noqa: F401  (defines exp and its kin for lanes
from .lanes import OF, address, in_all_lanes


def make_callable(module) -> None:
    """Let compiled code call the plain functions of a module."""
    for plain in vars(module).values():
        if inspect.isfunction(plain) and plain.__module__ == module.__name__:
            # in line: vectors handed over in memory cost more than the arithmetic
            register_jitable(forceinline=True)(plain)


_materials = [sys.modules[_material.__module__] for _material in registry.values()]
for _module in (tensor, eigen, hencky, flow, tait, *dict.fromkeys(_materials)):
    make_callable(_module)

# a compiled function called from Python tells two NamedTuples with equal fields apart by the name
# of their class alone: two that are called Law it would run with one material's code
for _material in registry.values():
    _material.Law.__name__ = f"{_material.__name__}Law"


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


@intrinsic
def _tuple_from_column(typing, law, f, row, p):
    numbers = types.UniTuple(f.dtype, state_channels(law.instance_class))

    def build(context, builder, signature, arguments):
        array = context.make_array(f)(context, builder, arguments[1])
        values = []
        for c in range(numbers.count):
            place = builder.add(arguments[2], ir.Constant(arguments[2].type, c))
            here = cgutils.get_item_pointer(context, builder, f, array, [place, arguments[3]])
            values.append(context.unpack_value(builder, f.dtype, here))
        return context.make_tuple(builder, numbers, values)

    return numbers(law, f, types.intp, types.intp), build


@overload(load_state, strict=False)
def _load_state(law, f, row, p):
    return _owner(law) and (lambda law, f, row, p: _tuple_from_column(law, f, row, p))


def _channel(context, builder, array_type, array, at, cap, c, lanes):
    """Pointer to 16 numbers of channel c."""
    first = builder.add(at, builder.mul(cap, ir.Constant(cap.type, c)))
    place = address(context, builder, array_type, array, first)
    return builder.bitcast(place, lanes.vector.as_pointer())


def lane_state(law, f, at, cap):
    """The state of 16 particles from a flat array, channels `cap` numbers apart: vectors."""
    raise TypeError("for compiled kernels only")


@intrinsic
def _load_channels(typing, law, f, at, cap):
    lanes = OF[f.dtype]
    vectors = types.UniTuple(lanes, state_channels(law.instance_class))

    def build(context, builder, signature, arguments):
        loaded = [
            builder.load(
                _channel(context, builder, f, *arguments[1:], c, lanes),
                align=lanes.real.bitwidth // 8,
            )
            for c in range(vectors.count)
        ]
        return context.make_tuple(builder, vectors, loaded)

    return vectors(law, f, types.intp, types.intp), build


@overload(lane_state, strict=False)
def _lane_state(law, f, at, cap):
    return _owner(law) and (lambda law, f, at, cap: _load_channels(law, f, at, cap))


def store_state(f, at, cap, state):
    """Inverse of `lane_state`."""
    raise TypeError("for compiled kernels only")


@intrinsic
def _store_channels(typing, f, at, cap, state):
    lanes = OF[f.dtype]

    def build(context, builder, signature, arguments):
        for c, value in enumerate(cgutils.unpack_tuple(builder, arguments[3], state.count)):
            vector = in_all_lanes(context, builder, state.types[c], lanes, value)
            place = _channel(context, builder, f, *arguments[:3], c, lanes)
            builder.store(vector, place, align=lanes.real.bitwidth // 8)
        return context.get_dummy_value()

    return types.void(f, types.intp, types.intp, state), build


@overload(store_state, strict=False)
def _store_state(f, at, cap, state):
    return lambda f, at, cap, state: _store_channels(f, at, cap, state)
