"""AST transformer that rewrites the source of a kernel function for the GPU; see translation.py."""

import ast
import copy
import inspect
import textwrap
from types import FunctionType, ModuleType
from typing import Any

import numpy as np
from numba import cuda

from vgmpi.kernels import reaction_impulses, wall_boundary
from vgmpi.kernels.grid import collider_hold, contact_impulses
from vgmpi.kernels.grid import contact as touch
from vgmpi.kernels.rigid import prescribed_motion as driven_bodies
from vgmpi.kernels.rigid import prescribed_transfer
from vgmpi.kernels.simd import material_dispatch
from vgmpi.materials import material
from vgmpi.materials.material import law_owner, state_channels
from vgmpi.materials.tensor_math import tensor

from .translation_types import (
    NONE_ARGUMENT,
    UNSAFE,
    SourceFunction,
    TranslationMode,
    Unknown,
    is_function,
    original,
)

# Modules whose plain numbers are doubles on every engine, unless they are in an array of the run.
DOUBLE = frozenset(
    module.__name__
    for module in (
        collider_hold,
        contact_impulses,
        touch,
        wall_boundary,
        reaction_impulses,
        prescribed_transfer,
        driven_bodies,
    )
)
# Folders whose plain numbers are real, integers too: laws and their tensor algebra.
LAWS = frozenset(module.__name__.rpartition(".")[0] for module in (material, tensor))


