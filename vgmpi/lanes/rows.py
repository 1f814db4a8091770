"""What transfers need beyond laws: fixed-point positions as vectors, and rows of nodes.

A row is four nodes along z with four numbers each, abcd abcd abcd abcd, in one vector of 16. A
particle touches nine rows; the fourth node of each has weight 0 and must hold finite numbers.
A record is 16 numbers of one particle; 16 records are 16 vectors transposed.
"""

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from ..device.processor import vector_bytes
from .lanes import COUNT, OF, Lanes, address, call, in_all_lanes

_I32 = ir.IntType(32)
# a record in one or two registers is transposed in these; else four numbers of it at a time
QUARTERS = vector_bytes() < 64


def _mask(places) -> ir.Constant:
    return ir.Constant(ir.VectorType(_I32, len(places)), list(places))


def _vector_at(builder, place, lanes: Lanes, count: int = COUNT):
    return builder.bitcast(place, ir.VectorType(lanes.vector.element, count).as_pointer())


def _align(lanes: Lanes) -> int:
    return lanes.real.bitwidth // 8


@intrinsic
def spread(typing, example, value):
    """A number in all lanes; `example` is an array of the precision wanted."""
    lanes = OF[example.dtype]

    def build(context, builder, signature, arguments):
        return in_all_lanes(context, builder, signature.args[1], lanes, arguments[1])

    return lanes(example, value), build


def _constant(values):
    """A vector of fixed numbers; the argument is an array of the precision wanted."""

    def make(typing, example):
        lanes = OF[example.dtype]

        def build(context, builder, signature, arguments):
            return ir.Constant(lanes.vector, values)

        return lanes(example), build

    return make


@intrinsic
def fourth(typing, example):
    """0001 0000 0000 0000: the fourth number of a record."""
    return _constant([float(k == 3) for k in range(COUNT)])(typing, example)


@intrinsic
def diagonal(typing, example):
    """0000 1000 0100 0010: slope 1 along x of the first number, along y of the second, along z of
    the third."""
    return _constant([float(k in (4, 9, 14)) for k in range(COUNT)])(typing, example)


def _four(pattern):
    """Load four numbers and place them in the lanes by `pattern`."""

    def make(typing, array, first):
        lanes = OF[array.dtype]

        def build(context, builder, signature, arguments):
            place = address(context, builder, signature.args[0], *arguments)
            four = builder.load(_vector_at(builder, place, lanes, 4), align=_align(lanes))
            return builder.shuffle_vector(four, four, _mask(pattern))

        return lanes(array, types.intp), build

    return make


@intrinsic
def repeat(typing, array, first):
    """abcd -> abcd abcd abcd abcd: one quantity of all nodes of a row."""
    return _four([k % 4 for k in range(COUNT)])(typing, array, first)


def _slide(first):
    """16 lanes of two vectors laid end to end, from lane `first` on."""

    def make(typing, one, other):
        def build(context, builder, signature, arguments):
            return builder.shuffle_vector(*arguments, _mask(range(first, first + COUNT)))

        return one(one, other), build

    return make


@intrinsic
def slide_back(typing, before, row):
    """The last node of the row before and the first three of a row."""
    return _slide(12)(typing, before, row)


def _transposed(builder, vectors):
    """Transpose 16 vectors of 16 by four rounds of interleaving shuffles."""
    half = 1
    while half < COUNT:
        low = [k & ~half if not k & half else COUNT + (k & ~half) for k in range(COUNT)]
        high = [k | half if not k & half else COUNT + (k | half) for k in range(COUNT)]
        out = list(vectors)
        for i in range(COUNT):
            if not i & half:
                a, b = vectors[i], vectors[i | half]
                out[i] = builder.shuffle_vector(a, b, _mask(low))
                out[i | half] = builder.shuffle_vector(a, b, _mask(high))
        vectors = out
        half *= 2
    return vectors


_PAIRS = [k for c in range(0, COUNT, 4) for k in (c, COUNT + c, c + 1, COUNT + c + 1)]
_HALVES = [k for c in range(0, COUNT, 4) for k in (c, c + 1, COUNT + c, COUNT + c + 1)]


def _turned(builder, four):
    """Transpose the blocks of 4 x 4 numbers of four vectors, by shuffles within four lanes."""

    def joined(a, b, lanes, by):
        return builder.shuffle_vector(a, b, _mask([k + by for k in lanes]))

    a, b, c, d = four
    low, high = joined(a, b, _PAIRS, 0), joined(a, b, _PAIRS, 2)
    low_other, high_other = joined(c, d, _PAIRS, 0), joined(c, d, _PAIRS, 2)
    return [
        joined(one, other, _HALVES, by)
        for one, other in ((low, low_other), (high, high_other))
        for by in (0, 2)
    ]


