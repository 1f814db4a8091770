"""Runs with files on simulated ranks, in this process: what `launch.go` does without mpirun.

A rank of mpirun takes four seconds of a processor before its first step; these take none.
"""

from pathlib import Path

from tests.support import simulated_ranks
from vgmpi.commands.flags import parse_arguments
from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.scene.loader import load
from vgmpi.solver.run import prepared_run
from vgmpi.solver.run_options import Options


def run_here(scene, out, n, *flags, code=0):
    """Run a scene into the folder `out` on n simulated ranks; it ends with this exit code.

    Args:
        scene: Path of its file.
        out: Folder of the run.
        n: Number of ranks.
        *flags: Flags of the command line.
        code: Exit code of the run on every rank.
    """
    args = parse_arguments([str(scene), *map(str, flags)])

    def run_on_rank(ranks: SerialCommunicator) -> int:
        """Run to the end on one rank."""
        options = Options(
            Path(out), args.threads, args.engine, args.resume, args.stop_steps, args.stop_seconds,
            args.overwrite, args.change,
        )  # fmt: skip
        with prepared_run(load(scene, args.set), ranks, options) as run:
            return run.run()

    codes = [run_on_rank(SerialCommunicator())] if n == 1 else simulated_ranks.run(n, run_on_rank)
    assert codes == [code] * n
