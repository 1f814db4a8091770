"""Measures of the board are not part of the times that it tells."""

import time

import numpy as np
import pytest

from vgmpi.tools.bench.board.board_cases import BoardState, VortexMeasure
from vgmpi.tools.bench.board.jet_and_block import JetMeasure


@pytest.mark.parametrize("kind", [VortexMeasure, JetMeasure])
def test_a_measure_leaves_no_thread_busy(kind):
    """Threads of a BLAS go on spinning into the next steps, whose processor time is told."""
    x = np.random.default_rng(1).uniform(0.0, 0.1, (100_000, 3))
    measure = kind(np.full(len(x), 1e-9), x, 0.01)
    measure.record(BoardState(0.1, x, x.astype(np.float32)))
    start = time.process_time()
    time.sleep(0.05)
    assert time.process_time() - start < 0.005