def _put_whole(builder, place, lanes, vectors):
    """Transposed in registers: for processors whose registers hold a record."""
    for k, row in enumerate(_transposed(builder, vectors)):
        here = builder.gep(place, [ir.Constant(ir.IntType(64), COUNT * k)])
        builder.store(row, _vector_at(builder, here, lanes), align=_align(lanes))


def _put_quarters(builder, place, lanes, vectors):
    """Four numbers of each record at a time, so that four vectors are at work and not sixteen."""
    for q in range(0, COUNT, 4):
        here = builder.gep(place, [ir.Constant(ir.IntType(64), q)])
        _put_quarter(builder, here, lanes, vectors[q : q + 4])


def _put_quarter(builder, place, lanes, four):
    for k, turned in enumerate(_turned(builder, four)):
        for n in range(0, COUNT, 4):
            part = builder.shuffle_vector(turned, turned, _mask(range(n, n + 4)))
            here = builder.gep(place, [ir.Constant(ir.IntType(64), COUNT * (n + k))])
            builder.store(part, _vector_at(builder, here, lanes, 4), align=_align(lanes))


def _get_whole(builder, place, lanes):
    """Inverse of `_put_whole`."""
    rows = []
    for k in range(COUNT):
        here = builder.gep(place, [ir.Constant(ir.IntType(64), COUNT * k)])
        rows.append(builder.load(_vector_at(builder, here, lanes), align=_align(lanes)))
    return _transposed(builder, rows)


def _get_quarters(builder, place, lanes):
    """Inverse of `_put_quarters`."""
    vectors = []
    for q in range(0, COUNT, 4):
        four = []
        for k in range(4):
            quarters = []
            for n in range(0, COUNT, 4):
                here = builder.gep(place, [ir.Constant(ir.IntType(64), COUNT * (n + k) + q)])
                here = _vector_at(builder, here, lanes, 4)
                quarters.append(builder.load(here, align=_align(lanes)))
            while len(quarters) > 1:
                pairs = zip(quarters[::2], quarters[1::2], strict=True)
                both = _mask(range(8 if len(quarters) == 4 else 16))
                quarters = [builder.shuffle_vector(a, b, both) for a, b in pairs]
            four += quarters
        vectors += _turned(builder, four)
    return vectors


@intrinsic
def store_records(typing, array, first, vectors):
    """16 vectors over particles -> 16 records, one after the other from array[first]."""
    lanes = OF[array.dtype]

    def build(context, builder, signature, arguments):
        place = address(context, builder, signature.args[0], *arguments[:2])
        put = _put_quarters if QUARTERS else _put_whole
        put(builder, place, lanes, cgutils.unpack_tuple(builder, arguments[2], COUNT))
        return context.get_dummy_value()

    return types.void(array, types.intp, vectors), build


@intrinsic
def store_quarter(typing, array, first, vectors):
    """4 vectors over particles -> 4 numbers of each of 16 records: array[first:first + 4] and every
    16 numbers further on."""
    lanes = OF[array.dtype]

    def build(context, builder, signature, arguments):
        place = address(context, builder, signature.args[0], *arguments[:2])
        _put_quarter(builder, place, lanes, cgutils.unpack_tuple(builder, arguments[2], 4))
        return context.get_dummy_value()

    return types.void(array, types.intp, vectors), build


@intrinsic
def load_records(typing, array, first):
    """Inverse of `store_records`: a tuple of 16 vectors."""
    lanes = OF[array.dtype]
    tuple_type = types.UniTuple(lanes, COUNT)

    def build(context, builder, signature, arguments):
        place = address(context, builder, signature.args[0], *arguments)
        get = _get_quarters if QUARTERS else _get_whole
        return context.make_tuple(builder, tuple_type, get(builder, place, lanes))

    return tuple_type(array, types.intp), build


# ---- fixed-point positions: integers as wide as the numbers -------------------------------------


def _reals(row):
    return OF[types.float32 if row.dtype.bitwidth == 32 else types.float64]


def _whole_at(builder, place, lanes):
    return builder.bitcast(place, lanes.whole.as_pointer())


def _bits(lanes) -> int:
    return 29 if lanes.real.bitwidth == 32 else 52


@intrinsic
def fraction(typing, row, first):
    """Where in their cells 16 positions lie, 0 .. 1."""
    lanes = _reals(row)

    def build(context, builder, signature, arguments):
        place = address(context, builder, signature.args[0], *arguments)
        x = builder.load(_whole_at(builder, place, lanes), align=_align(lanes))
        inside = builder.and_(x, lanes.integer((1 << _bits(lanes)) - 1))
        inside = builder.sitofp(inside, lanes.vector)
        return builder.fmul(inside, lanes.constant(2.0 ** -_bits(lanes)))

    return lanes(row, types.intp), build


