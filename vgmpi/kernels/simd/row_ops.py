"""Vector operations on fixed-point positions, records, rows and planes of nodes.

A row is four nodes along z with four numbers each, abcd abcd abcd abcd, in one vector of 16; after
the transfer it is xyzm xyzm xyzm xyzm, a vector and a number per node. A particle touches nine
rows; the fourth node of each has weight 0 and must hold finite numbers. A record is 16 numbers of
one particle; 16 records are 16 vectors transposed. A plane is the 4 x 4 numbers of a block at one
x, four numbers along z for each y.
"""

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from vgmpi.runtime.cpu_features import vector_bytes

from .vector16 import SIMD_WIDTH, VECTOR_OF, VectorType, address, broadcast_value, call

_I32 = ir.IntType(32)
# Whether records are transposed four numbers at a time: registers are narrower than 64 bytes.
QUARTERS = vector_bytes() < 64
_FOURTH = [4 * (k // 4) + 3 for k in range(SIMD_WIDTH)]
_BLEND = [
    k if k % 4 < 3 else SIMD_WIDTH + k for k in range(SIMD_WIDTH)
]  # first three of a, fourth of b
EDGE = 4


def _mask(lanes) -> ir.Constant:
    return ir.Constant(ir.VectorType(_I32, len(lanes)), list(lanes))


def _vector_at(builder, pointer, lanes: VectorType, count: int = SIMD_WIDTH):
    return builder.bitcast(pointer, ir.VectorType(lanes.vector.element, count).as_pointer())


def _align(lanes: VectorType) -> int:
    return lanes.real.bitwidth // 8


@intrinsic
def broadcast(typing, example, value):
    """Broadcast a number to all lanes; `example` is an array of the precision."""
    lanes = VECTOR_OF[example.dtype]

    def _codegen(context, builder, signature, arguments):
        return broadcast_value(context, builder, signature.args[1], lanes, arguments[1])

    return lanes(example, value), _codegen


def _constant(values):
    """Return the typing function of a fixed vector in the precision of an example array."""

    def _typing_function(typing, example):
        lanes = VECTOR_OF[example.dtype]

        def _codegen(context, builder, signature, arguments):
            return ir.Constant(lanes.vector, values)

        return lanes(example), _codegen

    return _typing_function


@intrinsic
def fourth(typing, example):
    """Return 0001 0000 0000 0000: the fourth number of a record."""
    return _constant([float(k == 3) for k in range(SIMD_WIDTH)])(typing, example)


@intrinsic
def diagonal(typing, example):
    """Return 0000 1000 0100 0010: slope 1 of the first number along x, second y, third z."""
    return _constant([float(k in (4, 9, 14)) for k in range(SIMD_WIDTH)])(typing, example)


def _four(pattern):
    """Return the typing function that loads four numbers into lanes by `pattern`."""

    def _typing_function(typing, array, first):
        lanes = VECTOR_OF[array.dtype]

        def _codegen(context, builder, signature, arguments):
            pointer = address(context, builder, signature.args[0], *arguments)
            four = builder.load(_vector_at(builder, pointer, lanes, 4), align=_align(lanes))
            return builder.shuffle_vector(four, four, _mask(pattern))

        return lanes(array, types.intp), _codegen

    return _typing_function


@intrinsic
def tile(typing, array, first):
    """Tile one quantity of all nodes of a row: abcd -> abcd abcd abcd abcd."""
    return _four([k % 4 for k in range(SIMD_WIDTH)])(typing, array, first)


def _slide(first):
    """Return the typing function of 16 lanes of two vectors in sequence, from lane `first` on."""

    def _typing_function(typing, low, high):
        def _codegen(context, builder, signature, arguments):
            return builder.shuffle_vector(*arguments, _mask(range(first, first + SIMD_WIDTH)))

        return low(low, high), _codegen

    return _typing_function


@intrinsic
def slide_back(typing, before, row):
    """Return the last node of the row before and the first three nodes of a row."""
    return _slide(12)(typing, before, row)


def _transposed(builder, vectors):
    """Emit the transpose of 16 vectors of 16 by four rounds of interleaving shuffles."""
    half = 1
    while half < SIMD_WIDTH:
        low = [k & ~half if not k & half else SIMD_WIDTH + (k & ~half) for k in range(SIMD_WIDTH)]
        high = [k | half if not k & half else SIMD_WIDTH + (k | half) for k in range(SIMD_WIDTH)]
        out = list(vectors)
        for i in range(SIMD_WIDTH):
            if not i & half:
                a, b = vectors[i], vectors[i | half]
                out[i] = builder.shuffle_vector(a, b, _mask(low))
                out[i | half] = builder.shuffle_vector(a, b, _mask(high))
        vectors = out
        half *= 2
    return vectors


_PAIRS = [
    k for c in range(0, SIMD_WIDTH, 4) for k in (c, SIMD_WIDTH + c, c + 1, SIMD_WIDTH + c + 1)
]
_HALVES = [
    k for c in range(0, SIMD_WIDTH, 4) for k in (c, c + 1, SIMD_WIDTH + c, SIMD_WIDTH + c + 1)
]


def _turned(builder, four):
    """Emit the transposes of the 4 x 4 blocks of four vectors, by shuffles in four lanes."""

    def _join(a, b, lanes, by):
        return builder.shuffle_vector(a, b, _mask([k + by for k in lanes]))

    a, b, c, d = four
    low, high = _join(a, b, _PAIRS, 0), _join(a, b, _PAIRS, 2)
    low_other, high_other = _join(c, d, _PAIRS, 0), _join(c, d, _PAIRS, 2)
    return [
        _join(first, second, _HALVES, by)
        for first, second in ((low, low_other), (high, high_other))
        for by in (0, 2)
    ]


def _put_whole(builder, pointer, lanes, vectors):
    """Store records transposed in registers: for processors whose registers hold a record."""
    for k, row in enumerate(_transposed(builder, vectors)):
        target = builder.gep(pointer, [ir.Constant(ir.IntType(64), SIMD_WIDTH * k)])
        builder.store(row, _vector_at(builder, target, lanes), align=_align(lanes))


def _put_quarters(builder, pointer, lanes, vectors):
    """Store four numbers of each record at a time, so that four vectors are live, not 16."""
    for q in range(0, SIMD_WIDTH, 4):
        target = builder.gep(pointer, [ir.Constant(ir.IntType(64), q)])
        _put_quarter(builder, target, lanes, vectors[q : q + 4])


def _put_quarter(builder, pointer, lanes, four):
    for k, turned in enumerate(_turned(builder, four)):
        for n in range(0, SIMD_WIDTH, 4):
            part = builder.shuffle_vector(turned, turned, _mask(range(n, n + 4)))
            target = builder.gep(pointer, [ir.Constant(ir.IntType(64), SIMD_WIDTH * (n + k))])
            builder.store(part, _vector_at(builder, target, lanes, 4), align=_align(lanes))


def _get_whole(builder, pointer, lanes):
    """Load records, the inverse of `_put_whole`."""
    rows = []
    for k in range(SIMD_WIDTH):
        source = builder.gep(pointer, [ir.Constant(ir.IntType(64), SIMD_WIDTH * k)])
        rows.append(builder.load(_vector_at(builder, source, lanes), align=_align(lanes)))
    return _transposed(builder, rows)


def _get_quarters(builder, pointer, lanes):
    """Load records, the inverse of `_put_quarters`."""
    vectors = []
    for q in range(0, SIMD_WIDTH, 4):
        four = []
        for k in range(4):
            quarters = []
            for n in range(0, SIMD_WIDTH, 4):
                source = builder.gep(
                    pointer, [ir.Constant(ir.IntType(64), SIMD_WIDTH * (n + k) + q)]
                )
                source = _vector_at(builder, source, lanes, 4)
                quarters.append(builder.load(source, align=_align(lanes)))
            while len(quarters) > 1:
                pairs = zip(quarters[::2], quarters[1::2], strict=True)
                both = _mask(range(8 if len(quarters) == 4 else 16))
                quarters = [builder.shuffle_vector(a, b, both) for a, b in pairs]
            four += quarters
        vectors += _turned(builder, four)
    return vectors


@intrinsic
def store_records(typing, array, first, vectors):
    """Store 16 vectors over particles as 16 records.

    Args:
        array, first, vectors: Array (out), index of its first number, and vectors.
    """
    lanes = VECTOR_OF[array.dtype]

    def _codegen(context, builder, signature, arguments):
        pointer = address(context, builder, signature.args[0], *arguments[:2])
        put = _put_quarters if QUARTERS else _put_whole
        put(builder, pointer, lanes, cgutils.unpack_tuple(builder, arguments[2], SIMD_WIDTH))
        return context.get_dummy_value()

    return types.void(array, types.intp, vectors), _codegen


@intrinsic
def store_quarter(typing, array, first, vectors):
    """Store 4 vectors over particles as 4 numbers of each of 16 records, 16 apart.

    Args:
        array, first, vectors: Array (out), index of its first number, and vectors.
    """
    lanes = VECTOR_OF[array.dtype]

    def _codegen(context, builder, signature, arguments):
        pointer = address(context, builder, signature.args[0], *arguments[:2])
        _put_quarter(builder, pointer, lanes, cgutils.unpack_tuple(builder, arguments[2], 4))
        return context.get_dummy_value()

    return types.void(array, types.intp, vectors), _codegen


@intrinsic
def load_records(typing, array, first):
    """Load 16 records as a tuple of 16 vectors, the inverse of `store_records`."""
    lanes = VECTOR_OF[array.dtype]
    tuple_type = types.UniTuple(lanes, SIMD_WIDTH)

    def _codegen(context, builder, signature, arguments):
        pointer = address(context, builder, signature.args[0], *arguments)
        get = _get_quarters if QUARTERS else _get_whole
        return context.make_tuple(builder, tuple_type, get(builder, pointer, lanes))

    return tuple_type(array, types.intp), _codegen


def _reals(row):
    return VECTOR_OF[types.float32 if row.dtype.bitwidth == 32 else types.float64]


def _integers_at(builder, pointer, lanes):
    return builder.bitcast(pointer, lanes.integer_vector.as_pointer())


def _bits(lanes) -> int:
    return 29 if lanes.real.bitwidth == 32 else 52


@intrinsic
def cell_fraction(typing, row, first):
    """Return the positions of 16 particles inside their cells, 0 to 1."""
    lanes = _reals(row)

    def _codegen(context, builder, signature, arguments):
        pointer = address(context, builder, signature.args[0], *arguments)
        x = builder.load(_integers_at(builder, pointer, lanes), align=_align(lanes))
        inside = builder.and_(x, lanes.integer((1 << _bits(lanes)) - 1))
        inside = builder.sitofp(inside, lanes.vector)
        return builder.fmul(inside, lanes.constant(2.0 ** -_bits(lanes)))

    return lanes(row, types.intp), _codegen


@intrinsic
def stencil_offset(typing, row, first, stride):
    """Return (cell + 3) stride of 16 positions as numbers (exact: they are small).

    Args:
        row, first, stride: Positions, index of the first, and factor.
    """
    lanes = _reals(row)

    def _codegen(context, builder, signature, arguments):
        pointer = address(context, builder, signature.args[0], *arguments[:2])
        x = builder.load(_integers_at(builder, pointer, lanes), align=_align(lanes))
        cell = builder.add(builder.ashr(x, lanes.integer(_bits(lanes))), lanes.integer(3))
        step = broadcast_value(context, builder, signature.args[2], lanes, arguments[2])
        return builder.fmul(builder.sitofp(cell, lanes.vector), step)

    return lanes(row, types.intp, stride), _codegen


@intrinsic
def store_int32(typing, array, first, values):
    """Store 16 numbers with integer values to an int32 array.

    Args:
        array, first, values: Array (out), index of its first number, and vector.
    """

    def _codegen(context, builder, signature, arguments):
        pointer = address(context, builder, signature.args[0], *arguments[:2])
        vector = ir.VectorType(_I32, SIMD_WIDTH)
        integers = builder.fptosi(arguments[2], vector)
        builder.store(integers, builder.bitcast(pointer, vector.as_pointer()), align=4)
        return context.get_dummy_value()

    return types.void(array, types.intp, values), _codegen


@intrinsic
def add_fixed_point(typing, row, first, distance):
    """Add 16 distances [2^-bits cells], rounded down, to positions; return them [cells].

    Args:
        row, first, distance: Positions (in/out), index of the first, and vector.
    """
    lanes = _reals(row)

    def _codegen(context, builder, signature, arguments):
        pointer = address(context, builder, signature.args[0], *arguments[:2])
        pointer = _integers_at(builder, pointer, lanes)
        x = builder.load(pointer, align=_align(lanes))
        step = call("llvm.floor")(builder, lanes, arguments[2])
        x = builder.add(x, builder.fptosi(step, lanes.integer_vector))
        builder.store(x, pointer, align=_align(lanes))
        return builder.fmul(builder.sitofp(x, lanes.vector), lanes.constant(2.0 ** -_bits(lanes)))

    return lanes(row, types.intp, distance), _codegen


@intrinsic
def max_ignore_nan(typing, a, b):
    """Return a where it is larger, else b (NaN in a is ignored), in one instruction, not four."""

    def _codegen(context, builder, signature, arguments):
        return builder.select(builder.fcmp_ordered(">", *arguments), *arguments)

    return a(a, b), _codegen


@intrinsic
def horizontal_max(typing, values):
    """Return the largest of 16 numbers."""

    def _codegen(context, builder, signature, arguments):
        name = f"llvm.vector.reduce.fmax.v{SIMD_WIDTH}f{values.real.bitwidth}"
        prototype = ir.FunctionType(values.vector.element, [values.vector])
        function = cgutils.get_or_insert_function(builder.module, prototype, name)
        return builder.call(function, [arguments[0]])

    return values.real(values), _codegen


@intrinsic
def velocity(typing, row, push, min_mass):
    """Convert momentum and mass of four nodes to velocity after `push`, and mass.

    A node whose mass is not above the minimum is at rest.

    Args:
        row: Momentum and mass of the nodes [kg m/s, kg].
        push: Velocity added to each node [m/s].
        min_mass: Minimum mass [kg].
    """

    def _codegen(context, builder, signature, arguments):
        row, push, min_mass = arguments
        mass = builder.shuffle_vector(row, row, _mask(_FOURTH))
        moved = builder.fadd(builder.fdiv(row, mass), push)
        heavy = builder.fcmp_ordered(">", mass, min_mass)
        moved = builder.select(heavy, moved, ir.Constant(row.type, [0.0] * SIMD_WIDTH))
        return builder.shuffle_vector(moved, row, _mask(_BLEND))

    return row(row, push, min_mass), _codegen


@intrinsic
def fourth_of(typing, row):
    """Broadcast the fourth number of each node to all its lanes: xyzm -> mmmm."""

    def _codegen(context, builder, signature, arguments):
        return builder.shuffle_vector(arguments[0], arguments[0], _mask(_FOURTH))

    return row(row), _codegen


@intrinsic
def with_fourth(typing, row, other):
    """Return the vectors of a row with the fourth numbers of another."""

    def _codegen(context, builder, signature, arguments):
        return builder.shuffle_vector(arguments[0], arguments[1], _mask(_BLEND))

    return row(row, row), _codegen


@intrinsic
def squared(typing, row):
    """Return x^2 + y^2 + z^2 of each node in all its lanes."""

    def _codegen(context, builder, signature, arguments):
        square = builder.fmul(arguments[0], arguments[0])
        x, y, z = (
            builder.shuffle_vector(
                square, square, _mask([4 * (k // 4) + c for k in range(SIMD_WIDTH)])
            )
            for c in range(3)
        )
        return builder.fadd(builder.fadd(x, y), z)

    return row(row), _codegen


def _shuffle_planes(lanes):
    """Return the typing function of lanes of two vectors in sequence."""
    mask = ir.Constant(ir.VectorType(ir.IntType(32), SIMD_WIDTH), list(lanes))

    def _typing_function(typing, first, second):
        def _codegen(context, builder, signature, arguments):
            return builder.shuffle_vector(*arguments, mask)

        return first(first, second), _codegen

    return _typing_function


_PLANE_ROWS = range(0, SIMD_WIDTH, EDGE)
_BEFORE_Z = [k for r in _PLANE_ROWS for k in (r + 3, *(SIMD_WIDTH + r + z for z in range(3)))]
_AFTER_Z = [k for r in _PLANE_ROWS for k in (r + 1, r + 2, r + 3, SIMD_WIDTH + r)]


@intrinsic
def shift_from_below(typing, below, plane):
    """Return the values one step down along z; `below` is the plane of the block below."""
    return _shuffle_planes(_BEFORE_Z)(typing, below, plane)


@intrinsic
def shift_from_above(typing, plane, above):
    """Return the values one step up along z; `above` is the plane of the block above."""
    return _shuffle_planes(_AFTER_Z)(typing, plane, above)


@intrinsic
def shift_from_south(typing, south, plane):
    """Return the values one step back along y; `south` is the plane of the block before."""
    return _shuffle_planes(range(SIMD_WIDTH - EDGE, 2 * SIMD_WIDTH - EDGE))(typing, south, plane)


@intrinsic
def shift_from_north(typing, plane, north):
    """Return the values one step ahead along y; `north` is the plane of the block behind."""
    return _shuffle_planes(range(EDGE, SIMD_WIDTH + EDGE))(typing, plane, north)
