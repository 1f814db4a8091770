"""Keys of compiled code cover all sources that the code can be made of."""

import importlib
import pkgutil
import sys

import numpy as np
import pytest

import vgmpi.solver.simulation  # noqa: F401  (imports all kernels)
from vgmpi.materials import registry
from vgmpi.materials.material import FUNCTIONS
from vgmpi.runtime import compile_cache, compile_key
from vgmpi.runtime.source_digest import sources_seen_by

KERNELS = sorted(name for name in compile_cache.KEPT if name.startswith("vgmpi.kernels."))


def dispatched():
    """Yield (stub, kind, function) of all that is chosen by the type of a kind."""
    for name, module in sorted(sys.modules.items()):
        if name.startswith("vgmpi.kernels."):
            for stub in vars(module).values():
                if isinstance(getattr(stub, "table", None), dict) and stub.__module__ == name:
                    yield from ((stub, *one) for one in stub.table.items())


def test_a_kind_sees_what_is_done_for_it():
    rows = list(dispatched())
    assert len(rows) > 40
    for stub, kind, function in rows:  # who calls the stub imports its module
        seen = sources_seen_by([kind.__module__, stub.__module__])
        assert function.__module__ in seen, (stub.__name__, kind)


@pytest.mark.parametrize("kind", registry)
def test_a_law_sees_its_functions(kind):
    seen = sources_seen_by([registry[kind].Law.__module__])
    assert {getattr(registry[kind], name).__module__ for name in FUNCTIONS} <= set(seen)


def test_who_sees_vectors_sees_what_is_registered_for_them():
    """What numpy and operators do with vectors is registered, not imported by its user."""
    registers = {"vgmpi.kernels.simd.vector16", "vgmpi.kernels.simd.math_functions"}
    for name in KERNELS:
        seen = set(sources_seen_by([name])) & registers
        laws = "vgmpi.kernels.simd.material_dispatch" in sources_seen_by([name])
        assert seen == registers if laws else "vgmpi.kernels.simd.math_functions" not in seen


def test_a_law_is_seen_by_its_own_kernels_alone():
    for name in ("vgmpi.kernels.transfer.p2g", "vgmpi.kernels.transfer.g2p"):
        assert "vgmpi.materials.snow" not in sources_seen_by([name])


def test_what_only_annotations_name_is_not_seen():
    seen = sources_seen_by(["vgmpi.kernels.grid.update"])
    assert "vgmpi.kernels.grid.contact" in seen and "vgmpi.planning.plan" not in seen


def test_every_module_can_be_followed():
    for one in pkgutil.walk_packages(importlib.import_module("vgmpi").__path__, "vgmpi."):
        assert one.name in sources_seen_by([one.name])


@pytest.mark.parametrize(
    "one, other",
    [
        (1, 1.0), (0.0, -0.0), (1, True), ("a", b"a"), ((1, 2), [1, 2]), (None, "None"),
        (np.float32(1), np.float64(1)), (np.zeros(2), np.zeros((1, 2))), (np.zeros(2), np.ones(2)),
        ({"a": 1}, {"a": 2}), (lambda x: x + 1, lambda x: x + 2), (lambda x=1: x, lambda x=2: x),
    ],
)  # fmt: skip
def test_values_are_told_apart(one, other):
    content = compile_key._Content()
    assert content.text(one) != content.text(other)


def test_sets_are_told_in_an_order_of_their_own():
    content = compile_key._Content()
    assert content.text({"a", "b", "c"}) == content.text({"c", "b", "a"})


def test_what_has_no_content_has_no_key():
    with pytest.raises(compile_key.NoKeyError):
        compile_key._Content().text(object())
