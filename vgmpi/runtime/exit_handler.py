"""Exit codes of a command for everything that nobody foresaw."""

import contextlib
import errno
import functools
import io
import os
import sys
from collections.abc import Callable
from typing import Any, cast

from .terminal_output import escaped_output

BUG_REPORT_HINT = (
    "vgmpi: this is a fault of the program, not of what it was given: please report it with all"
    " that is printed here, the command and the scene (CONTRIBUTING.md)"
)

FULL = (errno.ENOSPC, errno.EDQUOT)  # no room left on a disk, or for this user
DENIED = (errno.EROFS, errno.EACCES, errno.EPERM)  # by the file system or its permissions


def report_file_error(error: OSError, path: object = "") -> int:
    """Print the file of an error and its reason in one line; return the exit code.

    Args:
        error: The error.
        path: File that is named if the error names none.

    Returns:
        1 for a full disk, which a run meets when all that was asked for was right; else 2.
    """
    sys.stderr.write(f"vgmpi: {error.filename or path}: {error.strerror or error}\n")
    return 1 if error.errno in FULL else 2


def exit_code_from_exceptions(main: Callable[..., int]) -> Callable[..., int]:
    """Decorate the main function of a command: every way out of it becomes an exit code.

    1: a fault of the program, with its traceback and where to report it; memory exhausted; a full
    disk, also behind stdout. 2: a file or folder that may not be written (`report_file_error`).
    130: interrupted. 141: the reader of stdout has gone (`| head`). With several ranks
    `sys.excepthook` ends them all (parallel/communicator.py). Control characters in what the
    command writes are written as escapes.
    """

    @functools.wraps(main)
    def command(*arguments: Any, **keywords: Any) -> int:
        """Run the main function; return an exit code in any case."""
        with contextlib.suppress(AttributeError):  # stdout may be another object
            # the terminal may lack letters of a title
            cast(io.TextIOWrapper, sys.stdout).reconfigure(errors="backslashreplace")
        with escaped_output():
            return _run(main, arguments, keywords)

    return command


def _run(main: Callable[..., int], arguments: tuple, keywords: dict) -> int:
    """Run a main function; return an exit code in any case."""
    try:
        code = main(*arguments, **keywords)
        sys.stdout.flush()
        return code
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:
        _silence_stdout()
        return 128 + 13  # the code of a program that SIGPIPE ends
    except Exception as error:
        if isinstance(error, OSError) and _stdout_is_full():
            _silence_stdout()
            sys.stderr.write(f"vgmpi: cannot write to stdout: {error.strerror}\n")
            return 1
        if isinstance(error, OSError) and error.errno in (*FULL, *DENIED) and error.filename:
            return report_file_error(error)
        memory = isinstance(error, MemoryError)
        message = (
            f"vgmpi: out of memory: {error or 'no more is left'}" if memory else BUG_REPORT_HINT
        )
        sys.stderr.write(f"{message}\n")
        sys.excepthook(type(error), error, error.__traceback__)
        return 1


def usage_error_code(error: Exception) -> int:
    """Return the exit code for an error that is printed in one line.

    It is 2, for what the user can correct, but 1 for a disk that is full while files are written,
    as in a run. Programs such as ffmpeg tell it by the text of the system only.
    """
    full = [os.strerror(number) for number in FULL]
    return 1 if any(text in str(error) for text in full) else 2


def _stdout_is_full() -> bool:
    """Return whether another line on stdout fails."""
    try:
        sys.stdout.write("\n")
        sys.stdout.flush()
    except OSError:
        return True
    return False


def _silence_stdout() -> None:
    """Discard the output that is left, of which Python would complain at its end."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
