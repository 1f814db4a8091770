"""Messages between ranks that do not know who will speak to them, over MPI."""

import pytest

from tests.support.launch import mpirun


@pytest.mark.mpi
@pytest.mark.parametrize("n", [1, 2, 5])
def test_rows_arrive_in_order_round_after_round(n):
    job = mpirun(n, "-m", "tests.parallel.deliver_job")
    assert job.returncode == 0, job.stderr
    assert all(f"rank {r} done" in job.stdout for r in range(n))
