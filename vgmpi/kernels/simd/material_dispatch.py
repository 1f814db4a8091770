"""Material dispatch: laws in plain Python, callable from compiled kernels.

A kernel calls `stress(law, state, L)`; the type of `law` selects the material's function when the
kernel is compiled. Called from plain Python, the same names look up the material.
"""

import inspect
import sys

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from vgmpi.materials import registry
from vgmpi.materials.material import law_function, law_owner, state_channels
from vgmpi.materials.tensor_math import hencky, symmetric_eigen, tait, tensor, viscoplastic_flow
from vgmpi.runtime.jit import always_inline, overload

from . import math_functions  # noqa: F401  (defines exp and its kin for lanes
from .vector16 import VECTOR_OF, address, broadcast_value


def make_callable(module) -> None:
    """Register the plain functions of a module for compiled code."""
    for plain in vars(module).values():
        if inspect.isfunction(plain) and plain.__module__ == module.__name__:
            # Inlined: passing vectors in memory costs more than the arithmetic.
            always_inline(plain)


_materials = [sys.modules[_material.__module__] for _material in registry.values()]
for _module in (
    tensor,
    symmetric_eigen,
    hencky,
    viscoplastic_flow,
    tait,
    *dict.fromkeys(_materials),
):
    make_callable(_module)

# A compiled function called from Python distinguishes NamedTuples with equal fields only by class
# name: two classes called Law would run with the code of one material.
for _material in registry.values():
    _material.Law.__name__ = f"{_material.__name__}Law"


def _owner(law):
    """Return the material of a law's type, None for another type."""
    return law_owner(law.instance_class) if isinstance(law, types.BaseNamedTuple) else None


def advance(law, state, L, dt):
    """Return the state after a step.

    Args:
        law: Material law.
        state: State before the step.
        L: Velocity gradient [1/s].
        dt: Length of the step [s].
    """
    return law_function(law, "advance")(law, state, L, dt)


def stress(law, state, L):
    """Return the Kirchhoff stress [Pa]."""
    return law_function(law, "stress")(law, state, L)


def volume_ratio(law, state):
    """Return the volume ratio J."""
    return law_function(law, "volume_ratio")(law, state)


def wave_speed2(law, state):
    """Return the squared wave speed [m^2/s^2]."""
    return law_function(law, "wave_speed2")(law, state)


def energy(law, state):
    """Return the stored energy."""
    return law_function(law, "energy")(law, state)


def is_liquid(law):
    """Return whether a law is that of a liquid, known when a kernel is compiled."""
    return law_function(law, "is_liquid")(law)


@overload(is_liquid)
def _is_liquid(law):
    return _owner(law) and _owner(law).is_liquid


@overload(advance)
def _advance(law, state, L, dt):
    return _owner(law) and _owner(law).advance


@overload(stress)
def _stress(law, state, L):
    return _owner(law) and _owner(law).stress


@overload(volume_ratio)
def _volume_ratio(law, state):
    return _owner(law) and _owner(law).volume_ratio


@overload(wave_speed2)
def _wave_speed2(law, state):
    return _owner(law) and _owner(law).wave_speed2


@overload(energy)
def _energy(law, state):
    return _owner(law) and _owner(law).energy


def load_state_scalar(law, f, row, p):
    """Load the state of a particle as a tuple.

    Args:
        law: Material law, which fixes the length of the tuple.
        f: Channels, shape (channels, n).
        row: First channel of the state.
        p: Index of the particle.
    """
    return tuple(f[row + c, p] for c in range(state_channels(type(law))))


@intrinsic
def _tuple_from_column(typing, law, f, row, p):
    numbers = types.UniTuple(f.dtype, state_channels(law.instance_class))

    def _codegen(context, builder, signature, arguments):
        array = context.make_array(f)(context, builder, arguments[1])
        values = []
        for c in range(numbers.count):
            channel = builder.add(arguments[2], ir.Constant(arguments[2].type, c))
            pointer = cgutils.get_item_pointer(context, builder, f, array, [channel, arguments[3]])
            values.append(context.unpack_value(builder, f.dtype, pointer))
        return context.make_tuple(builder, numbers, values)

    return numbers(law, f, types.intp, types.intp), _codegen


@overload(load_state_scalar)
def _load_state(law, f, row, p):
    return _owner(law) and (lambda law, f, row, p: _tuple_from_column(law, f, row, p))


def _channel(context, builder, array_type, array, offset, cap, c, lanes):
    """Emit the pointer to 16 numbers of channel c."""
    first = builder.add(offset, builder.mul(cap, ir.Constant(cap.type, c)))
    pointer = address(context, builder, array_type, array, first)
    return builder.bitcast(pointer, lanes.vector.as_pointer())


def load_state_vector(law, f, first, cap):
    """Load the state of 16 particles as vectors.

    Args:
        law: Material law, which fixes the number of channels.
        f: Flat channel array, channels `cap` numbers apart.
        first: Index of the first particle.
        cap: Number of particles from one channel to the next.
    """
    raise TypeError("for compiled kernels only")


@intrinsic
def _load_channels(typing, law, f, first, cap):
    lanes = VECTOR_OF[f.dtype]
    vectors = types.UniTuple(lanes, state_channels(law.instance_class))

    def _codegen(context, builder, signature, arguments):
        loaded = [
            builder.load(
                _channel(context, builder, f, *arguments[1:], c, lanes),
                align=lanes.real.bitwidth // 8,
            )
            for c in range(vectors.count)
        ]
        return context.make_tuple(builder, vectors, loaded)

    return vectors(law, f, types.intp, types.intp), _codegen


@overload(load_state_vector)
def _lane_state(law, f, first, cap):
    return _owner(law) and (lambda law, f, first, cap: _load_channels(law, f, first, cap))


def store_state_vector(f, first, cap, state):
    """Store the state of 16 particles, the inverse of `load_state_vector`.

    Args:
        f: Flat channel array (out), channels `cap` numbers apart.
        first: Index of the first particle.
        cap: Number of particles from one channel to the next.
        state: Vectors or numbers.
    """
    raise TypeError("for compiled kernels only")


@intrinsic
def _store_channels(typing, f, first, cap, state):
    lanes = VECTOR_OF[f.dtype]

    def _codegen(context, builder, signature, arguments):
        for c, value in enumerate(cgutils.unpack_tuple(builder, arguments[3], state.count)):
            vector = broadcast_value(context, builder, state.types[c], lanes, value)
            pointer = _channel(context, builder, f, *arguments[:3], c, lanes)
            builder.store(vector, pointer, align=lanes.real.bitwidth // 8)
        return context.get_dummy_value()

    return types.void(f, types.intp, types.intp, state), _codegen


@overload(store_state_vector)
def _store_state(f, first, cap, state):
    return lambda f, first, cap, state: _store_channels(f, first, cap, state)
