"""Partial rows: some nodes of a row as a vector, 4 lanes for one node, 8 for two, 16 for all four.

A row of 16 numbers (row_ops.py) takes two or four registers on a processor without 512-bit
registers, and the values that a sum over rows keeps then do not fit. Such sums
(kernels/stencil_sums.py) are therefore written for some nodes of each row, fixed when they are
compiled. `like` is a vector of as many nodes.
"""

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from .row_ops import _align, _mask, _vector_at
from .vector16 import VECTOR_OF, VectorType, address


def _fixed(per_node):
    """Return the typing function of a vector with one fixed number per node.

    The vector covers node to node + nodes - 1; the array is an example of the precision.
    """

    def _typing_function(typing, array, node, nodes):
        first, last = node.literal_value, node.literal_value + nodes.literal_value
        values = [float(number) for number in per_node[first:last] for _ in range(4)]
        lanes = VECTOR_OF[array.dtype]
        if len(values) != lanes.count:
            lanes = VectorType(lanes.real, len(values))

        def _codegen(context, builder, signature, arguments):
            return ir.Constant(lanes.vector, values)

        return lanes(array, node, nodes), _codegen

    return _typing_function


@intrinsic(prefer_literal=True)
def node_numbers(typing, array, node, nodes):
    """Return the number of a row's node in each of its lanes: 0 0 0 0 1 1 1 1.

    Args:
        array: Example of the precision.
        node: First node, a literal.
        nodes: Number of nodes, a literal.
    """
    return _fixed((0, 1, 2, 3))(typing, array, node, nodes)


@intrinsic(prefer_literal=True)
def slope_middle(typing, array, node, nodes):
    """Return a quarter of the B-spline slopes of a row's nodes at offset 0 [1/cell].

    Args:
        array: Example of the precision.
        node: First node, a literal.
        nodes: Number of nodes, a literal.
    """
    return _fixed((-0.375, 0.5, -0.125, 0.0))(typing, array, node, nodes)


@intrinsic(prefer_literal=True)
def slope_change(typing, array, node, nodes):
    """Return the change of `slope_middle` with the offset of the base node [cells].

    Args:
        array: Example of the precision.
        node: First node, a literal.
        nodes: Number of nodes, a literal.
    """
    return _fixed((-0.25, 0.5, -0.25, 0.0))(typing, array, node, nodes)


@intrinsic(prefer_literal=True)
def mean_middle(typing, array, node, nodes):
    """Return twice the weights of a row's nodes in the means of cells, at offset 0.

    Args:
        array: Example of the precision.
        node: First node, a literal.
        nodes: Number of nodes, a literal.
    """
    return _fixed((1.5, 1.0, -0.5, 0.0))(typing, array, node, nodes)


@intrinsic(prefer_literal=True)
def mean_change(typing, array, node, nodes):
    """Return the change of `mean_middle` with the offset of the base node [1/cell].

    Args:
        array: Example of the precision.
        node: First node, a literal.
        nodes: Number of nodes, a literal.
    """
    return _fixed((1.0, 0.0, -1.0, 0.0))(typing, array, node, nodes)


@intrinsic(prefer_literal=True)
def zeros_like_row(typing, array, node, nodes):
    """Return zeros.

    Args:
        array: Example of the precision.
        node: First node, a literal.
        nodes: Number of nodes, a literal.
    """
    return _fixed((0.0, 0.0, 0.0, 0.0))(typing, array, node, nodes)


@intrinsic
def tile(typing, array, first, like):
    """Tile one quantity of all nodes: abcd -> abcd abcd.

    Args:
        array: Contiguous array.
        first: Index of the first number.
        like: Vector of as many nodes.
    """

    def _codegen(context, builder, signature, arguments):
        pointer = address(context, builder, signature.args[0], *arguments[:2])
        four = builder.load(_vector_at(builder, pointer, like, 4), align=_align(like))
        return builder.shuffle_vector(four, four, _mask([k % 4 for k in range(like.count)]))

    return like(array, types.intp, like), _codegen


@intrinsic
def broadcast_per_node(typing, array, first, like):
    """Broadcast a weight per node to its lanes: ab -> aaaa bbbb.

    Args:
        array: Contiguous array.
        first: Index of the first number.
        like: Vector of as many nodes.
    """

    def _codegen(context, builder, signature, arguments):
        pointer = address(context, builder, signature.args[0], *arguments[:2])
        pointer = _vector_at(builder, pointer, like, like.count // 4)
        weights = builder.load(pointer, align=_align(like))
        lanes = _mask([k // 4 for k in range(like.count)])
        return builder.shuffle_vector(weights, weights, lanes)

    return like(array, types.intp, like), _codegen


@intrinsic
def load(typing, array, first, like):
    """Load the nodes whose numbers begin at array[first].

    Args:
        array: Contiguous array.
        first: Index of the first number.
        like: Vector of as many nodes.
    """

    def _codegen(context, builder, signature, arguments):
        pointer = address(context, builder, signature.args[0], *arguments[:2])
        return builder.load(_vector_at(builder, pointer, like, like.count), align=_align(like))

    return like(array, types.intp, like), _codegen


@intrinsic
def store(typing, array, first, values):
    """Store nodes to array[first] and on.

    Args:
        array: Contiguous array (out).
        first: Index of the first number.
        values: Vector of nodes.
    """

    def _codegen(context, builder, signature, arguments):
        pointer = address(context, builder, signature.args[0], *arguments[:2])
        pointer = _vector_at(builder, pointer, values, values.count)
        builder.store(arguments[2], pointer, align=_align(values))
        return context.get_dummy_value()

    return types.void(array, types.intp, values), _codegen


@intrinsic
def store_sums(typing, array, first, parts):
    """Store sums over the first three nodes of a row, four numbers per quantity.

    The sum runs from node to node, whatever the parts are.

    Args:
        array: Contiguous array (out).
        first: Index of the first number.
        parts: For each part of the row, a tuple of vectors, one per quantity.
    """

    def _codegen(context, builder, signature, arguments):
        pointer = address(context, builder, signature.args[0], *arguments[:2])
        for q, kind in enumerate(parts.types[0].types):
            nodes = []
            for k, part in enumerate(parts.types):
                v = builder.extract_value(arguments[2], (k, q))
                for lane in range(0, part.types[q].count, 4):
                    nodes.append(builder.shuffle_vector(v, v, _mask(range(lane, lane + 4))))
            # Never fused with the summed products, since products of a complete row cannot be.
            total = builder.fadd(builder.fadd(nodes[0], nodes[1]), nodes[2])
            target = builder.gep(pointer, [ir.Constant(ir.IntType(64), 4 * q)])
            builder.store(total, _vector_at(builder, target, kind, 4), align=_align(kind))
        return context.get_dummy_value()

    return types.void(array, types.intp, parts), _codegen
