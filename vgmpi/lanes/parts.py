"""Some nodes of a row as a vector: 4 lanes for one, 8 for two, 16 for a whole row.

A row of 16 numbers (rows.py) is two or four registers where a processor has no 512-bit ones, and
what a sum over rows keeps at hand then does not fit. So such sums (kernels/rowsums.py) are written
for some nodes of each row, fixed when they are compiled. `like` is a vector of as many nodes.
"""

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from .lanes import OF, Lanes, address
from .rows import _align, _mask, _vector_at


def _fixed(per_node):
    """A vector of one fixed number for each of the nodes node, ..., node + nodes - 1; the array is
    an example of the precision wanted."""

    def make(typing, array, node, nodes):
        first, last = node.literal_value, node.literal_value + nodes.literal_value
        values = [float(number) for number in per_node[first:last] for _ in range(4)]
        lanes = OF[array.dtype]
        if len(values) != lanes.count:
            lanes = Lanes(lanes.real, len(values))

        def build(context, builder, signature, arguments):
            return ir.Constant(lanes.vector, values)

        return lanes(array, node, nodes), build

    return make


@intrinsic(prefer_literal=True)
def steps(typing, array, node, nodes):
    """0 0 0 0 1 1 1 1 ...: the number of a row's node in each of its lanes."""
    return _fixed((0, 1, 2, 3))(typing, array, node, nodes)


@intrinsic(prefer_literal=True)
def slope_middle(typing, array, node, nodes):
    """A quarter of the B-splines' slopes [1/cell] of a row's nodes, where the offset is 0."""
    return _fixed((-0.375, 0.5, -0.125, 0.0))(typing, array, node, nodes)


@intrinsic(prefer_literal=True)
def slope_change(typing, array, node, nodes):
    """Change of `slope_middle` with the offset of the base node [cells]."""
    return _fixed((-0.25, 0.5, -0.25, 0.0))(typing, array, node, nodes)


@intrinsic(prefer_literal=True)
def nothing(typing, array, node, nodes):
    """Zeros."""
    return _fixed((0.0, 0.0, 0.0, 0.0))(typing, array, node, nodes)


@intrinsic
def repeat(typing, array, first, like):
    """abcd -> abcd abcd ...: one quantity of all nodes."""

    def build(context, builder, signature, arguments):
        place = address(context, builder, signature.args[0], *arguments[:2])
        four = builder.load(_vector_at(builder, place, like, 4), align=_align(like))
        return builder.shuffle_vector(four, four, _mask([k % 4 for k in range(like.count)]))

    return like(array, types.intp, like), build


@intrinsic
def stretch(typing, array, first, like):
    """ab... -> aaaa bbbb ...: a weight per node."""

    def build(context, builder, signature, arguments):
        place = address(context, builder, signature.args[0], *arguments[:2])
        place = _vector_at(builder, place, like, like.count // 4)
        weights = builder.load(place, align=_align(like))
        lanes = _mask([k // 4 for k in range(like.count)])
        return builder.shuffle_vector(weights, weights, lanes)

    return like(array, types.intp, like), build


@intrinsic
def load(typing, array, first, like):
    """The nodes whose numbers begin at array[first]."""

    def build(context, builder, signature, arguments):
        place = address(context, builder, signature.args[0], *arguments[:2])
        return builder.load(_vector_at(builder, place, like, like.count), align=_align(like))

    return like(array, types.intp, like), build


@intrinsic
def store(typing, array, first, values):
    """Put nodes to array[first], ..."""

    def build(context, builder, signature, arguments):
        place = address(context, builder, signature.args[0], *arguments[:2])
        place = _vector_at(builder, place, values, values.count)
        builder.store(arguments[2], place, align=_align(values))
        return context.get_dummy_value()

    return types.void(array, types.intp, values), build


@intrinsic
def store_sums(typing, array, first, parts):
    """Put sums over a row's first three nodes, four numbers each, to array[first:first + 4] and on.

    parts: for each part of the row a tuple of vectors, one of each quantity. The sum runs from node
    to node, whatever the parts are.
    """

    def build(context, builder, signature, arguments):
        place = address(context, builder, signature.args[0], *arguments[:2])
        for q, kind in enumerate(parts.types[0].types):
            nodes = []
            for k, part in enumerate(parts.types):
                v = builder.extract_value(arguments[2], (k, q))
                for at in range(0, part.types[q].count, 4):
                    nodes.append(builder.shuffle_vector(v, v, _mask(range(at, at + 4))))
            # never fused with the products that are summed: those of a whole row cannot be
            total = builder.fadd(builder.fadd(nodes[0], nodes[1]), nodes[2])
            here = builder.gep(place, [ir.Constant(ir.IntType(64), 4 * q)])
            builder.store(total, _vector_at(builder, here, kind, 4), align=_align(kind))
        return context.get_dummy_value()

    return types.void(array, types.intp, parts), build
