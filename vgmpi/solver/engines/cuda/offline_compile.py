"""Offline compilation of kernels without a GPU: registers and spills for any architecture."""

import re
import subprocess
import sysconfig
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
from numba import cuda
from numba.cuda import dispatcher, types
from numba.cuda.np import numpy_support

from vgmpi.parallel.particle_group import ParticleGroup

from . import device_memory
from .cuda_engine import Cuda
from .device_group import CardGroup
from .kernel_launch import Launcher, argument_of, numbers_of

# [bytes, threads] Shared memory and threads of a multiprocessor; each block reserves 1 KiB.
CARDS = {80: ("A100", 167936, 2048), 90: ("H100", 233472, 2048)}
REGISTERS = 65536


class Compiled(NamedTuple):
    """Compiled kernel for one GPU architecture."""

    name: str
    law: str  # material law, or "-"
    card: int  # compute capability: 80, 90
    threads: int  # threads of a block
    registers: int
    stack: int  # [bytes] local arrays of a thread
    spilled: int  # [bytes] spill stores and loads
    shared: int  # [bytes] shared memory of a block
    link_time: bool  # whether a GPU would get other instructions, optimized when they are linked
    ptx: str

    @property
    def warps(self) -> int:
        """Number of warps that fit on a multiprocessor at a time, at most 64."""
        _, shared_memory, max_threads = CARDS[self.card]
        warps = -(-self.threads // 32)
        by_registers = REGISTERS // (-(-self.registers * 32 // 256) * 256 * warps)
        blocks = min(
            shared_memory // (self.shared + 1024), by_registers, max_threads // self.threads, 32
        )
        return blocks * warps

    def count(self, pattern: str) -> int:
        """Count the matches of a pattern in the PTX."""
        return len(re.findall(pattern, self.ptx, re.MULTILINE))


class _Host(np.ndarray):
    """Host array with the interface of a GPU array."""

    def copy_to_host(self, target=None):
        """Return a copy, or copy into `to`."""
        if target is None:
            return np.array(self)
        target[...] = self
        return target

    def copy_to_device(self, array):
        """Copy the values of an array into this one."""
        self[...] = array


def _host_array(array):
    return np.array(array).view(_Host)


NO_CARD = SimpleNamespace(
    to_device=_host_array, device_array=lambda shape, kind: _host_array(np.zeros(shape, kind))
)


class Compiler(Launcher):
    """Launcher that compiles kernels and runs nothing."""

    cards: tuple[int, ...] = ()
    only: tuple[str, ...] = ()  # names of functions; empty: all
    compiled: dict[tuple, Compiled] = {}  # noqa: RUF012  (one table for all translators of a scene)

    def launch(self, blocks, mode, function, *arguments):
        """Compile a kernel for each architecture, unless it was compiled before.

        Args:
            blocks: Number of blocks, not used.
            mode: Translation mode.
            function: Function of the kernel.
            arguments: Arguments whose types select the kernel.
        """
        is_requested = not self.only or function.__name__ in self.only
        for card in self.cards if is_requested else ():
            key = (
                id(self),
                function,
                card,
                tuple(argument_of(a).form for a in arguments),
            )
            if key not in self.compiled:
                self.compiled[key] = self._compile_for(mode, function, arguments, card)

    def _compile_for(self, mode, function, arguments, card: int) -> Compiled:
        kernel = self.kernel(mode, function, arguments).kernel
        signature = types.void(*map(_type, numbers_of(arguments)))  # type: ignore[attr-defined]
        ptx, _ = cuda.compile_ptx(kernel.py_func, signature, cc=divmod(card, 10))
        laws = [
            type(argument).__name__
            for argument in arguments
            if type(argument).__name__.endswith("Law")
        ]
        name = function.__name__
        if name == "fill":  # a kernel for each kind of contribution
            name = f"fill {type(arguments[1]).__name__.lower()}"
        return Compiled(
            name, (laws or ["-"])[0].removesuffix("Law").lower(), card, self.threads,
            *resource_usage(ptx, card), kernel.targetoptions["lto"], ptx,
        )  # fmt: skip


class _SortedByHost(CardGroup):
    """Particle group that the host sorts although no kernel runs."""

    tag, aim, arrange = ParticleGroup.tag, ParticleGroup.assign_targets, ParticleGroup.counting_sort
    permute, segment_of = ParticleGroup.permute, ParticleGroup.segment_of


class CompiledOnly(Cuda):
    """Engine whose kernels are compiled and not run.

    Only the parts of a step may be called on its simulations; nothing moves.
    """

    LAUNCHER, GROUP = Compiler, _SortedByHost


def _type(argument):
    """Return numba's type of a launch argument."""
    if isinstance(argument, np.ndarray):
        return types.Array(numpy_support.from_dtype(argument.dtype), argument.ndim, "C")
    if isinstance(argument, bool | np.bool_):
        return types.boolean
    if isinstance(argument, np.generic):
        return numpy_support.from_dtype(argument.dtype)
    return types.int64 if isinstance(argument, int) else types.float64


def assembler() -> str:
    """Return the path of ptxas, from the package nvidia-cuda-nvcc or the search path."""
    paths = Path(sysconfig.get_paths()["purelib"]).glob("nvidia/**/bin/ptxas")
    return str(next(paths, "ptxas"))


def resource_usage(ptx: str, card: int) -> tuple[int, int, int, int]:
    """Assemble a kernel and return registers, stack, spills and shared memory [bytes].

    Raises:
        RuntimeError: The PTX is not valid.
    """
    output = subprocess.run(
        [assembler(), "-v", f"-arch=sm_{card}", "-", "-o", "/dev/null"], input=ptx, text=True,
        capture_output=True,
    )  # fmt: skip
    if output.returncode:
        raise RuntimeError(output.stderr.strip().splitlines()[-1])
    registers = re.search(r"Used (\d+) registers", output.stderr)
    spilled = re.search(
        r"(\d+) bytes stack frame, (\d+) bytes spill stores, (\d+) bytes spill loads", output.stderr
    )
    assert registers and spilled
    stack, stores, loads = map(int, spilled.groups())
    shared = re.search(r"(\d+) bytes smem", output.stderr)
    return int(registers[1]), stack, stores + loads, int(shared[1]) if shared else 0


def offline_engine(cards: tuple[int, ...], only: tuple[str, ...] = ()) -> type[Cuda]:
    """Return the engine class that compiles on a machine without a GPU.

    Args:
        cards: Compute capabilities, for example 90.
        only: Names of kernels, empty for all.
    """
    device_memory.WHERE[0] = NO_CARD
    # A kernel that calls functions looks up the GPU it is compiled on.
    dispatcher.get_current_device = lambda: SimpleNamespace(compute_capability=(8, 0))
    Compiler.cards, Compiler.compiled, Compiler.only = cards, {}, only
    return CompiledOnly


def kernels_of(simulation) -> list[Compiled]:
    """Compile and return the kernels that a step of a simulation launches, without running it."""
    engine = simulation.engine
    engine.begin(1e-5, simulation.gravity, 1.0)
    for border in (True, False):
        engine.fill(border)
    for border in (False, True):
        engine.update(border)
    engine.gather(0)
    plan = simulation.plan
    own = [each.correction_kinds(1e-5, 0) for each in simulation.features.values()]
    kinds = next((each for each in own if each is not None), None)
    if plan.correction_interval or kinds is not None:
        engine.begin(0.0, simulation.gravity, 1.0, kinds)
        if engine.layers.requests.timeless:
            engine.fill(False)
        engine.update(False)
        engine.correct_transfers(1)
    for group in simulation.groups:  # the kernels of a sort as well
        tags, _ = CardGroup.tag(group)
        CardGroup.assign_targets(group, tags, np.zeros((len(group.start), 27), np.int64), 1)
        CardGroup.counting_sort(group, tags, np.zeros(64, np.int64), 0, np.zeros(1, np.int64))
    return list(Compiler.compiled.values())
