"""Parameters that a launch passes to a kernel: 8 bytes each, arrays as numba passes them."""

import struct
from typing import NamedTuple

import numpy as np
import pytest

pytest.importorskip("numba_cuda", reason="the extra `cuda` is not installed")
launch = pytest.importorskip("vgmpi.solver.engines.cuda.kernel_launch")


class Table(NamedTuple):
    rows: object
    number: int
    factor: float


class Array:
    """An array of a GPU, at an address."""

    def __init__(self, address, shape, kind):
        host = np.zeros(shape, kind)
        self.shape, self.strides, self.dtype = host.shape, host.strides, host.dtype
        self.size, self.ndim = host.size, host.ndim
        self.device_ctypes_pointer = type("Pointer", (), {"value": address})


def test_parameters_are_those_of_numba():
    table = launch.argument_of(Table(Array(4096, (5, 3), np.int32), 7, 0.5))
    array = struct.pack("<9q", 0, 0, 15, 4, 4096, 5, 3, 12, 4)
    assert table.parameters == array + struct.pack("<d", 0.5)  # 7 is known to the kernel
    single = launch.argument_of(np.float32(1.5)).parameters
    assert len(single) == 8 and single[:4] == struct.pack("<f", 1.5)
    assert launch.argument_of(-3).parameters == struct.pack("<q", -3)
    assert launch.argument_of(None).parameters == b""


def test_one_kernel_serves_arguments_of_one_form():
    def form(number, kind=np.int32, shape=(5, 3)):
        return launch.argument_of(Table(Array(64, shape, kind), number, 0.5)).form

    assert form(7) == form(7, shape=(9, 3))
    assert len({form(7), form(8), form(7, np.int64), form(7, shape=(5,))}) == 4
