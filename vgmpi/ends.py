"""How a command ends when something happens that nobody foresaw."""

import contextlib
import functools
import os
import sys
from collections.abc import Callable
from typing import Any

REPORT = (
    "vgmpi: this is a fault of the program, not of what it was given: please report it with all"
    " that is printed here, the command and the scene (CONTRIBUTING.md)"
)


def guarded(main: Callable[..., int]) -> Callable[..., int]:
    """A decorator of a command's main function: every way out of it is an exit code.

    1: a fault of ours, with its traceback and where to report it; memory that is used up; a full
    disk behind stdout. 130: interrupted. 141: nobody reads what is printed any more (`| head`).
    Where several ranks run, `sys.excepthook` ends them all (domain/ranks.py).
    """

    @functools.wraps(main)
    def command(*arguments: Any, **named: Any) -> int:
        with contextlib.suppress(AttributeError):  # a stream that somebody put in its place
            # a title may have letters that the terminal has not
            sys.stdout.reconfigure(errors="backslashreplace")
        try:
            code = main(*arguments, **named)
            sys.stdout.flush()
            return code
        except KeyboardInterrupt:
            return 130
        except BrokenPipeError:
            _say_no_more()
            return 128 + 13  # as of a program that the signal ends
        except Exception as error:
            if isinstance(error, OSError) and _full():
                _say_no_more()
                sys.stderr.write(f"vgmpi: cannot write to stdout: {error.strerror}\n")
                return 1
            memory = isinstance(error, MemoryError)
            said = f"vgmpi: out of memory: {error or 'no more is left'}" if memory else REPORT
            sys.stderr.write(f"{said}\n")
            sys.excepthook(type(error), error, error.__traceback__)
            return 1

    return command


def _full() -> bool:
    """Whether a line more on stdout goes wrong."""
    try:
        sys.stdout.write("\n")
        sys.stdout.flush()
    except OSError:
        return True
    return False


def _say_no_more() -> None:
    """What is left to print goes nowhere: Python would complain of it at its end."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
