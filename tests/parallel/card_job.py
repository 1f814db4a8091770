"""The program with a simulated card: `python -m tests.parallel.card_job SCENE --engine cuda`."""

import sys
import warnings

import tests.support.cuda_simulator  # noqa: F401  (before anything of numba's)

if __name__ == "__main__":
    warnings.filterwarnings("ignore", category=RuntimeWarning)
    from vgmpi.commands import cli

    sys.exit(cli.main(sys.argv[1:]))
