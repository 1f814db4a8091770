"""`python -m tests.benchmarks NAME`: what only makers of this program ask: studies of its
steps, sorts, registers, of many ranks on paper, of another checkout.
"""

import argparse
import sys

from tests.benchmarks.commands import COMMANDS
from vgmpi.io.run_reader import RunError
from vgmpi.runtime.command_line import exit_code_from_exceptions
from vgmpi.tools.bench.benchmark_case import BenchError
from vgmpi.tools.bench.subcommands import parse_arguments, run_command

PROGRAM = "python -m tests.benchmarks"


def arguments(argv: list[str]) -> argparse.Namespace:
    """The flags."""
    return parse_arguments(PROGRAM, __doc__, COMMANDS, argv)


@exit_code_from_exceptions
def main(argv: list[str] | None = None) -> int:
    """Run the command; returns the exit code."""
    words = sys.argv[1:] if argv is None else argv
    return run_command(PROGRAM, arguments(words), (BenchError, ImportError, RunError))


if __name__ == "__main__":
    sys.exit(main())