class KernelTransformer(ast.NodeTransformer):
    """Transformer of the source of one function."""

    def __init__(self, program: Any, plain: FunctionType, mode: TranslationMode, trees: dict):
        self.program, self.mode, self.trees = program, mode, dict(trees)
        inside = inspect.getclosurevars(plain).nonlocals
        self.namespace = plain.__globals__ | inside
        code = plain.__code__
        self.own = set(code.co_varnames) | set(code.co_cellvars)
        self.double = plain.__module__ in DOUBLE
        self.law = plain.__module__.rpartition(".")[0] in LAWS and not self.double

    # ---- what names mean ---------------------------------------------------------------------

    def _value(self, node: ast.expr) -> Any:
        """Return the value of an expression of names and dots, or Unknown."""
        if isinstance(node, ast.Name):
            if node.id in self.own:
                return Unknown
            value = self.mode.constants.get(node.id, Unknown)
            value = self.program.constants.get(node.id, value)
            return self.namespace.get(node.id, Unknown) if value is Unknown else value
        if isinstance(node, ast.Attribute):
            owner = self._value(node.value)
            plain = isinstance(owner, ModuleType) and owner is not cuda
            return getattr(owner, node.attr) if plain else Unknown
        return Unknown

    def _tree(self, node: ast.expr) -> Any:
        """Return the type tree of an expression, None where it is not known."""
        if isinstance(node, ast.Name):
            return self.trees.get(node.id)
        if isinstance(node, ast.Constant) and node.value is None:
            return NONE_ARGUMENT
        if isinstance(node, ast.Attribute):
            owner = self._tree(node.value)
            return dict(owner[1]).get(node.attr) if isinstance(owner, tuple) else None
        if isinstance(node, ast.IfExp):
            test = self.visit(copy.deepcopy(node.test))
            is_constant = isinstance(test, ast.Constant)
            return self._tree(node.body if test.value else node.orelse) if is_constant else None
        if isinstance(node, ast.Call):
            called = self._value(node.func)
            if hasattr(called, "like"):
                return self._tree(node.args[called.like])
            if isinstance(called, type) and hasattr(called, "_fields"):
                members = list(zip(called._fields, node.args, strict=False))
                members += [(keyword.arg, keyword.value) for keyword in node.keywords]
                return called, tuple((name, self._tree(value)) for name, value in members)
        return None

    def visit_Name(self, node: ast.Name) -> ast.expr:
        """Replace a loaded name by its meaning on the GPU."""
        if not isinstance(node.ctx, ast.Load):
            return node
        return self._meant(node, self._value(node))

    def visit_Attribute(self, node: ast.Attribute) -> ast.expr:
        """Replace a module's attribute, and append _ to unsafe field names."""
        value = self._value(node)
        if value is not Unknown:
            return self._meant(node, value)
        if isinstance(self._value(node.value), ModuleType):
            return node
        owner = self._tree(node.value)
        node = ast.Attribute(self.visit(node.value), node.attr, node.ctx)
        if isinstance(owner, tuple) and node.attr in UNSAFE:
            node.attr += "_"
        return node

    def _meant(self, node: ast.expr, value: Any) -> ast.expr:
        if value is Unknown or isinstance(value, ModuleType):
            return node
        if isinstance(value, SourceFunction):
            return ast.Name(self.program.text(*value), ast.Load())
        if isinstance(value, bool):
            return ast.Constant(value)
        if isinstance(value, int | float) and not isinstance(value, np.generic):
            return self._number(value)
        value = self._stand_in(value)
        if isinstance(value, type) or not is_function(value):
            return ast.Name(self.program.bind_constant(value, _hint(node)), ast.Load())
        return ast.Name(self.program.function(value, self.mode, {}), ast.Load())

    def _stand_in(self, value: Any) -> Any:
        """Return the GPU replacement of a value."""
        return self.mode.stands_in.get(value, value) if value.__hash__ is not None else value

    # ---- numbers -----------------------------------------------------------------------------

    def _number(self, value) -> ast.expr:
        """Return a plain number in the precision in which the CPU takes it."""
        if isinstance(value, float) or (self.law and isinstance(value, int)):
            kind = np.float64 if self.double else self.program.real
            return ast.Name(self.program.bind_constant(kind(value), "number"), ast.Load())
        return ast.Constant(value)

    def _constant(self, node: ast.expr) -> Any:
        """Return the value of an expression of numbers alone; they are doubles, as in Python."""
        if isinstance(node, ast.Constant):
            return node.value if type(node.value) in (int, float) else Unknown
        if isinstance(node, ast.Name | ast.Attribute):
            value = self._value(node)
            return value if type(value) in (int, float) else Unknown
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
            value = self._constant(node.operand)
            return value if value is Unknown else -value
        if isinstance(node, ast.BinOp):
            operands = self._constant(node.left), self._constant(node.right)
            if Unknown in operands:
                return Unknown
            expression = ast.Expression(ast.BinOp(*map(ast.Constant, operands[:1]), node.op,
                                                  ast.Constant(operands[1])))  # fmt: skip
            return eval(compile(ast.fix_missing_locations(expression), "<number>", "eval"))
        return Unknown

    def visit_Constant(self, node: ast.Constant) -> ast.expr:
        """Convert a plain number to the precision of the run."""
        return self._number(node.value) if type(node.value) in (int, float) else node

    def visit_UnaryOp(self, node: ast.UnaryOp) -> ast.expr:
        """Fold a constant negation, else transform the operand."""
        value = self._constant(node)
        return self.generic_visit(node) if value is Unknown else self._number(value)

    def visit_BinOp(self, node: ast.BinOp) -> ast.expr:
        """Fold constants, and replace powers by functions."""
        value = self._constant(node)
        if value is not Unknown:
            return self._number(value)
        if isinstance(node.op, ast.Pow) and isinstance(node.right, ast.Constant):
            return ast.Call(self._power(node.right.value), [self.visit(node.left)], [])
        return self.generic_visit(node)

    def _power(self, n: int) -> ast.expr:
        """Return the function x ** n, by squaring (kernels/simd/vector16.py)."""
        name = f"power_{n}".replace("-", "less")
        if name not in self.program.space:
            lines, square, total, left = [f"def {name}(x):"], "x", "", abs(n)
            while left:
                if left & 1:
                    total = f"({total} * {square})" if total else square
                left >>= 1
                square = f"({square} * {square})"
            unit = self.program.bind_constant(self.program.real(1.0), "number")
            lines.append(f"    return {unit} / {total}" if n < 0 else f"    return {total}")
            self.program.text(name, "\n".join(lines))
        return ast.Name(name, ast.Load())

    def visit_Subscript(self, node: ast.Subscript) -> ast.expr:
        """Keep the integers of an index."""
        law, self.law = self.law, False  # indices and slices stay integers
        index = self.visit(node.slice)
        self.law = law
        return ast.Subscript(self.visit(node.value), index, node.ctx)

    # ---- calls -------------------------------------------------------------------------------

    def visit_Call(self, node: ast.Call) -> ast.expr:
        """Replace a call by the call of a GPU function."""
        called = self._value(node.func)
        if called is np.float64 and self._constant(node.args[0]) is not Unknown:
            number = np.float64(self._constant(node.args[0]))
            return ast.Name(self.program.bind_constant(number, "double"), ast.Load())
        if isinstance(node.func, ast.Name) and node.func.id in ("min", "max"):
            if node.func.id not in self.own and called is Unknown:
                return self._bounded(node)
        replacement = self._stand_in(called)
        if (
            is_function(replacement)
            and getattr(replacement, "py_func", replacement) in self.mode.views
        ):
            return self._view(getattr(replacement, "py_func", replacement), node)
        target = self._target(called, node)
        if target is None:
            return self.generic_visit(node)
        node.args = [self.visit(argument) for argument in node.args]
        for argument in node.keywords:
            argument.value = self.visit(argument.value)
        return ast.Call(ast.Name(target, ast.Load()), node.args, node.keywords)

    def _target(self, called: Any, node: ast.Call) -> str | None:
        """Return the name of the called GPU function, None for a function of a library."""
        called = self._stand_in(called)
        if not is_function(called):
            return None
        if hasattr(called, "table"):
            called = called.table[self._tree(node.args[0])[0]]
        elif called.__module__ == material_dispatch.__name__:
            law = self._tree(node.args[0])
            if called is material_dispatch.load_state_vector:
                return self._state(law[0])
            if called is material_dispatch.store_state_vector:
                return self._state(dict(self.trees)["law"][0], puts=True)
            called = getattr(law_owner(original(law[0])), called.__name__)
        names = list(inspect.signature(getattr(called, "py_func", called)).parameters)
        trees = {n: self._tree(a) for n, a in zip(names, node.args, strict=False)}
        trees |= {
            keyword.arg: self._tree(keyword.value) for keyword in node.keywords if keyword.arg
        }
        return self.program.function(
            called, self.mode, {n: tree for n, tree in trees.items() if tree is not None}
        )

    def _view(self, plain: FunctionType, node: ast.Call) -> ast.expr:
        """Return a call of a view function as an expression.

        Such a function consists of `if ...: return ...`; GPU functions cannot return a part of an
        array.
        """
        definition = ast.parse(textwrap.dedent(inspect.getsource(plain))).body[0]
        assert isinstance(definition, ast.FunctionDef)
        names = [argument.arg for argument in definition.args.args]
        arguments = dict(zip(names, map(self.visit, node.args), strict=True))
        inside = KernelTransformer(self.program, plain, self.mode, {})
        result: ast.expr | None = None
        for line in reversed(definition.body):
            if isinstance(line, ast.Return):
                result = inside.visit(line.value)
            elif isinstance(line, ast.If):
                result = ast.IfExp(
                    inside.visit(line.test), inside.visit(line.body[0].value), result
                )
        return _NameSubstitution(arguments).visit(result)

    def _state(self, law: type, puts: bool = False) -> str:
        """Return the name of load_state or store_state for one particle."""
        count = state_channels(original(law))
        name = f"{'put' if puts else 'take'}_state_{count}"
        if name not in self.program.space:
            if puts:
                lines = [f"    f[at + {c} * cap] = state[{c}]" for c in range(count)]
                text = "\n".join([f"def {name}(f, at, cap, state):", *lines])
            else:
                channels = ", ".join(f"f[at + {c} * cap]" for c in range(count))
                text = f"def {name}(law, f, at, cap):\n    return ({channels},)"
            self.program.text(name, text)
        return name

    def _bounded(self, node: ast.Call) -> ast.expr:
        """Return min or max as in Python: the first of equal values, or of values that are NaN."""
        assert isinstance(node.func, ast.Name)
        name = f"plain_{node.func.id}"
        if name not in self.program.space:
            sign = "<" if node.func.id == "min" else ">"
            self.program.text(name, f"def {name}(a, b):\n    return b if b {sign} a else a")
        total = self.visit(node.args[0])
        for argument in node.args[1:]:
            total = ast.Call(ast.Name(name, ast.Load()), [total, self.visit(argument)], [])
        return total

    # ---- branches that are known -------------------------------------------------------------

    def visit_Compare(self, node: ast.Compare) -> ast.expr:
        """Decide comparisons with None."""
        if len(node.ops) == 1 and isinstance(node.ops[0], ast.Is | ast.IsNot):
            tree, right = self._tree(node.left), node.comparators[0]
            if isinstance(right, ast.Constant) and right.value is None:
                none = tree is NONE_ARGUMENT
                return ast.Constant(none if isinstance(node.ops[0], ast.Is) else not none)
        return self.generic_visit(node)

    def visit_BoolOp(self, node: ast.BoolOp) -> ast.expr:
        """Drop operands that are known, and decide the result if one suffices."""
        decides = isinstance(node.op, ast.Or)
        values = []
        for value in node.values:
            value = self.visit(value)
            if isinstance(value, ast.Constant) and isinstance(value.value, bool):
                if value.value == decides:
                    return ast.Constant(decides) if not values else ast.BoolOp(
                        node.op, [*values, value]
                    )  # fmt: skip
                continue
            values.append(value)
        if not values:
            return ast.Constant(not decides)
        return values[0] if len(values) == 1 else ast.BoolOp(node.op, values)

    def visit_IfExp(self, node: ast.IfExp) -> ast.expr:
        """Select the branch of a conditional expression whose test is known."""
        test = self.visit(node.test)
        if isinstance(test, ast.Constant):
            return self.visit(node.body if test.value else node.orelse)
        return ast.IfExp(test, self.visit(node.body), self.visit(node.orelse))

    def visit_If(self, node: ast.If):
        """Select the branch of a statement whose test is known."""
        test = self.visit(node.test)
        if isinstance(test, ast.Constant):
            return self.block(node.body if test.value else node.orelse, empty=True)
        return ast.If(test, self.block(node.body), self.block(node.orelse, empty=True))

    def visit_For(self, node: ast.For) -> ast.stmt:
        """Transform a loop."""
        return ast.For(node.target, self.visit(node.iter), self.block(node.body), [])

    def visit_While(self, node: ast.While) -> ast.stmt:
        """Transform a loop."""
        return ast.While(self.visit(node.test), self.block(node.body), [])

    def visit_Assign(self, node: ast.Assign) -> ast.stmt:
        """Record the type tree of an assigned name."""
        tree = self._tree(node.value)
        if tree is not None and isinstance(node.targets[0], ast.Name):
            self.trees[node.targets[0].id] = tree
        return self.generic_visit(node)

    def block(self, lines: list[ast.stmt], empty: bool = False) -> list[ast.stmt]:
        """Transform statements and drop those that never run."""
        statements: list[ast.stmt] = []
        for line in lines:
            result = self.visit(line)
            statements += result if isinstance(result, list) else [result]
        return statements if statements or empty else [ast.Pass()]


class _NameSubstitution(ast.NodeTransformer):
    """Substitution of expressions for names."""

    def __init__(self, expressions: dict[str, ast.expr]):
        self.expressions = expressions

    def visit_Name(self, node: ast.Name) -> ast.expr:
        """Return the expression of a name, or the name."""
        return copy.deepcopy(self.expressions.get(node.id, node))


def _hint(node: ast.expr) -> str:
    return node.id if isinstance(node, ast.Name) else node.attr if hasattr(node, "attr") else "it"
