"""Kernels compiled without a card, for any: how many registers they take, what they spill."""

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

from ...domain.state import Group
from . import memory
from .engine import Cuda
from .group import CardGroup
from .launch import Launcher, form_of, numbers_of

# shared memory [bytes] and threads of a multiprocessor; every block takes 1 KiB of it for itself
CARDS = {80: ("A100", 167936, 2048), 90: ("H100", 233472, 2048)}
REGISTERS = 65536


class Compiled(NamedTuple):
    """A kernel for a kind of card."""

    name: str
    law: str  # or "-"
    card: int  # compute capability: 80, 90
    threads: int  # of a block
    registers: int
    stack: int  # bytes of a thread's own arrays
    spilled: int  # bytes
    shared: int  # bytes of a block
    ptx: str

    @property
    def warps(self) -> int:
        """Warps that fit on a multiprocessor at a time, of 64."""
        _, room, most = CARDS[self.card]
        warps = -(-self.threads // 32)
        by_registers = REGISTERS // (-(-self.registers * 32 // 256) * 256 * warps)
        blocks = min(room // (self.shared + 1024), by_registers, most // self.threads, 32)
        return blocks * warps

    def count(self, pattern: str) -> int:
        """Instructions that a pattern finds in the PTX."""
        return len(re.findall(pattern, self.ptx, re.MULTILINE))


class _Host(np.ndarray):
    """An array of the host's that is handled as the card's are."""

    def copy_to_host(self, to=None):
        if to is None:
            return np.array(self)
        to[...] = self
        return to

    def copy_to_device(self, array):
        self[...] = array


def _kept(array):
    return np.array(array).view(_Host)


NO_CARD = SimpleNamespace(
    to_device=_kept, device_array=lambda shape, kind: _kept(np.zeros(shape, kind))
)


class Compiler(Launcher):
    """Compiles what is launched, and runs nothing."""

    cards: tuple[int, ...] = ()
    only: tuple[str, ...] = ()  # names of functions; none: all
    found: dict[tuple, Compiled] = {}  # noqa: RUF012  (one table for all programs of a scene)

    def launch(self, blocks, mode, function, *arguments):
        wanted = not self.only or function.__name__ in self.only
        for card in self.cards if wanted else ():
            key = id(self), function, card, tuple(map(form_of, arguments))
            if key not in self.found:
                self.found[key] = self._made(mode, function, arguments, card)

    def _made(self, mode, function, arguments, card: int) -> Compiled:
        made = self.kernel(mode, function, arguments).kernel.py_func
        kinds = types.void(*map(_type, numbers_of(arguments)))  # type: ignore[attr-defined]
        ptx, _ = cuda.compile_ptx(made, kinds, cc=divmod(card, 10))
        laws = [type(one).__name__ for one in arguments if type(one).__name__.endswith("Law")]
        name = function.__name__
        if name == "fill":  # a kernel for each kind of contribution
            name = f"fill {type(arguments[1]).__name__.lower()}"
        return Compiled(
            name, (laws or ["-"])[0].removesuffix("Law").lower(), card, self.threads,
            *assembled(ptx, card), ptx,
        )  # fmt: skip


class _SortedByHost(CardGroup):
    """Particles that are sorted although nothing runs."""

    tag, aim, arrange = Group.tag, Group.aim, Group.arrange
    permute, segment_of = Group.permute, Group.segment_of


class CompiledOnly(Cuda):
    """An engine whose kernels are compiled and not run. Of its simulations the step's parts may be
    called, not more: nothing moves."""

    LAUNCHER, GROUP = Compiler, _SortedByHost


def _type(one):
    """numba's type of an argument of a launch."""
    if isinstance(one, np.ndarray):
        return types.Array(numpy_support.from_dtype(one.dtype), one.ndim, "C")
    if isinstance(one, bool | np.bool_):
        return types.boolean
    if isinstance(one, np.generic):
        return numpy_support.from_dtype(one.dtype)
    return types.int64 if isinstance(one, int) else types.float64


def assembler() -> str:
    """ptxas: that of the package nvidia-cuda-nvcc, or one on the path."""
    places = Path(sysconfig.get_paths()["purelib"]).glob("nvidia/**/bin/ptxas")
    return str(next(places, "ptxas"))


def assembled(ptx: str, card: int) -> tuple[int, int, int, int]:
    """Registers, bytes of stack, bytes spilled, bytes of shared memory of a kernel. Raises
    RuntimeError where it is no machine code."""
    said = subprocess.run(
        [assembler(), "-v", f"-arch=sm_{card}", "-", "-o", "/dev/null"], input=ptx, text=True,
        capture_output=True,
    )  # fmt: skip
    if said.returncode:
        raise RuntimeError(said.stderr.strip().splitlines()[-1])
    registers = re.search(r"Used (\d+) registers", said.stderr)
    spilled = re.search(
        r"(\d+) bytes stack frame, (\d+) bytes spill stores, (\d+) bytes spill loads", said.stderr
    )
    assert registers and spilled
    stack, stores, loads = map(int, spilled.groups())
    shared = re.search(r"(\d+) bytes smem", said.stderr)
    return int(registers[1]), stack, stores + loads, int(shared[1]) if shared else 0


def without_card(cards: tuple[int, ...], only: tuple[str, ...] = ()) -> type[Cuda]:
    """The engine that compiles for these compute capabilities, on a machine without a card. only:
    names of kernels, where not all are wanted."""
    memory.WHERE[0] = NO_CARD
    # a kernel that calls functions asks for the card it is compiled on
    dispatcher.get_current_device = lambda: SimpleNamespace(compute_capability=(8, 0))
    Compiler.cards, Compiler.found, Compiler.only = cards, {}, only
    return CompiledOnly


def kernels_of(simulation) -> list[Compiled]:
    """What a step of a simulation launches, compiled; it does not run."""
    engine = simulation.engine
    engine.begin(1e-5, simulation.gravity, 1.0)
    for border in (True, False):
        engine.fill(border)
    for border in (False, True):
        engine.update(border)
    engine.gather(0)
    if simulation.plan.restores:
        engine.begin(0.0, simulation.gravity, 1.0)
        engine.update(False)
        engine.restore(1)
    for group in simulation.groups:  # and what a sort launches
        tags, _ = CardGroup.tag(group)
        CardGroup.aim(group, tags, np.zeros((len(group.start), 27), np.int64), 1)
        CardGroup.arrange(group, tags, np.zeros(64, np.int64), 0, np.zeros(1, np.int64))
    return list(Compiler.found.values())
