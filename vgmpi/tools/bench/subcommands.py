"""Commands with subcommands: their flags are read, they run, and their errors become a line."""

import argparse
import math
import os
import sys
from collections.abc import Callable, Mapping
from pathlib import Path

from vgmpi.runtime.command_line import EXIT_USAGE, ArgumentParser
from vgmpi.runtime.config.schema import SceneError

from .benchmark_case import BenchError

# what a subcommand does, how its flags are added, how it runs
Command = tuple[str, Callable[[argparse.ArgumentParser], None], Callable[[argparse.Namespace], int]]


def parse_arguments(
    program: str, description: str | None, commands: Mapping[str, Command], argv: list[str]
) -> argparse.Namespace:
    """Read the flags of a subcommand.

    Args:
        program: What a user types before the subcommand.
        description: Text of its help.
        commands: Subcommands by their names.
        argv: Words of the command line.

    Returns:
        The flags, with `run` of the subcommand.
    """
    parser = ArgumentParser(prog=program, description=description)
    subparsers = parser.add_subparsers(dest="command", required=True)
    for name, (summary, add_flags, run) in commands.items():
        command = subparsers.add_parser(name, help=summary, description=summary)
        add_flags(command)
        command.set_defaults(run=run)
    return parser.parse_args(argv)


def run_command(
    program: str, arguments: argparse.Namespace, errors: tuple[type[Exception], ...]
) -> int:
    """Run a subcommand.

    Args:
        program: Name that stands before an error's line.
        arguments: Flags of `parse_arguments`.
        errors: Exceptions that a user can do something about.

    Returns:
        The exit code: 2 where a scene is wrong or one of the errors is raised, unless the error
        has an exit code of its own.
    """
    try:
        return arguments.run(arguments)
    except SceneError as error:
        print("\n".join(error.lines), file=sys.stderr)
    except errors as error:
        print(f"{program}: {error}", file=sys.stderr)
        return getattr(error, "exit_code", EXIT_USAGE)
    return EXIT_USAGE


def positive_number(text: str) -> int:
    """Return a positive whole number such as 1e5. Raises ValueError."""
    number = int(float(text))
    if number < 1:
        raise ValueError(text)
    return number


def positive_seconds(text: str) -> float:
    """Return a positive, finite time [s]. Raises ValueError."""
    seconds = float(text)
    if not 0.0 < seconds < math.inf:
        raise ValueError(text)
    return seconds


def check_file_can_be_written(path: Path) -> None:
    """Raise BenchError before minutes of measurement if a file of results cannot be written."""
    folder = path.absolute().parent
    if path.is_dir():
        raise BenchError(f"{path}: is a folder")
    if not folder.is_dir():
        raise BenchError(f"{path}: there is no folder {folder}")
    if not os.access(folder, os.W_OK):
        raise BenchError(f"{path}: may not be written")


def print_progress(line: str) -> None:
    """Print a line beside the results, at once."""
    print(line, file=sys.stderr, flush=True)
