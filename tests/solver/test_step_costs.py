"""What a step must not cost: memory, and time beside its kernels."""

import gc
import logging
import math
import tracemalloc
from types import SimpleNamespace

import numpy as np
import pytest
from numba.core.runtime import _nrt_python, rtsys

from tests.support import simulated_ranks
from tests.support.simulate import begin
from tests.support.small_scenes import MIXED
from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.runtime.compiled_kernels import compiled_marker
from vgmpi.solver import compile_kernels
from vgmpi.tools.bench import vgmpi_contestant
from vgmpi.tools.bench.benchmark_case import Case, lay_out


@pytest.fixture
def mixed(tmp_path):
    """Walls of all kinds, three phases in contact, a collider; and a time step so short that no
    particle leaves its patch: a sort allocates."""
    simulation, _ = begin(tmp_path, MIXED.replace("PRECISION", "double"))
    dt = 0.001 * simulation.bound()
    for _ in range(2 * correction_period(simulation)):  # what is made once is there
        simulation.advance(dt)
    sorts = simulation.sorts
    yield simulation, dt
    assert simulation.sorts == sorts


def correction_period(simulation):
    """Steps after which transfers are corrected and particles shifted in the same step again."""
    shifting = simulation.features["shifting"]
    return math.lcm(simulation.plan.correction_interval, shifting.correction_interval)


def compiled_allocations(simulation, dt):
    """In as many steps as all corrections take; an array that goes into compiled code counts as
    one."""
    _nrt_python.memsys_enable_stats()
    try:
        before = rtsys.get_allocation_stats().alloc
        for _ in range(correction_period(simulation)):
            simulation.advance(dt)
        return rtsys.get_allocation_stats().alloc - before
    finally:
        _nrt_python.memsys_disable_stats()


def test_compiled_code_allocates_nothing_in_its_loops(mixed):
    """As much for all segments and blocks as for one of each."""
    simulation, dt = mixed
    for_all = compiled_allocations(simulation, dt)

    def first(of, kernel, rows, *arguments):
        if len(rows):
            simulation.engine.run(of, kernel, rows[:1], *arguments)

    simulation.engine.call_if_rows = first
    assert for_all == compiled_allocations(simulation, dt)


def test_nothing_a_step_allocates_stays(mixed):
    """Python keeps a store of freed tuples and numbers, which fills within a few thousand steps and
    is emptied by a full garbage collection. What a step keeps grows for ever."""
    simulation, dt = mixed
    steps, windows = 500, 3
    limit = 6 * steps * windows  # [bytes], less than a pointer per step
    growths = []
    gc.disable()
    tracemalloc.start()
    try:
        while len(growths) < windows or (len(growths) < 20 and sum(growths[-windows:]) >= limit):
            before = tracemalloc.get_traced_memory()[0]
            tracemalloc.reset_peak()
            for _ in range(steps):
                simulation.advance(dt)
            after, peak = tracemalloc.get_traced_memory()
            growths.append(after - before)
    finally:
        tracemalloc.stop()
        gc.enable()
    assert sum(growths[-windows:]) < limit, growths
    assert peak - before < 20_000


def test_an_empty_step_moves_nothing(tmp_path):
    """What `python -m tests.benchmarks overhead` times: kernels are called, and do nothing."""
    lay_out(Case("fluid", 64), ["single"], tmp_path)
    contestant = vgmpi_contestant.Contestant(
        {"folder": str(tmp_path / "single"), "ranks": 1, "threads": 1}
    )
    found = contestant.empty(100)  # Python keeps a store of freed tuples, which fills first
    assert 0 < found["us"] < 1e6 and found["stays"] < 100
    simulation = contestant.simulation
    (group,) = simulation.groups
    start = group.xi.copy()
    assert simulation.step > 200 and simulation.sorts == 1
    contestant.restart()
    assert (start == contestant.simulation.groups[0].xi).all()
    contestant.step()
    assert (start != contestant.simulation.groups[0].xi).any(), "kernels stayed empty"


def test_ranks_on_different_processors_are_told(caplog):
    kinds = ["znver5 00000001", "znver5 00000001", "haswell 00000002"]

    class Told:
        """Three ranks as one: `all_rows` gives what each would say."""

        def all_rows(self, row):
            rows = [np.frombuffer(kind.encode().ljust(96), np.uint8) for kind in kinds]
            return np.stack(rows)

    compile_kernels._same_processor(Told())
    assert "rank 0: znver5 00000001, rank 2: haswell 00000002" in caplog.text
    assert "NUMBA_CPU_NAME" in caplog.text


def test_ranks_on_equal_processors_are_not(caplog):
    simulated_ranks.run(3, compile_kernels._same_processor)
    assert caplog.text == ""


def test_the_first_compilation_is_told(tmp_path, monkeypatch, caplog):
    """Before it begins, and where nothing is left to compile not at all."""
    plan = SimpleNamespace(groups=[], real=np.float32)
    there = tmp_path / "new" / "seal.compiled"
    seen = []
    monkeypatch.setattr(compile_kernels, "compiled_marker", lambda *kind: there)
    monkeypatch.setattr(compile_kernels, "_run_all", lambda plan: seen.append(caplog.messages[:]))
    with caplog.at_level(logging.INFO, "vgmpi"):
        compile_kernels.compile_kernels(plan, SerialCommunicator())
        (line,) = caplog.messages
        assert line.startswith("compiling for this processor, once for these materials: ")
        assert seen == [[line]] and there.exists()
        compile_kernels.compile_kernels(plan, SerialCommunicator())
    assert caplog.messages == [line]


def test_ranks_compile_shares_of_a_step(tmp_path, monkeypatch):
    """Without its kernels a step tells all that it calls, and no rank begins what another has."""
    lay_out(Case("fluid", 64), ["single"], tmp_path)
    flags = {"folder": str(tmp_path / "single"), "ranks": 1, "threads": 1}
    plan = vgmpi_contestant.Contestant(flags).start[1]
    calls, begun = [], []
    compile_kernels._run_all(plan, calls)
    assert {"particles_to_grid", "update", "grid_to_particles"} <= {
        kernel.py_func.__name__ for kernel, *_ in calls
    }
    monkeypatch.setattr(compile_kernels, "is_begun", lambda *call: call[0] in begun)
    monkeypatch.setattr(
        compile_kernels, "precompiled_entry", lambda kernel, *_: begun.append(kernel)
    )
    compile_kernels.compile_share(plan, 1, 2, False)
    assert begun[0] is calls[len(calls) // 2][0]
    assert set(begun) == {kernel for kernel, *_ in calls} and len(begun) == len(set(begun))


def test_a_share_that_fails_is_left_to_the_run(tmp_path, monkeypatch):
    def fails(*_):
        raise ZeroDivisionError

    monkeypatch.setattr(compile_kernels, "_run_all", fails)
    compile_kernels.compile_share(SimpleNamespace(), 0, 2, False)


def test_stamps_tell_kernels_apart():
    assert compiled_marker("fluid", np.dtype(np.float32)) == compiled_marker(
        "fluid", np.dtype(np.float32)
    )
    assert compiled_marker("fluid", np.dtype(np.float32)) != compiled_marker(
        "fluid", np.dtype(np.float64)
    )