@intrinsic
def cell_offset(typing, row, first, stride):
    """(cell + 3) stride for 16 positions, as numbers (exact: they are small)."""
    lanes = _reals(row)

    def build(context, builder, signature, arguments):
        place = address(context, builder, signature.args[0], *arguments[:2])
        x = builder.load(_whole_at(builder, place, lanes), align=_align(lanes))
        cell = builder.add(builder.ashr(x, lanes.integer(_bits(lanes))), lanes.integer(3))
        step = in_all_lanes(context, builder, signature.args[2], lanes, arguments[2])
        return builder.fmul(builder.sitofp(cell, lanes.vector), step)

    return lanes(row, types.intp, stride), build


@intrinsic
def store_whole(typing, array, first, values):
    """Put 16 numbers that are whole to an int32 array."""

    def build(context, builder, signature, arguments):
        place = address(context, builder, signature.args[0], *arguments[:2])
        vector = ir.VectorType(_I32, COUNT)
        whole = builder.fptosi(arguments[2], vector)
        builder.store(whole, builder.bitcast(place, vector.as_pointer()), align=4)
        return context.get_dummy_value()

    return types.void(array, types.intp, values), build


@intrinsic
def move(typing, row, first, distance):
    """Add 16 distances [2^-bits cells], rounded down, to 16 positions; returns them in cells."""
    lanes = _reals(row)

    def build(context, builder, signature, arguments):
        place = address(context, builder, signature.args[0], *arguments[:2])
        place = _whole_at(builder, place, lanes)
        x = builder.load(place, align=_align(lanes))
        step = call("llvm.floor")(builder, lanes, arguments[2])
        x = builder.add(x, builder.fptosi(step, lanes.whole))
        builder.store(x, place, align=_align(lanes))
        return builder.fmul(builder.sitofp(x, lanes.vector), lanes.constant(2.0 ** -_bits(lanes)))

    return lanes(row, types.intp, distance), build


# ---- comparisons --------------------------------------------------------------------------------


def _first_lanes(builder, count):
    """Bits 0 .. count - 1 of a 16-bit mask; count may be above 16."""
    count = builder.trunc(count, _I32)
    full = builder.icmp_signed(">=", count, _I32(COUNT))
    some = builder.sub(builder.shl(_I32(1), builder.select(full, _I32(0), count)), _I32(1))
    return builder.trunc(builder.select(full, _I32((1 << COUNT) - 1), some), ir.IntType(COUNT))


@intrinsic
def sound(typing, values, low, high, count):
    """Mask of the first `count` lanes whose value lies between low and high; a nan does not."""

    def build(context, builder, signature, arguments):
        v, low, high, count = arguments
        yes = builder.and_(builder.fcmp_ordered(">", v, low), builder.fcmp_ordered("<", v, high))
        mask = builder.bitcast(yes, ir.IntType(COUNT))
        mask = builder.and_(mask, _first_lanes(builder, count))
        return builder.zext(mask, ir.IntType(64))

    return types.int64(values, values, values, types.int64), build


@intrinsic
def first_lanes(typing, values, count):
    """The first `count` numbers, 0 behind them; count may be above 16."""

    def build(context, builder, signature, arguments):
        mask = _first_lanes(builder, arguments[1])
        bits = builder.bitcast(mask, ir.VectorType(ir.IntType(1), COUNT))
        return builder.select(bits, arguments[0], values.constant(0.0))

    return values(values, types.int64), build


@intrinsic
def only(typing, mask, values):
    """Values in the lanes of a mask, 0 elsewhere."""

    def build(context, builder, signature, arguments):
        bits = builder.bitcast(
            builder.trunc(arguments[0], ir.IntType(COUNT)), ir.VectorType(ir.IntType(1), COUNT)
        )
        return builder.select(bits, arguments[1], values.constant(0.0))

    return values(types.int64, values), build


@intrinsic
def higher(typing, a, b):
    """a where it is larger, else b: an a that is no number does not count. One instruction, where
    np.maximum takes four."""

    def build(context, builder, signature, arguments):
        return builder.select(builder.fcmp_ordered(">", *arguments), *arguments)

    return a(a, b), build


@intrinsic
def largest(typing, values):
    """The largest of 16 numbers."""

    def build(context, builder, signature, arguments):
        name = f"llvm.vector.reduce.fmax.v{COUNT}f{values.real.bitwidth}"
        kind = ir.FunctionType(values.vector.element, [values.vector])
        function = cgutils.get_or_insert_function(builder.module, kind, name)
        return builder.call(function, [arguments[0]])

    return values.real(values), build


SOUND_ALL = np.int64((1 << COUNT) - 1)
