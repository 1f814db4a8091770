"""Device functions borrow arrays: none counts references, returns arrays or calls one that does.

A function that counts no references would never give back an array that it got from another
function, and would give one away that it does not own.
"""

import ast
import gc
import sys
from pathlib import Path

import numpy as np

import vgmpi
from tests.support.simulate import advance, begin

PACKAGE = Path(vgmpi.__file__).parent
SCENE = """
[domain]
size = [0.4, 0.4, 0.4]
cell = 0.04
boundary = { default = "slip", bottom = "separate" }
[time]
end = 1.0
[material.water]
kind = "fluid"
tait_coefficient = 3e3
[material.rubber]
kind = "elastic"
youngs_modulus = 1e4
[[object]]
name = "pool"
material = "water"
shape = { box = [[0, 0, 0], [0.4, 0.4, 0.12]] }
[[object]]
name = "ball"
material = "rubber"
shape = { sphere = { center = [0.2, 0.2, 0.2], radius = 0.08 } }
velocity = [0, 0, -1]
[[object]]
name = "post"
role = "scenery"
collider = true
shape = { box = [[0.28, 0, 0], [0.36, 0.4, 0.16]] }
"""


def decorated(name):
    """(file, function) of all functions with a decorator of this name."""
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.FunctionDef):
                if any(getattr(d, "id", "") == name for d in node.decorator_list):
                    yield path.relative_to(PACKAGE), node


def test_what_borrows_arrays_calls_no_array_function():
    views = {node.name for _, node in decorated("array_function")}
    assert "split_scratch" in views
    borrowers = [*decorated("device_function"), *decorated("borrowing_kernel")]
    assert "update" in {node.name for _, node in borrowers}
    wrong = [
        f"{path}: {node.name} calls {call.func.id}"
        for path, node in borrowers
        for call in ast.walk(node)
        if isinstance(call, ast.Call) and getattr(call.func, "id", "") in views
    ]
    assert not wrong


def test_transfers_count_references_once_per_segment():
    """Not at every node or particle: for those at walls it took a third of the gather."""
    of_bodies = {"rigid", "rigid_bodies", "colliders"}
    counting = {
        node.name for path, node in decorated("array_function") if not of_bodies & {*path.parts}
    }
    assert counting == {"split_scratch", "velocity_patch_of", "patch_of", "box_of"}


def arrays_within(value, seen):
    """All arrays in an object, its attributes, tuples, lists and dictionaries."""
    if id(value) in seen:
        return
    seen.add(id(value))
    if isinstance(value, np.ndarray):
        yield value
    elif isinstance(value, dict):
        for part in value.values():
            yield from arrays_within(part, seen)
    elif isinstance(value, (tuple, list)):
        for part in value:
            yield from arrays_within(part, seen)
    elif hasattr(value, "__dict__") and type(value).__module__.startswith("vgmpi"):
        yield from arrays_within(vars(value), seen)


def counts(simulation):
    """References to each array of a simulation, by identity."""
    gc.collect()
    return {id(a): sys.getrefcount(a) for a in arrays_within(simulation, set())}


def test_steps_leave_no_references_behind(tmp_path):
    simulation, _ = begin(tmp_path, SCENE)
    advance(simulation, 0.06)
    before = counts(simulation)
    for _ in range(6):
        simulation.advance(1e-5)
    after = counts(simulation)
    shared = before.keys() & after.keys()
    assert len(shared) > 50
    assert {k: after[k] - before[k] for k in shared if after[k] != before[k]} == {}
