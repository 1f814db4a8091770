"""What all commands share: flags with errors of one line, exit codes, output without control codes.

Names in files (of COLMAP, glTF, .ply, materials, scenes) become parts of messages. Their control
characters are written as escapes, here and nowhere else, since each command writes through it: no
text from outside is an order to the terminal.
"""

import argparse
import contextlib
import errno
import functools
import io
import os
import re
import sys
from collections.abc import Callable, Iterator
from typing import Any, NoReturn, cast

from .message_text import did_you_mean

EXIT_USAGE = 2
_CHOICE = re.compile(r"invalid choice: '?(.*?)'? \(choose from (.*)\)", re.DOTALL)
BUG_REPORT_HINT = (
    "vgmpi: this is a fault of the program, not of what it was given: please report it with all"
    " that is printed here, the command and the scene (CONTRIBUTING.md)"
)
FULL = (errno.ENOSPC, errno.EDQUOT)  # no room left on a disk, or for this user
DENIED = (errno.EROFS, errno.EACCES, errno.EPERM)  # by the file system or its permissions
# C0 and C1 but for tab and newline, and what turns the direction of a line; a carriage return is of
# a progress bar at the start of a text, and of a line's end before a newline
_CONTROL = re.compile(
    "[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069]"
    "|(?!^)\r(?!\n)"
)


class ArgumentParser(argparse.ArgumentParser):
    """argparse.ArgumentParser with errors of one line in place of the usage."""

    def error(self, message: str) -> NoReturn:
        """Print what is wrong in one line and end the program with code 2."""
        hint = self._hint(message)
        line = " ".join(message.split())
        sys.stderr.write(f"{self.prog}: {line}{hint}; {self.prog} --help lists the flags\n")
        raise SystemExit(EXIT_USAGE)

    def _hint(self, message: str) -> str:
        """Return a suggestion for the first word that a message complains of, or ""."""
        choice = _CHOICE.search(message)
        if choice is not None:
            return did_you_mean(choice[1], re.findall(r"[\w.-]+", choice[2]))
        _, _, words = message.partition("unrecognized arguments: ")
        first = words.split("=")[0].split()[:1]
        if first and first[0].startswith("-"):
            return did_you_mean(first[0], self._option_string_actions)
        return ""


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


class EscapingStream:
    """Text stream whose control characters are written as escapes."""

    def __init__(self, stream: Any):
        """Write to another stream."""
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        """Return an attribute of the other stream."""
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write a text; return its length."""
        self._stream.write(_CONTROL.sub(_escape, text))
        return len(text)

    def writelines(self, lines: Any) -> None:
        """Write texts."""
        for line in lines:
            self.write(line)


def _escape(match: re.Match) -> str:
    """Return the escape of a character."""
    return match[0].encode("unicode_escape").decode()


@contextlib.contextmanager
def escaped_output() -> Iterator[None]:
    """Let stdout and stderr escape control characters while the block runs."""
    before = sys.stdout, sys.stderr
    if not isinstance(sys.stdout, EscapingStream):
        sys.stdout, sys.stderr = EscapingStream(before[0]), EscapingStream(before[1])
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before
