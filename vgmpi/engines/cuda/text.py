"""The text of a kernel's function, read and changed for a card: see program.py."""

import ast
import copy
import inspect
import textwrap
from types import FunctionType, ModuleType
from typing import Any

import numpy as np
from numba import cuda

from ...device import root, tensor
from ...domain import driven as driven_bodies
from ...kernels import contact, driven, given, touch, walls
from ...lanes import laws
from ...materials import base
from ...materials.base import law_owner, state_channels
from .words import NEVER, UNSAFE, Mode, Unknown, Written, is_function, original

# in these numbers are doubles on every engine, where they do not stand in an array of the run's
DOUBLE = frozenset(
    module.__name__ for module in (contact, touch, walls, given, driven, driven_bodies, root)
)
# plain numbers of the modules in these folders are real, whole ones too: laws and their algebra
LAWS = frozenset(module.__name__.rpartition(".")[0] for module in (base, tensor))


class Change(ast.NodeTransformer):
    """Reads the text of one function."""

    def __init__(self, program: Any, plain: FunctionType, mode: Mode, trees: dict):
        self.program, self.mode, self.trees = program, mode, dict(trees)
        inside = inspect.getclosurevars(plain).nonlocals
        self.known = plain.__globals__ | inside
        code = plain.__code__
        self.own = set(code.co_varnames) | set(code.co_cellvars)
        self.double = plain.__module__ in DOUBLE
        self.law = plain.__module__.rpartition(".")[0] in LAWS and not self.double

    # ---- what names mean ---------------------------------------------------------------------

    def _value(self, node: ast.expr) -> Any:
        """What an expression of names and dots is, or the class of nothing."""
        if isinstance(node, ast.Name):
            if node.id in self.own:
                return Unknown
            found = self.mode.constants.get(node.id, Unknown)
            found = self.program.constants.get(node.id, found)
            return self.known.get(node.id, Unknown) if found is Unknown else found
        if isinstance(node, ast.Attribute):
            owner = self._value(node.value)
            plain = isinstance(owner, ModuleType) and owner is not cuda
            return getattr(owner, node.attr) if plain else Unknown
        return Unknown

    def _tree(self, node: ast.expr) -> Any:
        """The tree of an expression, None where it is not known."""
        if isinstance(node, ast.Name):
            return self.trees.get(node.id)
        if isinstance(node, ast.Constant) and node.value is None:
            return NEVER
        if isinstance(node, ast.Attribute):
            owner = self._tree(node.value)
            return dict(owner[1]).get(node.attr) if isinstance(owner, tuple) else None
        if isinstance(node, ast.IfExp):
            test = self.visit(copy.deepcopy(node.test))
            known = isinstance(test, ast.Constant)
            return self._tree(node.body if test.value else node.orelse) if known else None
        if isinstance(node, ast.Call):
            called = self._value(node.func)
            if hasattr(called, "like"):
                return self._tree(node.args[called.like])
            if isinstance(called, type) and hasattr(called, "_fields"):
                given = list(zip(called._fields, node.args, strict=False))
                given += [(word.arg, word.value) for word in node.keywords]
                return called, tuple((name, self._tree(one)) for name, one in given)
        return None

    def visit_Name(self, node: ast.Name) -> ast.expr:
        if not isinstance(node.ctx, ast.Load):
            return node
        return self._meant(node, self._value(node))

    def visit_Attribute(self, node: ast.Attribute) -> ast.expr:
        found = self._value(node)
        if found is not Unknown:
            return self._meant(node, found)
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
        if isinstance(value, Written):
            return ast.Name(self.program.text(*value), ast.Load())
        if isinstance(value, bool):
            return ast.Constant(value)
        if isinstance(value, int | float) and not isinstance(value, np.generic):
            return self._number(value)
        value = self._stand_in(value)
        if isinstance(value, type) or not is_function(value):
            return ast.Name(self.program.bind(value, _hint(node)), ast.Load())
        return ast.Name(self.program.function(value, self.mode, {}), ast.Load())

    def _stand_in(self, value: Any) -> Any:
        """What stands on a card for a value."""
        return self.mode.stands_in.get(value, value) if value.__hash__ is not None else value

    # ---- numbers -----------------------------------------------------------------------------

    def _number(self, value) -> ast.expr:
        """A plain number in the precision in which the processor takes it."""
        if isinstance(value, float) or (self.law and isinstance(value, int)):
            kind = np.float64 if self.double else self.program.real
            return ast.Name(self.program.bind(kind(value), "number"), ast.Load())
        return ast.Constant(value)

    def _constant(self, node: ast.expr) -> Any:
        """The value of an expression of numbers alone; they are doubles, as Python's are."""
        if isinstance(node, ast.Constant):
            return node.value if type(node.value) in (int, float) else Unknown
        if isinstance(node, ast.Name | ast.Attribute):
            found = self._value(node)
            return found if type(found) in (int, float) else Unknown
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
            found = self._constant(node.operand)
            return found if found is Unknown else -found
        if isinstance(node, ast.BinOp):
            parts = self._constant(node.left), self._constant(node.right)
            if Unknown in parts:
                return Unknown
            expression = ast.Expression(ast.BinOp(*map(ast.Constant, parts[:1]), node.op,
                                                  ast.Constant(parts[1])))  # fmt: skip
            return eval(compile(ast.fix_missing_locations(expression), "<number>", "eval"))
        return Unknown

    def visit_Constant(self, node: ast.Constant) -> ast.expr:
        return self._number(node.value) if type(node.value) in (int, float) else node

    def visit_UnaryOp(self, node: ast.UnaryOp) -> ast.expr:
        found = self._constant(node)
        return self.generic_visit(node) if found is Unknown else self._number(found)

    def visit_BinOp(self, node: ast.BinOp) -> ast.expr:
        found = self._constant(node)
        if found is not Unknown:
            return self._number(found)
        if isinstance(node.op, ast.Pow) and isinstance(node.right, ast.Constant):
            return ast.Call(self._power(node.right.value), [self.visit(node.left)], [])
        return self.generic_visit(node)

    def _power(self, n: int) -> ast.expr:
        """The function x ** n, by squaring (lanes/lanes.py)."""
        name = f"power_{n}".replace("-", "less")
        if name not in self.program.space:
            lines, square, total, left = [f"def {name}(x):"], "x", "", abs(n)
            while left:
                if left & 1:
                    total = f"({total} * {square})" if total else square
                left >>= 1
                square = f"({square} * {square})"
            one = self.program.bind(self.program.real(1.0), "number")
            lines.append(f"    return {one} / {total}" if n < 0 else f"    return {total}")
            self.program.text(name, "\n".join(lines))
        return ast.Name(name, ast.Load())

    def visit_Subscript(self, node: ast.Subscript) -> ast.expr:
        law, self.law = self.law, False  # what indexes or slices stays a whole number
        index = self.visit(node.slice)
        self.law = law
        return ast.Subscript(self.visit(node.value), index, node.ctx)

    # ---- calls -------------------------------------------------------------------------------

    def visit_Call(self, node: ast.Call) -> ast.expr:
        called = self._value(node.func)
        if called is np.float64 and self._constant(node.args[0]) is not Unknown:
            number = np.float64(self._constant(node.args[0]))
            return ast.Name(self.program.bind(number, "double"), ast.Load())
        if isinstance(node.func, ast.Name) and node.func.id in ("min", "max"):
            if node.func.id not in self.own and called is Unknown:
                return self._bounded(node)
        stands = self._stand_in(called)
        if is_function(stands) and getattr(stands, "py_func", stands) in self.mode.views:
            return self._view(getattr(stands, "py_func", stands), node)
        target = self._target(called, node)
        if target is None:
            return self.generic_visit(node)
        node.args = [self.visit(one) for one in node.args]
        for one in node.keywords:
            one.value = self.visit(one.value)
        return ast.Call(ast.Name(target, ast.Load()), node.args, node.keywords)

    def _target(self, called: Any, node: ast.Call) -> str | None:
        """The name of what a call calls, None where it is no function of ours."""
        called = self._stand_in(called)
        if not is_function(called):
            return None
        if hasattr(called, "table"):
            called = called.table[self._tree(node.args[0])[0]]
        elif called.__module__ == laws.__name__:
            law = self._tree(node.args[0])
            if called is laws.lane_state:
                return self._state(law[0])
            if called is laws.store_state:
                return self._state(dict(self.trees)["law"][0], puts=True)
            called = getattr(law_owner(original(law[0])), called.__name__)
        names = list(inspect.signature(getattr(called, "py_func", called)).parameters)
        trees = {n: self._tree(a) for n, a in zip(names, node.args, strict=False)}
        trees |= {word.arg: self._tree(word.value) for word in node.keywords if word.arg}
        return self.program.function(
            called, self.mode, {n: tree for n, tree in trees.items() if tree is not None}
        )

    def _view(self, plain: FunctionType, node: ast.Call) -> ast.expr:
        """What a call of a function returns that is made of `if ...: return ...` alone: a part of
        an array, which functions of a card cannot hand back."""
        made = ast.parse(textwrap.dedent(inspect.getsource(plain))).body[0]
        assert isinstance(made, ast.FunctionDef)
        names = [one.arg for one in made.args.args]
        given = dict(zip(names, map(self.visit, node.args), strict=True))
        inside = Change(self.program, plain, self.mode, {})
        found: ast.expr | None = None
        for line in reversed(made.body):
            if isinstance(line, ast.Return):
                found = inside.visit(line.value)
            elif isinstance(line, ast.If):
                found = ast.IfExp(inside.visit(line.test), inside.visit(line.body[0].value), found)
        return _Given(given).visit(found)

    def _state(self, law: type, puts: bool = False) -> str:
        """lane_state or store_state (lanes/laws.py) of one particle."""
        count = state_channels(original(law))
        name = f"{'put' if puts else 'take'}_state_{count}"
        if name not in self.program.space:
            if puts:
                lines = [f"    f[at + {c} * cap] = state[{c}]" for c in range(count)]
                text = "\n".join([f"def {name}(f, at, cap, state):", *lines])
            else:
                found = ", ".join(f"f[at + {c} * cap]" for c in range(count))
                text = f"def {name}(law, f, at, cap):\n    return ({found},)"
            self.program.text(name, text)
        return name

    def _bounded(self, node: ast.Call) -> ast.expr:
        """min and max as Python has them: the first of what is equal, or is no number."""
        assert isinstance(node.func, ast.Name)
        name = f"plain_{node.func.id}"
        if name not in self.program.space:
            sign = "<" if node.func.id == "min" else ">"
            self.program.text(name, f"def {name}(a, b):\n    return b if b {sign} a else a")
        total = self.visit(node.args[0])
        for one in node.args[1:]:
            total = ast.Call(ast.Name(name, ast.Load()), [total, self.visit(one)], [])
        return total

    # ---- branches that are known -------------------------------------------------------------

    def visit_Compare(self, node: ast.Compare) -> ast.expr:
        if len(node.ops) == 1 and isinstance(node.ops[0], ast.Is | ast.IsNot):
            tree, right = self._tree(node.left), node.comparators[0]
            if isinstance(right, ast.Constant) and right.value is None:
                none = tree is NEVER
                return ast.Constant(none if isinstance(node.ops[0], ast.Is) else not none)
        return self.generic_visit(node)

    def visit_BoolOp(self, node: ast.BoolOp) -> ast.expr:
        decides = isinstance(node.op, ast.Or)
        values = []
        for one in node.values:
            one = self.visit(one)
            if isinstance(one, ast.Constant) and isinstance(one.value, bool):
                if one.value == decides:
                    return ast.Constant(decides) if not values else ast.BoolOp(
                        node.op, [*values, one]
                    )  # fmt: skip
                continue
            values.append(one)
        if not values:
            return ast.Constant(not decides)
        return values[0] if len(values) == 1 else ast.BoolOp(node.op, values)

    def visit_IfExp(self, node: ast.IfExp) -> ast.expr:
        test = self.visit(node.test)
        if isinstance(test, ast.Constant):
            return self.visit(node.body if test.value else node.orelse)
        return ast.IfExp(test, self.visit(node.body), self.visit(node.orelse))

    def visit_If(self, node: ast.If):
        test = self.visit(node.test)
        if isinstance(test, ast.Constant):
            return self.block(node.body if test.value else node.orelse, empty=True)
        return ast.If(test, self.block(node.body), self.block(node.orelse, empty=True))

    def visit_For(self, node: ast.For) -> ast.stmt:
        return ast.For(node.target, self.visit(node.iter), self.block(node.body), [])

    def visit_While(self, node: ast.While) -> ast.stmt:
        return ast.While(self.visit(node.test), self.block(node.body), [])

    def visit_Assign(self, node: ast.Assign) -> ast.stmt:
        tree = self._tree(node.value)
        if tree is not None and isinstance(node.targets[0], ast.Name):
            self.trees[node.targets[0].id] = tree
        return self.generic_visit(node)

    def block(self, lines: list[ast.stmt], empty: bool = False) -> list[ast.stmt]:
        """Statements, without what is never run."""
        found: list[ast.stmt] = []
        for line in lines:
            one = self.visit(line)
            found += one if isinstance(one, list) else [one]
        return found if found or empty else [ast.Pass()]


class _Given(ast.NodeTransformer):
    """Puts expressions in the place of names."""

    def __init__(self, given: dict[str, ast.expr]):
        self.given = given

    def visit_Name(self, node: ast.Name) -> ast.expr:
        return copy.deepcopy(self.given.get(node.id, node))


def _hint(node: ast.expr) -> str:
    return node.id if isinstance(node, ast.Name) else node.attr if hasattr(node, "attr") else "it"
